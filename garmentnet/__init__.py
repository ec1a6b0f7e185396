"""Learned loose garments on a moving body: a thin layer on :mod:`ssdr`.

Pan et al., "Predicting Loose-Fitting Garment Deformations Using Bone-Driven Motion Networks",
SIGGRAPH 2022.

=========================  ==========================================================
``garmentnet.scenes``      simulates data: body, dance, garment, cloth
``garmentnet.data``        clips, motion, skeletons, motion capture, virtual bones
``garmentnet.networks``    the modules, the motion network, the ensemble, checkpoints
``garmentnet.training``    batches, losses, the loop, runs, ensembles
``garmentnet.evaluation``  errors beside baselines and bounds, reports, pictures
``garmentnet.prediction``  a checkpoint's garment for a motion, and files of it
``garmentnet.runtime``     the garment frame by frame without torch, and as ONNX
``garmentnet.configs``     settings of a run
``garmentnet.io``          files and TOML tables
``garmentnet.cli``         the command
=========================  ==========================================================
"""
