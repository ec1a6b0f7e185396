"""A USD file passed on whole, and what of it a model does not hold."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils

from ...clips import pick
from ..atomic import atomic_path
from ..registry import SaveReport, reading
from .reader import StageReader
from .stage import find_clips, open_stage, system_errors

__all__ = ["copy", "left_out", "transfer"]

_READ = ("diffuseColor", "opacity", "metallic", "roughness")


def copy(path: Path, target: Path, *, clips: Sequence[str | int] | None = None) -> SaveReport:
    """Write the root layer of a USD file again, as text or binary, with all that is in it.

    Parameters
    ----------
    path, target : Path
    clips : names or numbers, optional
        The animations to keep; all by default.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If it has no such clip.
    """
    with reading(path):
        source = open_stage(path)
        found = find_clips(source, path)
    names = [clip.name for clip in found]
    kept = {pick(names, clip) for clip in clips} if clips is not None else set(range(len(found)))
    with atomic_path(target) as temporary, system_errors(target):
        stage = transfer(source, path, temporary, target)
        for number, clip in enumerate(found):
            if number not in kept and clip.animation is not None:
                stage.RemovePrim(clip.animation)
        if 0 not in kept and found[0].animation is not None:
            binding = UsdSkel.BindingAPI(stage.GetPrimAtPath(found[0].skeleton))
            binding.CreateAnimationSourceRel().SetTargets([found[min(kept)].animation])
        stage.GetRootLayer().Save()
    return SaveReport(path=target, bytes=target.stat().st_size)


def transfer(source: Any, path: Path, temporary: Path, target: Path) -> Any:
    """A stage of `temporary` with the content of the stage that `path` holds.

    Files that it names are found again from where `target` will be.
    """
    layer = Sdf.Layer.CreateNew(str(temporary))
    layer.TransferContent(source.GetRootLayer())
    old, new = path.parent.resolve(), target.parent.resolve()

    def moved(asset: str) -> str:
        if not asset or "://" in asset or os.path.isabs(asset) or not (old / asset).exists():
            return asset  # what a resolver finds elsewhere
        return Path(os.path.relpath(old / asset, new)).as_posix()

    if old != new:
        UsdUtils.ModifyAssetPaths(layer, moved)
    return Usd.Stage.Open(layer)


def left_out(path: Path) -> tuple[str, ...]:
    """What the file has and a sequence or skinning that is read from it has not."""
    found: dict[str, None] = {}
    with reading(path):
        reader = StageReader(path)
        meshes = reader.sample(reader.clips[0]).meshes
        for mesh in meshes:
            for primvar in UsdGeom.PrimvarsAPI(mesh.prim).GetPrimvarsWithValues():
                name = str(primvar.GetPrimvarName())
                if name not in ("st", "normals") and not name.startswith("skel:"):
                    found[f"the primvar {name}"] = None
            if mesh.has_axes:
                found["orientations of the joints"] = None
        if len(meshes) > 1:
            found["names and number of the meshes"] = None
        for prim in reader.stage.Traverse():
            shader = UsdShade.Shader(prim)
            if prim.IsA(UsdGeom.Camera):
                found["cameras"] = None
            elif str(prim.GetTypeName()).endswith("Light"):
                found["lights"] = None
            elif shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
                for holder in shader.GetInputs():
                    name = str(holder.GetBaseName())
                    picture = holder.HasConnectedSource() and name != "diffuseColor"
                    if picture or name not in _READ:
                        found[f"{name} of materials"] = None
    return tuple(found)
