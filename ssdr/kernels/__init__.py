"""Compiled inner loops; nothing here checks its arguments.

Callers hand over C-contiguous float64 and int32 arrays (skinning also takes
float32), so that each kernel is compiled once.
"""
