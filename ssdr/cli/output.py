"""What commands share: tables, JSON, warnings, options of formats, checks of output files."""

from __future__ import annotations

import contextlib
import dataclasses
import glob
import importlib
import importlib.util
import inspect
import json
import logging
import math
import os
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import typer

from ..clips import Clip
from ..errors import FormatError, InputError, MissingDependencyError
from ..io.atomic import check_writable
from ..io.registry import FORMATS, Format, SaveReport, format_of, format_to_read
from ..sequence import MeshSequence
from ..skinning import Skinning

_PACKAGES = {"usd": "pxr", "zarr": "zarr"}

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Force = Annotated[bool, typer.Option("--force", "-f", help="Overwrite outputs that exist.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")]
Verbose = Annotated[
    int, typer.Option("--verbose", "-v", count=True, help="Log more, on stderr; -vv for debugging.")
]
Threads = Annotated[
    int | None, typer.Option("--threads", min=1, help="Threads; all cores by default.")
]
Fps = Annotated[float | None, typer.Option("--fps", help="Frames per second of the input.")]
Scale = Annotated[
    float | None,
    typer.Option("--scale", metavar="FACTOR", help="Of the input's lengths: 0.01 turns cm into m."),
]
Weld = Annotated[
    bool,
    typer.Option("--weld", help="Merge vertices that coincide in every frame, as UV seams do."),
]
ReadOptions = Annotated[
    list[str] | None,
    typer.Option("--read", metavar="KEY=VALUE", help="Option of the input's format; repeatable."),
]
WriteOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--write",
        metavar="[SUFFIX:]KEY=VALUE",
        help="Option of an output's format, as in glb:weights=uint16; repeatable.",
    ),
]


Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse what of the input the output cannot keep.")
]


class Interrupted(Exception):
    """Ctrl-C stopped the work at a safe point."""

    def __init__(self, text: str, **details: Any) -> None:
        self.details = details
        super().__init__(text)


@dataclasses.dataclass
class Output:
    """Where results and warnings of one run of the command go."""

    arguments: list[str]
    json: bool = False
    quiet: bool = False
    warnings: list[str] = dataclasses.field(default_factory=list)
    began: float = dataclasses.field(default_factory=time.perf_counter)
    current: ClassVar[Output]

    @classmethod
    def start(
        cls,
        *,
        json: bool = False,
        quiet: bool = False,
        verbose: int = 0,
        threads: int | None = None,
    ) -> Output:
        """Take the options that every command has."""
        from ..parallel import set_threads

        level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
        logger = logging.getLogger("ssdr")
        logger.setLevel(level)
        for old in [h for h in logger.handlers if getattr(h, "of_command", False)]:
            logger.removeHandler(old)
        handler = logging.StreamHandler(sys.stderr)
        handler.of_command = True  # type: ignore[attr-defined]
        handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
        logger.addHandler(handler)
        if threads is not None:
            set_threads(threads)
        output = cls.current
        output.json, output.quiet = json, quiet
        return output

    def waiting(self, text: str) -> contextlib.AbstractContextManager[None]:
        """Says on stderr what a wait of more than a second is for."""
        from .progress import waiting

        return waiting(text, show=not (self.json or self.quiet), stream=sys.stderr)

    def warn(self, message: Warning | str, *_: Any, **__: Any) -> None:
        """Stands in for ``warnings.showwarning``."""
        text = " ".join(str(message).split())
        self.warnings.append(text)
        sys.stderr.write(f"ssdr: warning: {text}\n")

    def result(self, document: Mapping[str, Any], rows: Iterable[tuple[str, str]]) -> None:
        """Print the result, as JSON or as a table.

        Raises
        ------
        BrokenPipeError
            If nobody reads it and it is all that there is: no file was written.
        OSError
            If it cannot be written.
        """
        try:
            self._print(document, rows)
        except BrokenPipeError:
            if not {"output", "outputs"} & document.keys():
                raise

    def _print(self, document: Mapping[str, Any], rows: Iterable[tuple[str, str]]) -> None:
        if self.json:
            text = json.dumps({**_plain(document), "warnings": self.warnings}, allow_nan=False)
            sys.stdout.write(text + "\n")
        elif not self.quiet:
            lines = [(name, value) for name, value in rows if value]
            width = max(len(name) for name, _ in lines)
            for name, value in lines:
                sys.stdout.write(f"{name:<{width}}  {value}\n")
        sys.stdout.flush()


