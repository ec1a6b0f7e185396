"""Loose garments on a moving body, learned: the thin layer over :mod:`ssdr`.

Pan et al., "Predicting Loose-Fitting Garment Deformations Using Bone-Driven Motion Networks",
SIGGRAPH 2022.  What makes data is :mod:`garmentnet.scenes`, which no other module imports.
"""
