"""Simulation of data: body, dance, garment, cloth simulator, data sets.

Making another body than the one that lies here needs ``anny``.
"""