def read_any(path: Path, **options: Any) -> MeshSequence | Skinning:
    """Read a skinning where the file holds one, a sequence otherwise."""
    from .. import io

    format_ = None
    with contextlib.suppress(FormatError):
        format_ = format_to_read(path)
    if format_ is not None and format_.read_skinning:
        known = _keywords(format_, format_.read_skinning)
        fitting = {k: v for k, v in options.items() if k in known | {"scale"}}
        try:
            return io.load_skinning(path, **fitting)
        except FormatError as error:
            # Without a skinning in it, it may still be an animated mesh.
            reason = error
        try:
            return io.load(path, **options)
        except FormatError as error:
            raise error from reason
    return io.load(path, **options)


def read_options(
    pairs: list[str] | None,
    *,
    fps: float | None,
    weld: bool = False,
    scale: float | None = None,
) -> dict[str, Any]:
    """Keyword arguments of :func:`ssdr.load` from the command line."""
    options: dict[str, Any] = {"fps": fps} if fps is not None else {}
    if weld:
        options["weld"] = True
    if scale is not None:
        if not (math.isfinite(scale) and scale > 0):
            raise InputError("--scale", "a positive number", scale)
        options["scale"] = scale
    for pair in pairs or ():
        key, value = _pair("--read", pair)
        options[key] = value
    return options


def write_options(pairs: list[str] | None, path: Path) -> dict[str, Any]:
    """Those keyword arguments of :func:`ssdr.save` that are meant for this file."""
    options = {}
    for pair in pairs or ():
        match = re.match(r"\.?(\w+):(?=\w+=)", pair)
        key, value = _pair("--write", pair[match.end() :] if match else pair)
        # What is meant for a format that this run does not write may stand there all the same.
        if match and f".{match[1].lower()}" not in FORMATS:
            raise InputError("--write", "the suffix of a format before the colon", pair)
        if match is None or match[1].lower() == path.suffix.lower().lstrip("."):
            options[key] = value
    return options


def check_outputs(
    paths: Iterable[Path], *, kind: type, pairs: list[str] | None, force: bool, sources: list[Path]
) -> None:
    """Find out before the work whether the outputs can be written after it.

    Raises
    ------
    InputError
        If a suffix is unknown, the format cannot hold such a thing, an option is
        unknown, the file exists (and not `force`) or its folder cannot be written.
    MissingDependencyError
        If the format needs a package that is not installed.
    """
    seen: set[Path] = set()
    for path in paths:
        try:
            suffix, format_ = format_of(path)
        except FormatError as error:
            raise InputError("--output", "a known suffix", str(error)) from error
        writer = format_.write_sequence
        if issubclass(kind, Skinning):
            writer = format_.write_skinning or writer
        if writer is None:
            what = "holds a sequence of vertices" if format_.write_skinning else "can be written"
            raise InputError("--output", f"a format that {what}", f"{path} ({suffix})")
        if format_.extra == "blender":
            from ..io.blender import finder

            finder.command("")
        package = _PACKAGES.get(format_.extra or "")
        if package and importlib.util.find_spec(package) is None:
            raise MissingDependencyError(
                f'{path}: {format_.title} needs {package}: pip install "ssdr[{format_.extra}]"'
            )
        known = _keywords(format_, writer)
        for key in write_options(pairs, path):
            if known and key not in known:
                raise InputError("--write", f"one of {', '.join(sorted(known))} for {suffix}", key)
        check_file(path, "--output", force=force, sources=sources, seen=seen)


def check_file(
    path: Path,
    option: str,
    *,
    force: bool,
    sources: list[Path],
    seen: set[Path] | None = None,
) -> None:
    """Refuse a file that exists, is an input, is named twice or cannot be written."""
    if not (path.suffix.lower() == ".zarr" and path.is_dir()):
        try:
            check_writable(path)
        except InputError as error:
            raise InputError(option, error.expected, error.got) from error
    absolute = path.resolve()
    if any(absolute == source.resolve() for source in sources):
        raise InputError(option, "another file than the input", str(path))
    if seen is not None:
        if absolute in seen:
            raise InputError(option, "each file once", str(path))
        seen.add(absolute)
    numbered = re.sub(r"%0?\d*d", "*", path.name)
    there = [path, *_beside(path)]
    if numbered != path.name:
        there = list(map(Path, glob.glob(f"{glob.escape(str(path.parent))}/{numbered}")))
    taken = [p for p in there if os.path.lexists(p)]
    if taken and not force:
        name = path if path in taken or numbered != path.name else taken[0]
        raise InputError(option, "a new file (--force overwrites)", f"{name}, which exists")


