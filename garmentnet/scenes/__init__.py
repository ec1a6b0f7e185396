"""Simulation of data: body, dance, garment, cloth simulator, data sets.

Needs the extra ``scenes``.  Only the commands that simulate import it.
"""
