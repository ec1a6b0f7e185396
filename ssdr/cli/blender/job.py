"""The decomposition of an object in small steps."""

import json
import shutil
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .build import build, joints_of
from .process import AddonError, follow
from .sample import FrameRange, check, frame_kept, marked, sample


def steps(
    context: Any, source: Any, options: Any, python: Path
) -> Generator[tuple[float, str], None, list[str]]:
    """Give an object an armature, which replaces its animation; returns warnings.

    Each step yields the fraction that is done and a text, the last one the result in a sentence.
    Closing the generator undoes its changes to the scene and the disk.

    Raises
    ------
    AddonError
        If a step fails; the message is for the user.
    """
    check(source)
    if options.joints == "ARMATURE" and getattr(options.armature, "type", "") != "ARMATURE":
        raise AddonError("Choose the armature whose bones to keep")
    whole = FrameRange(source.name, context.scene.frame_start, context.scene.frame_end + 1)
    clips = marked(context.scene) if options.clips else [whole]
    folder, taken = Path(tempfile.mkdtemp(prefix="ssdr_", dir=bpy.app.tempdir)), None
    try:
        taken = yield from _part(sample(context, source, clips[0].first), 0.0, 0.2)
        asked = {
            "name": source.name,
            "fps": context.scene.render.fps,
            "clips": [(name, a - clips[0].first, b - clips[0].first) for name, a, b in clips],
            "options": _options(options),
            "joints": None,
        }
        if options.joints == "ARMATURE":
            with frame_kept(context.scene):
                context.scene.frame_set(clips[0].first)
                asked["joints"] = joints_of(options.armature, taken.place)
        (folder / "asked.json").write_text(json.dumps(asked), encoding="utf-8")
        np.savez(folder / "frames.npz", vertices=taken.vertices, faces=taken.faces)
        words = [str(python), str(Path(__file__).with_name("run_solver.py")), str(folder)]
        said = json.loads((yield from _part(follow(words, folder), 0.2, 1.0)))
        build(context, source, taken, clips, folder)
        yield 1.0, said["text"]
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if taken is not None and not taken.mesh.users:
            bpy.data.meshes.remove(taken.mesh)
    return list(said["warnings"])


def _options(options: Any) -> dict[str, Any]:
    """Arguments of ``ssdr.decompose`` or, with a tolerance, of ``ssdr.smallest``."""
    found = {"influences": options.influences, "effort": options.effort.lower()}
    if options.joints in ("LOOSE", "RIGID"):
        found["rig"] = options.joints.lower()
    if options.joints == "ARMATURE":
        return found
    if options.size == "BONES":
        return found | {"bones": options.bones}
    return found | {"tolerance": f"{options.tolerance:g}%", "measure": options.measure.lower()}


def _part(run: Generator[Any, None, Any], begin: float, end: float) -> Generator[Any, None, Any]:
    """Run a part of the work, which takes the fraction from `begin` to `end`; what it returns.

    The part yields fractions and texts, also as ``"0.5 text"``; other words are preparations.
    """
    try:
        while True:
            said = next(run)
            done, _, text = said.partition(" ") if isinstance(said, str) else (said[0], "", said[1])
            try:
                yield begin + (end - begin) * float(done), text
            except ValueError:
                yield begin, "preparing (the first run compiles, for about a minute)"
    except StopIteration as over:
        return over.value
    finally:
        run.close()
