"""Compiled inner loops, which do not check their arguments.

Callers pass C-contiguous float64 and int32 arrays (float32 only for skinning), so that each kernel
is compiled once.
"""
