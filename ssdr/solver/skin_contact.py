"""Names of before, until their callers have changed."""

from .model import Fixed, Model
from .objective import Objective
from .trajectories import Trajectories

__all__ = ["judged"]


def judged(data: Trajectories, model: Model, fixed: Fixed) -> float:
    return Objective(fixed).value(data, model)
