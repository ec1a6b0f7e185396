"""A stage, what it is called, and which clips it has."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ...clips import unique_names
from ...errors import FormatError, is_real, is_whole
from ..references import is_inside

__all__ = ["Take", "name_of", "open_stage", "takes_of"]


def open_stage(path: Path) -> Any:
    """The stage as the file holds it now.

    Raises
    ------
    FormatError
        If it is none, or refers to a layer outside its folder.
    """
    from pxr import Tf, Usd

    try:
        _check_references(path)
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise FormatError(f"{path}: not a usable USD file ({_first_line(error)})") from error
    if not stage:
        raise FormatError(f"{path}: not a usable USD file")
    stage.Reload()  # layers are kept by name; the file may have been written anew
    for layer in stage.GetUsedLayers():
        if layer.realPath and not is_inside(Path(layer.realPath), path.parent):
            raise FormatError(f"{path}: refers to {layer.realPath}, which lies outside its folder")
    return stage


def _check_references(path: Path) -> None:
    """Refuse layers outside the file's folder before any of them is opened.

    Raises
    ------
    FormatError
        If the file, or one that it refers to, refers to one.
    """
    from pxr import Sdf

    folder, seen, waiting = path.parent, set(), [str(path)]
    while waiting:
        name = waiting.pop()
        layer = Sdf.Layer.FindOrOpen(name)
        if layer is None or layer.identifier in seen:
            continue
        seen.add(layer.identifier)
        for asset in layer.GetCompositionAssetDependencies():
            file = Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
            if not is_inside(Path(file.partition("[")[0]), folder):
                raise FormatError(
                    f"{path}: refers to {asset}, which lies outside its folder; open a copy with "
                    "all that it refers to in one folder (usdcat --flatten makes one)"
                )
            waiting.append(file)


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if "Error" in line), lines[-1] if lines else "")[-300:]


def name_of(stage: Any, path: Path) -> str:
    """Name of the root prim, else of the file."""
    root = stage.GetDefaultPrim()
    return str(root.GetName()) if root else path.stem


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Take:
    """A clip: the SkelAnimation of the one skeleton, or all that moves."""

    name: str
    skeleton: Any = None  # paths; None where nothing has to be bound
    animation: Any = None
    bound: bool = True
    fps: float | None = None  # as our own files of several clips state them
    frames: int | None = None
    start: float = 0.0  # time code of the first frame, where these two are stated


def takes_of(path: Path) -> list[Take]:
    """The clips of a stage, that of the bound animation first."""
    from pxr import Usd, UsdSkel

    stage = open_stage(path)
    title = name_of(stage, path)
    prims = list(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    skeletons = [prim for prim in prims if prim.IsA(UsdSkel.Skeleton)]
    if len(skeletons) != 1 or skeletons[0].IsInstanceProxy():
        return [Take(name=title)]
    joints = set(UsdSkel.Skeleton(skeletons[0]).GetJointsAttr().Get() or ())
    usable = [
        prim
        for prim in prims
        if prim.IsA(UsdSkel.Animation)
        and joints & set(UsdSkel.Animation(prim).GetJointsAttr().Get() or ())
    ]
    bound = UsdSkel.BindingAPI(skeletons[0]).GetInheritedAnimationSource()
    usable.sort(key=lambda prim: prim != bound)  # a stable order: the others stay in theirs
    if not usable or (bound and usable[0] != bound):
        return [Take(name=title)]
    takes = []
    for prim in usable:
        own = prim.GetCustomDataByKey("ssdr")
        own = own if isinstance(own, dict) else {}
        fps, frames = own.get("fps"), own.get("frames")
        # The stage's own range is that of one clip alone.
        known = len(usable) > 1 and is_real(fps) and fps > 0 and is_whole(frames) and frames > 0
        default = title if len(usable) == 1 and own else str(prim.GetName())
        takes.append(
            Take(
                name=str(own.get("name") or default),
                skeleton=skeletons[0].GetPath(),
                animation=prim.GetPath(),
                bound=prim == bound,
                fps=float(own["fps"]) if known else None,
                frames=int(own["frames"]) if known else None,
                start=float(own["start"]) if is_real(own.get("start")) else 0.0,
            )
        )
    names = unique_names([take.name for take in takes])
    return [dataclasses.replace(take, name=n) for take, n in zip(takes, names, strict=True)]
