"""The evaluation of checkpoints on a store, as a report in a folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from ssdr.errors import InputError

from ..configs.config import Config
from ..data.clip_files import Split
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..data.virtual_bones import VirtualBones, parameter_roles, virtual_bones
from ..io.files import write_file, writing
from ..networks.checkpoint import Checkpoint, load_checkpoint
from .clip_scores import VERTICES, Method, Scorer
from .entrants import SANTESTEBAN, baseline_methods
from .pictures import draw_clip, draw_moments
from .pushed import pushed_method
from .report_text import (
    clip_tables,
    name_width,
    ratio_table,
    ratios,
    score_tables,
    seed_figures,
    seed_table,
)
from .score_cache import ScoreCache, digest_of_file
from .scores import (
    Row,
    bones_themselves,
    by_looseness,
    chaos_floor,
    evaluate,
    looseness,
    network_method,
    pool,
)
from .selection import group_of, matching, seeds_of

__all__ = ["report"]


def report(
    paths: Sequence[Path],
    store: ClipStore,
    folder: Path | str,
    *,
    baselines: bool = True,
    recurrent: Config | None = None,
    pictures: int = 1,
    clips: Sequence[str] = (),
    against: str | None = None,
    per_clip: bool = False,
    push_out: bool = False,
    rescore: bool = False,
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
        For ``report.json``, ``report.txt``, pictures, in ``baselines`` the trained baselines, and
        in ``scores`` what each method scored on each clip: what is there is not scored again.
    baselines : bool
        Whether to train and score them.
    recurrent : Config, optional
        Settings of the recurrent baseline, of which it takes width, dropout and training; those of
        the first checkpoint by default.
    pictures : int
        Test clips to draw for every checkpoint.
    clips : sequence of str
        Patterns of clip names as in a shell, ``base-small-*``; all test clips by default.  Clips
        of other splits may be named, too; the text says which they are.
    against : str, optional
        Method whose errors the others' are divided by; the baseline of Santesteban et al. 2019 by
        default where it is scored, else the first checkpoint.
    per_clip : bool
        Whether the text has the tables of each clip too; ``report.json`` always has its figures.
    push_out : bool
        Whether each checkpoint is scored a second time with its vertices moved out of the body,
        and drawn so.
    rescore : bool
        Whether to score again what is in ``scores``.

    Returns
    -------
    str
        The text of ``report.txt``.

    Raises
    ------
    InputError
        If a checkpoint is of another garment or body, the store lacks test clips, a pattern
        matches none or `against` is not scored.
    """
    folder = Path(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    files = {_name(p, paths): p for p in paths}
    models = {name: load_checkpoint(p) for name, p in files.items()}
    for model in models.values():
        model.check_fits(store)
    first = next(iter(models.values()))
    config = first.networks[0].config
    roles, base = parameter_roles(store), _base(first, store)
    several = {k: m for k, m in models.items() if m.kernel is not None or m.networks[0].condition}
    chosen = matching(_candidates(store, base, roles, bool(several), clips), clips)
    bones = virtual_bones(store, config.bones, folder=bones_folder, progress=progress)
    bounds: dict[str, Method] = {"bones themselves": bones_themselves(bones)}
    methods = bounds | {k: network_method(m) for k, m in models.items()}
    digests = {k: digest_of_file(p) for k, p in files.items()}
    if push_out:
        for k in models:
            methods[_pushed(k)] = pushed_method(methods[k], store)
            digests[_pushed(k)] = f"{digests[k]} pushed out"
    digests["bones themselves"] = digest_of_file(bones.folder / "bones.json")
    if baselines:
        found, digest = baseline_methods(
            bones, recurrent or config, base, folder / "baselines", progress
        )
        methods |= found
        digests |= {name: f"{name} {digest}" for name in found}
    if against is None:
        against = SANTESTEBAN if baselines else next(iter(models))
    if against not in methods:
        raise InputError("against", f"one of {', '.join(methods)}", repr(against))
    scorer = Scorer(bones)
    cache = ScoreCache(
        folder / "scores",
        digests,
        identity=scorer.identity(),
        n_vertices=store.n_vertices,
        renew=rescore,
    )
    n_free = scorer.n_free
    document: dict[str, Any] = {
        "parameters": dataclasses.asdict(base),
        "vertices": {"all": store.n_vertices, "free": n_free},
        "bones": bones.report | {"test": bones.prepare(chosen["unseen_motions"], fit=True)},
    }
    lines: list[str] = [
        f"{name} is no test clip, but of the split {store.clip(name).split}"
        for name in chosen["unseen_motions"]
        if store.clip(name).split != "test"
    ]
    tables = _Tables(n_free, seeds_of(models), against, per_clip, lines)
    seen, rows = chosen["unseen_motions"], []
    if seen:
        rows = evaluate(bones, methods, seen, cache=cache, progress=progress)
        document["unseen_motions"] = [r.as_dict() for r in rows]
        document["ratios"] = ratios(rows, against)
        document["seeds"] = seed_figures(rows, tables.seeds)
        groups: dict[str, list[str]] = {}
        for name in seen:
            groups.setdefault(group_of(store.clip(name)), []).append(name)
        for group, names in groups.items():
            title = f"unseen motions, group {group}, {base}"
            part = [_of_clips(r, names, n_free) for r in rows]
            document.setdefault("groups", {})[group] = tables.add(title, part)
    for split in ("train", "test"):
        key = f"unseen_parameters_{split}"
        names = chosen.get(key, [])
        if names:
            reading = bounds | {k: methods[k] for k in several}
            unseen = evaluate(bones, reading, names, cache=cache, progress=progress)
            document[key] = [r.as_dict() for r in unseen]
            title = f"unseen parameters, {split} motions"
            document[f"{key}_ratios"] = tables.add(title, unseen)["ratios"]
    lines += _chaos(bones, base, roles, document)
    if seen:
        lines += _by_distance(bones, seen, rows, document)
        drawn = {k: methods.get(_pushed(k), methods[k]) for k in models}
        _draw(bones, drawn, seen, pictures, folder, document)
    lines += ["", *_timing(rows, cache, document), *cache.notices]
    text = "\n".join(lines) + "\n"
    write_file(folder / "report.json", json.dumps(document).encode())
    write_file(folder / "report.txt", text.encode())
    return text


def _pushed(name: str) -> str:
    return f"{name}, pushed out"


@dataclasses.dataclass(frozen=True, eq=False)
class _Tables:
    """Appends the tables of one list of clips after another to the lines of the text."""

    n_free: int
    seeds: list[dict[int, str]]
    against: str
    per_clip: bool
    lines: list[str]

    def add(self, title: str, rows: Sequence[Row]) -> dict[str, Any]:
        """Append the tables; rows, ratios and seeds for JSON, without what each clip has."""
        names = [r.name for r in rows]
        clips = rows[0].clips
        self.lines.append(f"{title}, clips: {len(clips)}, frames: {rows[0].frames}")
        self.lines.extend(score_tables(rows, self.n_free))
        seeds = seed_figures(rows, [s for s in self.seeds if set(s.values()) <= set(names)])
        # Baselines do not read parameters: the first checkpoint takes their place.
        against = self.against if self.against in names else names[1]
        divided = ratios(rows, against)
        for vertices in VERTICES if self.n_free < len(rows[0].per_vertex) else ("all",):
            if seeds:
                self.lines.extend(seed_table(seeds, vertices))
            self.lines.extend(ratio_table(divided, vertices))
        if self.per_clip:
            self.lines.extend(clip_tables(rows, self.n_free))
        plain = [r.as_dict() for r in rows]
        left_out = ("clips", "per_vertex")
        return {
            "clips": [c.clip for c in clips],
            "rows": [{k: v for k, v in row.items() if k not in left_out} for row in plain],
            "ratios": divided,
            "seeds": seeds,
        }


def _candidates(
    store: ClipStore,
    base: SimulationParameters,
    roles: dict[SimulationParameters, str],
    reads_parameters: bool,
    patterns: Sequence[str],
) -> dict[str, list[str]]:
    """Names of the clips of each part of the report; of other splits only what is named."""
    seen = [
        c.name
        for c in store.clips()
        if c.parameters == base
        and (c.split == "test" or any(fnmatchcase(c.name, p) for p in patterns))
    ]
    if not seen:
        raise InputError("store", f"test clips of {base}", str(store.path))
    names = {"unseen_motions": seen}
    splits: tuple[Split, ...] = ("train", "test")
    for split in splits if reads_parameters else ():
        unseen = [c.name for c in store.clips(split) if roles[c.parameters] == "test"]
        names[f"unseen_parameters_{split}"] = unseen
    return names


def _of_clips(row: Row, names: Sequence[str], n_free: int) -> Row:
    return pool(row.name, [c for c in row.clips if c.clip in names], n_free)


def _chaos(
    bones: VirtualBones,
    base: SimulationParameters,
    roles: dict[SimulationParameters, str],
    document: dict[str, Any],
) -> list[str]:
    store = bones.store
    pairs: dict[SimulationParameters, list[tuple[str, str]]] = {}
    for pair in store.pairs():
        pairs.setdefault(store.clip(pair[0]).parameters, []).append(pair)
    # Soft cloth has a higher floor than stiff cloth, so every parameter set has its own.
    floors = {p: chaos_floor(bones, names) for p, names in pairs.items()}
    document["chaos_floor"] = floors.get(base, {})
    document["chaos_floor_of_sets"] = {str(p): floor["all"] for p, floor in floors.items()}
    lines = [f"chaos floor, {key}: {_floor(v)}" for key, v in document["chaos_floor"].items()]
    return lines + [f"chaos floor, {p} ({roles[p]}): {_floor(f['all'])}" for p, f in floors.items()]


def _by_distance(
    bones: VirtualBones, seen: Sequence[str], rows: Sequence[Row], document: dict[str, Any]
) -> list[str]:
    mean, deviation = looseness(bones, seen)
    document["looseness"] = {"mean_mm": mean.tolist(), "deviation_mm": deviation.tolist()}
    lines = ["", "mean error (mm) by distance to the body, quarters of the vertices"]
    for row in rows:
        cells = "  ".join(f"{d:6.0f}: {e:6.1f}" for d, e in by_looseness(row, mean))
        lines.append(f"{row.name:<{name_width(rows)}}{cells}")
    return lines


def _draw(
    bones: VirtualBones,
    methods: dict[str, Method],
    seen: Sequence[str],
    pictures: int,
    folder: Path,
    document: dict[str, Any],
) -> None:
    for key, method in methods.items():
        for name in seen[:pictures]:
            clip = bones.store.clip(name)
            file = folder / f"{key}-{name}.png"
            with writing(file):
                draw_clip(bones, clip, method(clip), file)
        if pictures:
            file = folder / f"{key}-moments.png"
            with writing(file):
                document.setdefault("moments", {})[key] = draw_moments(bones, method, seen, file)


def _timing(rows: Sequence[Row], cache: ScoreCache, document: dict[str, Any]) -> list[str]:
    document["milliseconds_a_frame"] = {}
    for row in rows:
        times = {k: sum(getattr(c, k) for c in row.clips) for k in ("predicting", "scoring")}
        document["milliseconds_a_frame"][row.name] = {
            k: 1e3 * seconds / row.frames for k, seconds in times.items()
        }
    found = document["milliseconds_a_frame"]
    width = name_width(rows)
    lines = [
        f"{name:<{width}}predicting {t['predicting']:.1f}, scoring {t['scoring']:.1f} ms a frame"
        for name, t in found.items()
    ]
    return [*lines, f"scored now: {cache.written}, scored before: {cache.read}"]


def _floor(value: dict[str, float]) -> str:
    v = value
    return (
        f"{v['overall']:.2f} mm, low {v['low']:.2f} mm, free vertices {v['overall_free']:.2f} mm, "
        f"low {v['low_free']:.2f} mm ({v['frames']:.0f} frames)"
    )


def _base(model: Checkpoint, store: ClipStore) -> SimulationParameters:
    if model.kernel is None and model.parameters[0] is not None:
        return model.parameters[0]
    return store.parameters()[0]


def _name(path: Path, paths: Sequence[Path]) -> str:
    # Every run writes a file of the same name into a folder of its own.
    short = f"{path.parent.name}-{path.stem}" if path.parent.name else path.stem
    same = [p for p in paths if p.parent.name == path.parent.name and p.stem == path.stem]
    return short if len(same) == 1 else str(path.with_suffix("")).strip("/").replace("/", "-")
