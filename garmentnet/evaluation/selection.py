"""What is compared with what: groups of test clips, and checkpoints that differ in seed alone."""

from __future__ import annotations

import fnmatch
import hashlib
import json
import re
from collections.abc import Mapping, Sequence

import numpy as np

from ssdr.errors import InputError

from ..data.clip import Clip
from ..data.motion import CLASSES
from ..networks.checkpoint import Checkpoint

__all__ = ["group_of", "matching", "seeds_of"]

_NUMBER = re.compile(r"[-_]\d+\Z")
_RECORDED = "recorded"


def group_of(clip: Clip) -> str:
    """The group of test clips that a clip belongs to.

    "recorded" for motion capture; else the motion's name without the number at its end.

    Examples
    --------
    The motions ``dance-22000`` and ``small-2010`` are of the groups ``dance`` and ``small``.
    """
    source = clip.provenance.get("motion")
    file = source.get("file") if isinstance(source, Mapping) else None
    if file or (clip.classes == CLASSES.index(_RECORDED)).all():
        return _RECORDED
    return _NUMBER.sub("", clip.motion)


def matching(names: Mapping[str, Sequence[str]], patterns: Sequence[str]) -> dict[str, list[str]]:
    """The clips of each list whose names match a pattern, as in a shell; all without patterns.

    Raises
    ------
    InputError
        If a pattern matches no clip.
    """
    known = sorted({n for part in names.values() for n in part})
    for pattern in patterns:
        if not fnmatch.filter(known, pattern):
            shown = ", ".join(known[:8]) + (f" and {len(known) - 8} more" if len(known) > 8 else "")
            raise InputError("clips", f"a pattern of test clips ({shown})", repr(pattern))
    return {
        key: [n for n in part if not patterns or any(fnmatch.fnmatchcase(n, p) for p in patterns)]
        for key, part in names.items()
    }


def seeds_of(models: Mapping[str, Checkpoint]) -> list[dict[int, str]]:
    """Checkpoints of one configuration and one set of training clips that differ in their seed.

    Returns
    -------
    list of dict
        For each such set of at least two, the names by ``train.seed``; of several with one seed
        the first.
    """
    alike: dict[str, dict[int, str]] = {}
    for name, model in models.items():
        alike.setdefault(_without_seed(model), {}).setdefault(_seed(model), name)
    return [names for names in alike.values() if len(names) > 1]


def _seed(model: Checkpoint) -> int:
    return model.networks[0].config.train.seed


def _without_seed(model: Checkpoint) -> str:
    h = hashlib.sha256()
    for network, parameters in zip(model.networks, model.parameters, strict=True):
        table = network.config.as_dict()
        table["train"] = {k: v for k, v in table["train"].items() if k != "seed"}
        h.update(json.dumps([table, str(parameters)], sort_keys=True).encode())
        # A configuration does not name its clips; the statistics of the inputs tell them apart.
        h.update(np.asarray(network.normaliser.mean, np.float32).tobytes())
    return h.hexdigest()
