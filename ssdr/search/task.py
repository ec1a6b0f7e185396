"""What a call asks for, and the runs that it comes to, on all frames or on some of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..sequence import MeshSequence
from ..solver.model import Fixed, Model
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Array, Trajectories, gather
from ..streaming.executor import Executor
from ..streaming.passes import AllFrames, carried
from ..streaming.scan import Scan, subset
from .problem import Given, Parts, fingerprint, normalise
from .run import Run
from .schedule import make_plan, settling_plan

__all__ = ["Task", "best_of"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """A checked call of ``decompose``.

    Attributes
    ----------
    sequences : list of MeshSequence
    parts : Parts
        What was handed over, of all frames.
    importance : (V,) array or None
    frame_importance : (F,) array or None
    executor : Executor or None
        Who reads frames that are not in memory.
    """

    sequences: Sequence[MeshSequence]
    bones: int
    influences: int
    effort: str
    rng: np.random.Generator
    parts: Parts
    fixed: Fixed
    rest_frame: int
    smoothness: float
    importance: Array | None
    frame_importance: Array | None
    executor: Executor | None

    def first(self, found: Scan | None, began: float) -> tuple[Run, str]:
        """The effort's own run, and the fingerprint of its input.

        On all frames, or on the telling ones, each of which counts as much as the
        frames that it stands for.
        """
        weights = self.frame_importance
        data, parts, given = self._frames(
            None if found is None else found.chosen,
            weights if found is None else found.importance(weights),
        )
        smooth = self._smooth(data)
        plan = make_plan(
            self.effort, fixed=self.fixed, bones=self.bones, given=given,
            smooth=smooth is not None, size=float(data.n_vertices) * data.n_frames * self.bones,
        )  # fmt: skip
        run = Run(
            data, plan, bones=self.bones, influences=min(self.influences, self.bones),
            rng=self.rng, fixed=self.fixed, given=given, smooth=smooth, began=began,
        )  # fmt: skip
        faces = None if smooth is None else self.sequences[0].faces
        return run, fingerprint(data, parts, faces)

    def second(self, few: Scan, more: Scan, first: Run) -> Run:
        """What settles the model of the first run, on telling frames, on more of them.

        Telling frames alone, few and extreme, lead weights to follow what only they do.
        """
        first.release()
        weights = self.frame_importance
        data, _, given = self._frames(
            more.chosen, None if weights is None else weights[more.chosen]
        )
        smooth = self._smooth(data)
        run = first.followed_by(data, settling_plan(self.effort, smooth is not None), given, smooth)
        if first.best is not None:  # else it is restored
            run.model = carried(
                first.best, few.nearest[more.chosen], first.data.scale / data.scale,
                given.transforms, self.fixed,
            )  # fmt: skip
        return run

    def all_frames(self, found: Scan, run: Run) -> AllFrames:
        """The model of a run on some frames, ready for passes over all of them."""
        fixed = self.fixed
        if run.smooth is not None:
            # a pass knows nothing of the penalty: weights stay as the run left them
            fixed = dataclasses.replace(fixed, weights=np.ones(run.data.n_vertices, dtype=bool))
        return AllFrames(
            self.sequences, found, run.data, best_of(run), fixed=fixed,
            given=normalise(found.alignment, self.parts, 0).transforms,
            importance=self.frame_importance, executor=self.executor,
        )  # fmt: skip

    def _frames(
        self, chosen: NDArray[np.int64] | None, weights: Array | None
    ) -> tuple[Trajectories, Parts, Given]:
        """Frames in memory, all of them by default, and what was handed over of these."""
        sequences, parts, rest_frame = self.sequences, self.parts, self.rest_frame
        if chosen is not None:
            sequences = [subset(sequences, chosen, executor=self.executor)]
            rest_frame = int(np.searchsorted(chosen, rest_frame))
            if parts.transforms is not None:
                some = np.ascontiguousarray(parts.transforms[chosen])
                parts = dataclasses.replace(parts, transforms=some)
        data = gather(
            sequences, bones=self.bones, vertex_importance=self.importance,
            frame_importance=weights, compress=False,
        )  # fmt: skip
        return data, parts, normalise(data, parts, rest_frame)

    def _smooth(self, data: Trajectories) -> WeightSmoothness | None:
        return WeightSmoothness.build(data, self.sequences[0].faces, self.smoothness)


def best_of(run: Run) -> Model:
    """Of the bones asked for; a run has one after its first steps."""
    assert run.best is not None
    return run.best
