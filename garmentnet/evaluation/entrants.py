"""The baselines as methods; each is fitted when it is first asked for a prediction."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..configs.config import Config
from ..data.parameters import SimulationParameters
from ..data.virtual_bones import VirtualBones
from ..training.run import choose_clips, with_mirrored
from . import baselines, santesteban
from .baselines import BodySkinned, MeanShape, Ridge
from .clip_scores import Later, Method
from .santesteban import Santesteban, train_santesteban
from .score_cache import digest_of_clips, digest_of_file
from .scores import plain_method

__all__ = ["SANTESTEBAN", "baseline_methods"]

SANTESTEBAN = "Santesteban 2019"


def baseline_methods(
    bones: VirtualBones,
    config: Config,
    base: SimulationParameters,
    folder: Path,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[dict[str, Method], str]:
    """The baselines on the training clips of one parameter set.

    Parameters
    ----------
    bones : VirtualBones
    config : Config
        Whose features, width and limits the recurrent baseline has.
    base : SimulationParameters
    folder : Path
        Of the recurrent baseline's training.
    progress : callable, optional

    Returns
    -------
    dict of methods, str
        The latter a hash of everything that they are fitted to, and of the code.

    Raises
    ------
    InputError
        If the store lacks training or validation clips of these parameters.
    """
    store = bones.store
    text = ",".join(repr(v) for v in dataclasses.astuple(base))
    data = dataclasses.replace(config.data, parameters=text, condition=False)
    plain = dataclasses.replace(config, data=data)
    names, _ = choose_clips(store, plain)
    held, _ = choose_clips(store, plain, "validation")
    learned = with_mirrored(store, config, names)

    def after_epoch(p: Any) -> bool:
        if progress:
            progress(f"training {SANTESTEBAN}", p.fraction)
        return False

    def train() -> Santesteban:
        bones.prepare([*names, *held])
        return train_santesteban(bones, config, learned, held, folder, callback=after_epoch)

    methods: dict[str, Method] = {
        "mean shape": _later(bones, lambda: MeanShape(bones, names)),
        "body-skinned": _later(bones, lambda: BodySkinned(store)),
        "ridge": _later(bones, lambda: Ridge(bones, names, held)),
        SANTESTEBAN: _later(bones, train),
    }
    inputs = [
        json.dumps(config.as_dict(), sort_keys=True),
        digest_of_file(bones.folder / "bones.json"),
        digest_of_clips(store, [*names, *held]),
        *(digest_of_file(Path(str(m.__file__))) for m in (baselines, santesteban)),
    ]
    return methods, json.dumps(inputs)


def _later(bones: VirtualBones, fit: Callable[[], Any]) -> Later:
    def method() -> Method:
        baseline, bound = fit(), bones.bound

        def predict(joints: Any) -> Any:
            vertices = baseline.predict(joints)
            # What the body carries is known to every method.
            return vertices if bound is None else bound.place(vertices, joints)

        return plain_method(bones, predict)

    # Fitting reads all training frames; where all scores are known it is not needed.
    return Later(method)
