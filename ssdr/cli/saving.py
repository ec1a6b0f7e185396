"""Checks of outputs before the work, and saving of a model after it."""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..clips import Clip
from ..errors import FormatError, InputError, MissingDependencyError, error_text
from ..io.atomic import check_writable
from ..io.formats import format_of
from ..io.optional import require
from ..io.save_report import SaveReport
from ..sequence import MeshSequence
from ..skinning import Skinning
from .format_options import write_options
from .options import FitOptions
from .output import Output

Settings = Mapping[str, Any]
_PACKAGES = {"alembic": "alembic3d", "usd": "pxr", "zarr": "zarr"}
_TRIED_INFLUENCES = 16  # more than any format with a limit takes
_SHEARED = np.array([[1.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


def check_outputs(
    paths: Iterable[Path], pairs: list[str] | None, *, sources: Sequence[Path]
) -> None:
    """Raise an error before the work if an output could not be written after it.

    Raises
    ------
    InputError
        If a suffix is unknown, a format can only be read, an option names an unknown suffix, or an
        output is named twice, is an input, lies in a folder that cannot be written to or would
        overwrite a companion file that is not its own.
    MissingDependencyError
        If a format needs a package that is not installed.
    """
    seen = list(sources)
    for path in paths:
        try:
            format_ = format_of(path)
        except FormatError as error:
            raise InputError("--output", "a known suffix", str(error)) from error
        if format_.extra == "blender":
            from ..io.blender import finder

            try:
                finder.command("")
            except MissingDependencyError as error:
                raise MissingDependencyError(f"{path}: FBX needs Blender. {error}") from error
        if format_.extra in _PACKAGES:
            require(_PACKAGES[format_.extra], format_.extra, f"{path}: {format_.title}")
        write_options(pairs, path)
        # the folder of numbered files is made with them
        made = format_.title.startswith("numbered") and "%" in path.name
        check_file(path, "--output", others=seen, with_folder=made)
        seen.append(path)


def check_file(
    path: Path, option: str, *, others: Iterable[Path], with_folder: bool = False
) -> None:
    """Raise an InputError if a file is in `others` or cannot be written.

    If `with_folder`, a missing folder is no error, because it will be made.
    """
    if not (path.suffix.lower() == ".zarr" and path.is_dir()):
        try:
            check_writable(path.parent if with_folder and not path.parent.exists() else path)
        except InputError as error:
            raise InputError(option, error.expected, error.got) from error
    if path.resolve() in [other.resolve() for other in others]:
        raise InputError(option, "a file that is no input and no other output", str(path))


def try_format(
    path: Path, settings: Settings, options: FitOptions, mesh: MeshSequence, clips: Sequence[Clip]
) -> None:
    """Save a small stand-in for the result, so that a format that cannot store it fails early.

    The stand-in has the mesh, the clips (with two frames each), the bone model and the number of
    influences that the result will have. It is written to a temporary folder.

    Raises
    ------
    InputError, MissingDependencyError, SsdrError
        As :func:`ssdr.save`.
    """
    from .. import io

    if format_of(path).extra == "blender":  # starts another program, for seconds
        return
    n = mesh.n_vertices
    bones = min(options.influences, np.max(options.bones or n), _TRIED_INFLUENCES)
    one = _SHEARED if options.bone_model == "affine" else np.eye(3, 4)
    transforms = np.tile(one, (2 * len(clips), bones, 1, 1))
    arrays = mesh.frames(0), np.tile(np.arange(bones), (n, 1)), np.full((n, bones), 1 / bones)
    pairs = tuple(Clip(c.name, 2 * k, 2 * k + 2, c.fps) for k, c in enumerate(clips))
    same = {
        name: getattr(mesh, name) for name in ("faces", "surface", "vertex_map", "name", "space")
    }
    model = Skinning(*arrays, transforms, clips=pairs, bone_model=options.bone_model, **same)
    # Errors of the temporary folder say nothing about that of the output.
    with contextlib.suppress(OSError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they come again with the whole model
        with tempfile.TemporaryDirectory(prefix="ssdr-") as folder:
            io.save(model, Path(folder) / path.name, **settings)


def save_model(model: Skinning, outputs: Mapping[Path, Settings]) -> list[SaveReport]:
    """Write a model to all outputs; `outputs` maps each path to options of :func:`ssdr.save`.

    If an output cannot be written, for example because the disk is full, the others still are. If
    then no file holds the skinning, it is written as ``.npz`` to the folder of the first output
    that could not be written or, if that is not possible either, to the folder for temporary files.

    Raises
    ------
    SsdrError, OSError
        The error of the first output that could not be written, raised at the end.
    """
    import ssdr

    reports, failed = [], []
    for path, options in outputs.items():
        try:
            with Output.current.waiting(f"saving {path}"):
                reports.append(ssdr.save(model, path, **options))
        except Exception as error:
            failed.append((path, error))
    if not failed:
        return reports
    for path, other in failed[1:]:
        Output.current.warn(f"{path}: {error_text(other)}")
    if not any(format_of(report.path).skinnings for report in reports):
        kept = _save_beside(model, failed[0][0])
        Output.current.warn(f"the model is kept in {kept}" if kept else "the model is lost")
    raise failed[0][1]


def _save_beside(model: Skinning, path: Path) -> Path | None:
    """Save a model to the folder of an output that could not be written; return the new file.

    If that fails, the folder for temporary files is used.  If that fails, too, None is returned.
    """
    import ssdr

    for folder in (path.parent, None):
        with contextlib.suppress(Exception):
            place = Path(folder or tempfile.gettempdir()) / f"{path.stem[:100]}.rescued.npz"
            if os.path.lexists(place):
                place = place.with_suffix(f".{os.getpid()}.npz")
            ssdr.save(model, place)
            return place
    return None
