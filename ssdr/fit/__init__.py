"""One step of the solver alone, for parts that a caller has: weights, bones, rest pose, a start."""
