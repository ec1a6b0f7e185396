"""Evaluation of checkpoints on a store, as a report in a folder."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from ssdr.common.errors import InputError
from ssdr.io.atomic import write_bytes

from ..data.clip import CLASSES, Clip
from ..data.parameters import SimulationParameters
from ..data.store import ClipStore
from ..drawing.dressed import draw_clip
from ..io.files import Progress, silent
from ..networks.checkpoint import Checkpoint, load_checkpoint
from ..paper.bones import parameter_roles, virtual_bones
from ..paper.train import choose_clips
from .baselines import fit_baselines
from .limbs import count_limbs, limbs_table
from .methods import BonesThemselves, Chaos, Method, Network
from .scores import VERTICES, Scores, evaluate
from .tables import class_table, mode_table, score_table

_NUMBER = re.compile(r"[-_]\d+\Z")
RECORDED = "recorded"
_MOTIONS = "unseen motions, "  # beginning of the titles of sections; their groups follow


def report(
    paths: Sequence[Path],
    store: ClipStore,
    folder: Path | str,
    *,
    baselines: bool = True,
    pictures: int = 1,
    clips: Sequence[str] = (),
    progress: Progress = silent,
) -> str:
    """Score checkpoints on unseen motions and, if they read parameters, unseen parameters.

    Parameters
    ----------
    paths : sequence of Path
        Checkpoints on one set of virtual bones.
    store : ClipStore
    folder : path
        Folder for ``report.md``, ``report.json`` and pictures.
    baselines : bool
        Whether to fit and score baselines, too.
    pictures : int
        Test clips to draw for every checkpoint.
    clips : sequence of str
        Patterns of clip names as in a shell, such as ``base-dance-220*``; by default all test
        clips.

    Returns
    -------
    str
        The text of ``report.md``.

    Raises
    ------
    InputError
        If a checkpoint is of another garment, body, split by frequency or parameters than the
        first, the store lacks test clips, or a pattern matches none.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    networks = [Network(_name(p, paths), load_checkpoint(p)) for p in paths]
    first = networks[0].checkpoint
    config, base = first.networks[0].config, _base(first, store)
    for network in networks:
        of = network.checkpoint
        of.subject.check_fits(store)
        theirs = of.networks[0].config
        for name, known, other in (
            ("bones.length", config.bones.length, theirs.bones.length),
            ("data.leave_out", config.data.leave_out, theirs.data.leave_out),
            ("parameters", base, _base(of, store)),
        ):
            if other != known:
                raise InputError("checkpoints", f"{name} {known}, as of the first", other)
    reading = [n for n in networks if n.checkpoint.reads_parameters]
    test: Sequence[str] = store.names("test", base)
    if config.data.leave_out:
        test = choose_clips(store, config, "test", base)[0] or test
    sections = _sections(store, base, test, bool(reading), clips)
    bones = virtual_bones(store, config.bones, subject=first.subject, progress=progress)
    bound, chaos = BonesThemselves(), Chaos(store)
    methods: list[Method] = [bound, *networks]
    if baselines:
        names, held = (choose_clips(store, config, s, base)[0] for s in ("train", "validation"))
        methods += fit_baselines(bones, names, held)
    document: dict[str, Any] = {
        "parameters": dataclasses.asdict(base),
        "bones": bones.report,
        "groups": {},
    }
    lines = ["RMSE and Hausdorff distance in mm"]
    for title, names in sections.items():
        # Baselines do not read parameters.
        entered = methods if title.startswith(_MOTIONS) else [bound, *reading]
        rows = evaluate(bones, entered, names, progress=progress)
        if twins := [n for n in names if n in chaos.twins]:
            rows += evaluate(bones, [chaos], twins, progress=progress)
        lines += _section(title, rows, document)
        limbs = count_limbs(bones, networks if entered is methods else reading, names)
        if limbs:
            found = document["groups"][title.removeprefix(_MOTIONS)]
            found["limbs"] = limbs
            lines += [limbs_table(limbs), ""]
    text = "\n".join(lines) + "\n"
    write_bytes(folder / "report.json", json.dumps(document).encode())
    write_bytes(folder / "report.md", text.encode())
    motions = [n for title in sections if title.startswith(_MOTIONS) for n in sections[title]]
    for network in networks:
        for name in motions[:pictures]:
            clip, file = store.clip(name), folder / f"{network.name}-{name}.png"
            draw_clip(clip, np.add(*network.split(clip, bones)), file)
    return text


def group_of(clip: Clip) -> str:
    """The group of test clips that a clip belongs to.

    "recorded" for motion capture; else the motion's name without the number at its end.

    Examples
    --------
    The motions ``dance-22000`` and ``more-100000`` are of the groups ``dance`` and ``more``.
    """
    source = clip.provenance.get("motion")
    file = source.get("file") if isinstance(source, Mapping) else None
    if file or (clip.classes == CLASSES.index(RECORDED)).all():
        return RECORDED
    return _NUMBER.sub("", clip.motion)


def _sections(
    store: ClipStore,
    base: SimulationParameters,
    test: Sequence[str],
    unseen_parameters: bool,
    patterns: Sequence[str],
) -> dict[str, list[str]]:
    """Names of the clips of each section of the report, by its title."""
    found: dict[str, list[str]] = {}
    for name in test:
        found.setdefault(_MOTIONS + group_of(store.clip(name)), []).append(name)
    if not found:
        raise InputError("store", f"test clips of {base}", str(store.path))
    roles = parameter_roles(store)
    for split in ("train", "test") if unseen_parameters else ():
        of_test = [c.name for c in store.clips(split) if roles[c.parameters] == "test"]
        found[f"unseen parameters {split}"] = of_test
    known = sorted({n for names in found.values() for n in names})
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            some = ", ".join(known[:8]) + (f" and {len(known) - 8} more" if len(known) > 8 else "")
            raise InputError("clips", f"a pattern of test clips ({some})", repr(pattern))
    wanted = patterns or ("*",)
    chosen = {
        title: [n for n in names if any(fnmatchcase(n, p) for p in wanted)]
        for title, names in found.items()
    }
    return {title: names for title, names in chosen.items() if names}


def _section(title: str, rows: Sequence[Scores], document: dict[str, Any]) -> list[str]:
    """Lines of a section with the tables of `rows`; their figures are added to `document`."""
    group, count = title.removeprefix(_MOTIONS), len(rows[0].clips)
    document["groups"][group] = {"rows": [dataclasses.asdict(r) for r in rows]}
    lines = ["", f"## {title}: {count} clips, {rows[0].frames} frames", ""]
    pinned = any(r.free != r.all for r in rows)
    for vertices in VERTICES if pinned else VERTICES[:1]:
        lines += [score_table(rows, vertices), "", class_table(rows, vertices), ""]
    return [*lines, mode_table(rows), ""]


def _base(model: Checkpoint, store: ClipStore) -> SimulationParameters:
    if model.kernel is None and model.parameters[0] is not None:
        return model.parameters[0]
    return store.parameters()[0]


def _name(path: Path, paths: Sequence[Path]) -> str:
    # Every run writes a file of the same name into a folder of its own.
    short = f"{path.parent.name}-{path.stem}" if path.parent.name else path.stem
    same = [p for p in paths if p.parent.name == path.parent.name and p.stem == path.stem]
    return short if len(same) == 1 else str(path.with_suffix("")).strip("/").replace("/", "-")
