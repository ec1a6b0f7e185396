"""Compiled inner loops, which do not check their arguments.

Callers pass C-contiguous float64 and int32 arrays (skinning also takes float32), so that each
kernel is compiled once.
"""
