"""Single steps of the solver, each usable alone: weights, bones, rest pose, or a start."""