def _beside(path: Path) -> list[Path]:
    """What a format writes beside a file, whatever the file holds."""
    endings = {".gltf": ".bin", ".npy": ".faces.npy"}
    suffix = path.suffix.lower()
    return [path.with_suffix(endings[suffix])] if suffix in endings else []


def rehearse(
    sequence: MeshSequence,
    path: Path,
    options: Mapping[str, Any],
    *,
    frames: int,
    clips: Sequence[Clip] = (),
    bones: int = 1,
    stored: int = 1,
) -> None:
    """Write a model of few frames, one a clip, to a folder that goes away; `frames` will come.

    What a format refuses (an option's value, one file for many frames) is refused before the
    work, not after it.

    Parameters
    ----------
    bones, stored : int
        Of the model that is written, frames all alike.

    Raises
    ------
    InputError, MissingDependencyError, SsdrError
        As :func:`ssdr.save`.
    """
    from .. import io

    suffix, format_ = format_of(path)
    if format_.module == "meshes":
        from ..io.meshes.numbered import check_pattern

        check_pattern(path, frames)
    if format_.module == "blender":  # starts another program, for seconds
        return
    n = sequence.n_vertices
    frame = sequence.frames(slice(0, 1))
    model = Skinning(
        frame[0],
        np.zeros((n, 1), dtype=np.int32),
        np.ones((n, 1)),
        np.tile(np.eye(3, 4), (max(stored, len(clips)), bones, 1, 1)),
        faces=sequence.faces,
        fps=None if clips else sequence.fps,  # type: ignore[arg-type]
        clips=tuple(Clip(c.name, k, k + 1, c.fps) for k, c in enumerate(clips)) or None,  # type: ignore[arg-type]
        surface=sequence.surface,
        vertex_map=sequence.vertex_map,
        name=sequence.name,
    )
    try:
        with tempfile.TemporaryDirectory(prefix="ssdr-") as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they come again with the whole model
            name = f"rehearsal%d{suffix}" if format_.module == "meshes" else f"rehearsal{suffix}"
            io.save(model, Path(folder) / name, **options)
    except OSError as error:
        # The folder of the output has been tried; this one says nothing about it.
        logging.getLogger(__name__).debug("no rehearsal: %s", error)


def saved_document(report: SaveReport) -> dict[str, Any]:
    """A :class:`SaveReport` for JSON."""
    return {f.name: getattr(report, f.name) for f in dataclasses.fields(report)}


def saved_line(report: SaveReport, diagonal: float | None = None) -> str:
    """A :class:`SaveReport` in one line."""
    parts = [str(report.path), size_text(report.bytes)]
    if report.error is not None:
        parts.append(f"error of storage {length_text(report.error, diagonal)}")
    if report.between_frames is not None:
        parts.append(f"between frames {length_text(report.between_frames, diagonal)}")
    if report.note:
        parts.append(report.note)
    return ", ".join(parts)


def length_text(value: float, diagonal: float | None) -> str:
    """A length, also in % of the diagonal where that is known."""
    share = f" ({100 * value / diagonal:.3g} %)" if diagonal else ""
    return f"{value:.4g}{share}"


def size_text(count: float) -> str:
    """Bytes in the usual units."""
    for unit in ("bytes", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def _pair(option: str, text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.isidentifier():
        raise InputError(option, "KEY=VALUE", repr(text))
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def _keywords(format_: Format, function: str) -> set[str]:
    """Names of the options of a format's function; empty where it takes any."""
    module = importlib.import_module(f"ssdr.io.{format_.module}")
    parameters = inspect.signature(getattr(module, function)).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return set()
    return {p.name for p in parameters if p.kind is p.KEYWORD_ONLY} or {"no options"}


def _plain(value: Any) -> Any:
    """Only what JSON knows; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, str) else str(value)
