"""Between a call and its solution: checked arguments, progress, choice of frames, the answer."""
