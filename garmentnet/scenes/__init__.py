"""Simulation of data: body, dance, garment, cloth simulator, data sets.

Making another body than the one that ships needs the extra ``scenes``.
"""
