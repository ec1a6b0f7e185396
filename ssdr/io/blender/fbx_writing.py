"""Writing of FBX: Blender imports the model as glTF and exports it."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from ...common.errors import InputError, SsdrError
from ...model.shapes import Skinned, without_shapes
from ..atomic import atomic_path
from ..fbx.fbx_reading import FbxFile
from ..file_clips import check_one_rate
from ..gltf.gltf_writing import write_played
from ..played_model import as_played
from ..save_report import Rounding, SaveReport, frame_blocks
from ..spaces import transformed
from .finder import command, run

_SCRIPT = Path(__file__).with_name("write_script.py")
_IMPORT_FPS = 24.0
_LONGEST_NAME = 63  # bytes in the name of anything in Blender


def write_skinning(thing: Skinned, path: Path, *, centimetres: bool = False) -> SaveReport:
    """Write a skinned ``.fbx``: Blender imports the model as glTF and exports it as FBX.

    The FBX file is read back and compared with the model, so that `error` and `max_error` of the
    report include all that Blender changes. `between_frames` of the report is that of the glTF;
    engines that interpolate FBX's Euler angles differ from it a little.

    Parameters
    ----------
    thing : Skinning or ShapedSkinning
        Without shapes.
        In metres with y up.
    path : Path
    centimetres : bool
        Whether FBX stores numbers in centimetres, the unit that it states in any case. By default
        they are metres, below nodes that Blender gives a scale of 100.

    Raises
    ------
    InputError
        If clips have names that are too long for Blender or different frame rates, or the model
        does not fit glTF.
    MissingDependencyError
        If Blender is not found or is older than 4.2.
    SsdrError
        If Blender stops with an error or takes too long, or its file does not hold the model.
    """
    skinning = without_shapes(thing, "FBX; glTF and USD hold them")
    title = skinning.name or path.stem
    names = [clip.name or title for clip in skinning.clips]
    long = [one for one in names if len(one.encode()) > _LONGEST_NAME]
    if long:
        raise InputError("thing", f"clip names of at most {_LONGEST_NAME} bytes", long[0])
    check_one_rate(skinning.clips, "as all takes of an FBX file have")
    command(_SCRIPT)
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder, atomic_path(path) as temporary:
        source = Path(folder) / "model.glb"
        # In Blender, clips get short names, because it would change some names, and a whole frame
        # rate, because only then its glTF importer puts keys on frames.
        numbered = [
            dataclasses.replace(c, name=f"c{k}", fps=_IMPORT_FPS)
            for k, c in enumerate(skinning.clips)
        ]
        model = dataclasses.replace(skinning, fps=_IMPORT_FPS, clips=tuple(numbered))
        unit = 0.01 if centimetres else 1.0
        model = transformed(model, 1 / unit)
        played = as_played(model, most=8)
        stored = write_played(model, played, source, title)
        # An importer of FBX fixes a bone that begins where its parent ends, so bones that slide
        # must not be drawn there. By itself, Blender draws each bone along the y axis of its joint.
        slides = played.parents is not None and bool(played.translating[played.parents >= 0].any())
        drawn = "TEMPERANCE" if slides else "FORTUNE"
        job = {
            "source": str(source),
            "path": str(temporary.resolve()),
            "fps": skinning.fps,
            "import_fps": _IMPORT_FPS,
            "options": {} if played.parents is None else {"bone_heuristic": drawn},
            "unit": unit,
            "clips": [
                {"name": one, "action": f"c{k}", "frames": clip.n_frames}
                for k, (one, clip) in enumerate(zip(names, skinning.clips, strict=True))
            ],
        }
        written = run(_SCRIPT, job)
        if not temporary.is_file():
            raise SsdrError("Blender wrote no FBX file")
    back = FbxFile.read_skinning(path)
    vertex = written["vertex"]
    if (back.n_frames, back.n_vertices) != (skinning.n_frames, len(vertex)):
        raise SsdrError(
            f"Blender's FBX holds {back.n_frames} frames of {back.n_vertices} vertices, "
            f"not {skinning.n_frames} of {len(vertex)}"
        )
    error = Rounding()
    for block in frame_blocks(0, skinning.n_frames, len(vertex)):
        truth = skinning.skin(block, dtype=np.float64)[:, vertex]
        error.add(back.skin(block, dtype=np.float64), truth)
    dropped = len(skinning.faces) - int(written["triangles"])
    lost = f"{dropped} triangles, which Blender drops: without area, or on the vertices of another"
    return dataclasses.replace(
        stored,
        path=path,
        bytes=path.stat().st_size,
        error=error.rmse,
        max_error=error.largest,
        between_frames=unit * (stored.between_frames or 0.0),
        lost=(lost,) if dropped else (),
    )
