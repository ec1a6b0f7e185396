"""Before and after the solver: argument checks, the problem, choice of frames, and the outcome."""
