"""The evaluation of checkpoints on a store, as a report in a folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ssdr.errors import InputError

from ..configs.config import Config
from ..data.clip import MIRRORED
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..data.virtual_bones import VirtualBones, parameter_roles, virtual_bones
from ..io.files import write_file, writing
from ..networks.checkpoint import Checkpoint, load_checkpoint
from .baselines import BodySkinned, MeanShape, Ridge
from .pictures import draw_clip, draw_moments
from .santesteban import train_santesteban
from .scores import (
    Method,
    Row,
    bones_themselves,
    by_looseness,
    chaos_floor,
    evaluate,
    looseness,
    network_method,
    plain_method,
    table,
)

__all__ = ["report"]


def report(
    paths: Sequence[Path],
    store: ClipStore,
    folder: Path | str,
    *,
    baselines: bool = True,
    pictures: int = 1,
    bones_folder: Path | str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> str:
    """Score checkpoints on unseen motions and, if they read parameters, unseen parameters.

    Parameters
    ----------
    paths : sequence of Path
        Checkpoints on one set of virtual bones.
    store : ClipStore
    folder : path
        For ``report.json``, ``report.txt``, pictures, and in ``baselines`` the trained baselines.
    baselines : bool
        Whether to train and score them.
    pictures : int
        Test clips to draw for every checkpoint.

    Returns
    -------
    str
        The text of ``report.txt``.

    Raises
    ------
    InputError
        If a checkpoint is of another garment or body, or the store lacks test clips.
    """
    folder = Path(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    models = {_name(p, paths): load_checkpoint(p) for p in paths}
    for model in models.values():
        model.check_fits(store)
    first = next(iter(models.values()))
    config = first.networks[0].config
    bones = virtual_bones(store, config.bones, folder=bones_folder, progress=progress)
    roles = parameter_roles(store)
    base = _base(first, store)
    seen = [c.name for c in store.clips("test") if c.parameters == base]
    if not seen:
        raise InputError("store", f"test clips of {base}", str(store.path))
    bounds: dict[str, Method] = {"bones themselves": bones_themselves(bones)}
    methods = bounds | {k: network_method(m) for k, m in models.items()}
    if baselines:
        methods |= _baselines(bones, config, base, folder / "baselines", progress)
    rows = evaluate(bones, methods, seen, progress=progress)
    lines = [f"unseen motions, {base}, {rows[0].frames} frames (mm, mm, -)", table(rows), ""]
    document: dict[str, Any] = {
        "parameters": dataclasses.asdict(base),
        "bones": bones.report | {"test": bones.prepare(seen)},
        "unseen_motions": [r.as_dict() for r in rows],
    }
    several = {k: m for k, m in models.items() if m.kernel is not None or m.networks[0].condition}
    for split in ("train", "test"):
        names = [c.name for c in store.clips(split) if roles[c.parameters] == "test"]
        if names and several:
            chosen = bounds | {k: network_method(m) for k, m in several.items()}
            unseen = evaluate(bones, chosen, names, progress=progress)
            count = unseen[0].frames
            lines += [
                f"unseen parameters, {split} motions, {count} frames",
                table(unseen),
                "",
            ]
            document[f"unseen_parameters_{split}"] = [r.as_dict() for r in unseen]
    lines += _classes(rows)
    pairs: dict[SimulationParameters, list[tuple[str, str]]] = {}
    for pair in store.pairs():
        pairs.setdefault(store.clip(pair[0]).parameters, []).append(pair)
    # Soft cloth has a higher floor than stiff cloth, so every parameter set has its own.
    floors = {p: chaos_floor(bones, names) for p, names in pairs.items()}
    document["chaos_floor"] = floors.get(base, {})
    document["chaos_floor_of_sets"] = {str(p): floor["all"] for p, floor in floors.items()}
    lines += [f"chaos floor, {key}: {_floor(v)}" for key, v in document["chaos_floor"].items()]
    lines += [f"chaos floor, {p} ({roles[p]}): {_floor(f['all'])}" for p, f in floors.items()]
    mean, deviation = looseness(bones, seen)
    document["looseness"] = {"mean_mm": mean.tolist(), "deviation_mm": deviation.tolist()}
    lines += ["", "mean error (mm) by distance to the body, quarters of the vertices"]
    for row in rows:
        cells = "  ".join(f"{d:6.0f}: {e:6.1f}" for d, e in by_looseness(row, mean))
        lines.append(f"{row.name:<20} {cells}")
    for key, method in ((k, network_method(m)) for k, m in models.items()):
        for name in seen[:pictures]:
            clip = store.clip(name)
            file = folder / f"{key}-{name}.png"
            with writing(file):
                draw_clip(bones, clip, method(clip), file)
        if pictures:
            file = folder / f"{key}-moments.png"
            with writing(file):
                document.setdefault("moments", {})[key] = draw_moments(bones, method, seen, file)
    text = "\n".join(lines) + "\n"
    write_file(folder / "report.json", json.dumps(document).encode())
    write_file(folder / "report.txt", text.encode())
    return text


def _floor(value: dict[str, float]) -> str:
    return f"{value['overall']:.2f} mm, low {value['low']:.2f} mm ({value['frames']:.0f} frames)"


def _baselines(
    bones: VirtualBones,
    config: Config,
    base: SimulationParameters,
    folder: Path,
    progress: Callable[[str, float], None] | None,
) -> dict[str, Method]:
    store = bones.store
    names = [c.name for c in store.clips("train") if c.parameters == base]
    held = [c.name for c in store.clips("validation") if c.parameters == base]
    if not names or not held:
        raise InputError("store", f"training and validation clips of {base}", str(store.path))
    bones.prepare([*names, *held])
    if config.data.mirror and store.mirror_vertices is not None:
        learned = names + [n + MIRRORED for n in names]
    else:
        learned = names

    def after_epoch(p: Any) -> bool:
        if progress:
            progress("training Santesteban 2019", p.fraction)
        return False

    gru = train_santesteban(bones, config, learned, held, folder, callback=after_epoch)
    return {
        "mean shape": plain_method(bones, MeanShape(bones, names).predict),
        "body-skinned": plain_method(bones, BodySkinned(store).predict),
        "ridge": plain_method(bones, Ridge(bones, names, held).predict),
        "Santesteban 2019": plain_method(bones, gru.predict),
    }


def _base(model: Checkpoint, store: ClipStore) -> SimulationParameters:
    if model.kernel is None and model.parameters[0] is not None:
        return model.parameters[0]
    return store.parameters()[0]


def _name(path: Path, paths: Sequence[Path]) -> str:
    # Every run writes a file of the same name into a folder of its own.
    short = f"{path.parent.name}-{path.stem}" if path.parent.name else path.stem
    same = [p for p in paths if p.parent.name == path.parent.name and p.stem == path.stem]
    return short if len(same) == 1 else str(path.with_suffix("")).strip("/").replace("/", "-")


def _classes(rows: Sequence[Row]) -> list[str]:
    kinds = sorted({k for r in rows for k in r.per_class})
    lines = [
        "overall RMSE (mm) by class of motion",
        f"{'':<20}" + "".join(f"{k:>10}" for k in kinds),
    ]
    for row in rows:
        cells = "".join(f"{row.per_class.get(k, float('nan')):10.1f}" for k in kinds)
        lines.append(f"{row.name:<20}{cells}")
    return [*lines, ""]
