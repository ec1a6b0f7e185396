"""Opening a stage safely, and where its clips are."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import itertools
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdSkel, UsdUtils

from ...clips import unique_names
from ...errors import FormatError, is_real, is_whole
from ..references import is_inside
from ..registry import refuse_device

__all__ = ["StageClip", "find_clips", "open_stage", "stage_name", "system_errors"]

_DEEPEST = 1000  # levels of nested text; usd-core ends the process at some tens of thousands
# What is no structure of a text layer: strings, asset paths and comments, closed or not.
_QUOTED = re.compile(
    rb'"""(?:\\.|[^\\])*?(?:"""|\Z)|"(?:\\.|[^"\\\n])*"?'
    rb"|'''(?:\\.|[^\\])*?(?:'''|\Z)|'(?:\\.|[^'\\\n])*'?"
    rb"|@@@(?:\\@@@|.)*?(?:@@@|\Z)|@[^@\n]*@?"
    rb"|#[^\n]*|//[^\n]*|/\*.*?(?:\*/|\Z)",
    re.DOTALL,
)
_STEPS = np.zeros(256, dtype=np.int8)
_STEPS[list(b"([{")], _STEPS[list(b")]}")] = 1, -1


def open_stage(path: Path) -> Any:
    """The stage as the file holds it now.

    Raises
    ------
    FormatError
        If it is none, or refers to a layer outside its folder.
    """
    try:
        _check_layers(path)
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        said = next((line for line in lines if "Error" in line), lines[-1] if lines else "")
        raise FormatError(f"{path}: not a usable USD file ({said[-300:]})") from error
    if not stage:
        raise FormatError(f"{path}: not a usable USD file")
    stage.Reload()  # layers are kept by name; the file may have been written anew
    return stage


def _check_layers(path: Path) -> None:
    """Refuse layers that must not be opened, before USD opens them.

    Raises
    ------
    FormatError
        If the file, or one that it refers to, is nested too deeply, or refers to a layer outside
        the file's folder, to a device or to a package.
    """
    seen, waiting = set(), [path]
    while waiting:
        file = waiting.pop()
        if file.resolve() in seen:
            continue
        seen.add(file.resolve())
        refuse_device(file)
        _check_nesting(file, path)
        layer = Sdf.Layer.FindOrOpen(str(file))
        for asset in itertools.chain(*UsdUtils.ExtractExternalReferences(str(file))):
            name = Path(Sdf.ComputeAssetPathRelativeToLayer(layer, asset))
            if not Sdf.FileFormat.FindByExtension(name.suffix[1:] or "none"):
                continue  # a picture or the like, which USD does not open
            if not is_inside(name, path.parent):
                raise FormatError(
                    f"{path}: refers to {asset}, which lies outside its folder; open a copy with "
                    "all that it refers to in one folder (usdcat --flatten makes one)"
                )
            # value clips may be named by a pattern, as clip.###.usd
            pattern = "*".join(re.split("#+", name.name))
            waiting += name.parent.glob(pattern) if "#" in name.name else [name]


def _check_nesting(file: Path, path: Path) -> None:
    """Refuse text whose brackets are nested too deeply: usd-core would end the process."""
    if not file.is_file():
        return
    data = file.read_bytes()
    if data.startswith(b"PK"):
        raise FormatError(f"{path}: {file.name} is a package, which must be unpacked first")
    if data.startswith(b"PXR-USDC"):
        return
    steps = _STEPS[np.frombuffer(_QUOTED.sub(b"", data), dtype=np.uint8)]
    depth = np.cumsum(steps[steps != 0], dtype=np.int64).max(initial=0)
    if depth > _DEEPEST:
        raise FormatError(f"{path}: {file.name} is nested {depth} deep, at most {_DEEPEST} is read")


@contextlib.contextmanager
def system_errors(path: Path) -> Iterator[None]:
    """Have the errors that USD raises where it cannot write be the OSError behind them."""
    try:
        yield
    except Tf.ErrorException as error:
        text = " ".join(str(error).split())
        known = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)
        number = next((n for n in known if os.strerror(n) in text), None)
        reason = text if number is None else os.strerror(number)
        raise OSError(number or errno.EIO, reason, str(path)) from error


def stage_name(stage: Any, path: Path) -> str:
    """Name of the root prim, else of the file."""
    root = stage.GetDefaultPrim()
    return str(root.GetName()) if root else path.stem


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StageClip:
    """A clip of a stage: a SkelAnimation of its only skeleton, or all that moves.

    Attributes
    ----------
    name : str
    skeleton, animation : Sdf.Path or None
        None where nothing has to be bound.
    bound : bool
        Whether the file binds this animation, so that the stage's range is that of the clip.
    fps, frames : float and int, or None
        Rate and number of frames, where files of several clips state them.
    start : float
        Time code of the first frame, where these two are stated.
    """

    name: str
    skeleton: Any = None
    animation: Any = None
    bound: bool = True
    fps: float | None = None
    frames: int | None = None
    start: float = 0.0


def find_clips(stage: Any, path: Path) -> list[StageClip]:
    """The clips of a stage, that of the bound animation first."""
    title = stage_name(stage, path)
    prims = list(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    skeletons = [prim for prim in prims if prim.IsA(UsdSkel.Skeleton)]
    if len(skeletons) != 1 or skeletons[0].IsInstanceProxy():
        return [StageClip(name=title)]
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
        return [StageClip(name=title)]
    clips = []
    for prim in usable:
        own = prim.GetCustomDataByKey("ssdr")
        own = own if isinstance(own, dict) else {}
        fps, frames = own.get("fps"), own.get("frames")
        # The stage's own range is that of one clip alone.
        known = len(usable) > 1 and is_real(fps) and fps > 0 and is_whole(frames) and frames > 0
        default = title if len(usable) == 1 and own else str(prim.GetName())
        clips.append(
            StageClip(
                name=str(own.get("name") or default),
                skeleton=skeletons[0].GetPath(),
                animation=prim.GetPath(),
                bound=prim == bound,
                fps=float(own["fps"]) if known else None,
                frames=int(own["frames"]) if known else None,
                start=float(own["start"]) if is_real(own.get("start")) else 0.0,
            )
        )
    names = unique_names([clip.name for clip in clips])
    return [dataclasses.replace(clip, name=n) for clip, n in zip(clips, names, strict=True)]
