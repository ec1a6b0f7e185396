"""Learned loose garments on a moving body: a thin layer on :mod:`ssdr`.

Pan et al., "Predicting Loose-Fitting Garment Deformations Using Bone-Driven Motion Networks",
SIGGRAPH 2022.

=========================  ==========================================================
``garmentnet.importing``   stores of cloth and rigs of other programs
``garmentnet.data``        clips, motion, skeletons, motion capture, virtual bones
``garmentnet.collision``   distances to the body, vertices moved out of it
``garmentnet.networks``    the modules, the motion network, the ensemble, checkpoints
``garmentnet.training``    batches, losses, the loop, runs, ensembles
``garmentnet.evaluation``  errors beside baselines and bounds, reports, pictures
``garmentnet.prediction``  a checkpoint's garment for a motion, and files of it
``garmentnet.drawing``     body and cloth in pictures
``garmentnet.runtime``     the garment frame by frame without torch, and as ONNX
``garmentnet.viewer``      a page that predicts the garment in the browser
``garmentnet.configs``     settings of a run
``garmentnet.io``          files and TOML tables
``garmentnet.cli``         the command
=========================  ==========================================================

The paper's equations: 1 in ``networks.skinning``, 2 in ``training.low_frequency``, 3 in
``networks.checkpoint``, 4 in ``networks.ensemble``, whose kernel ``training.pivots`` fits.
"""
