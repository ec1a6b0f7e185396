"""Learned loose garments on a moving body: a thin layer on :mod:`ssdr`.

Pan et al., "Predicting Loose-Fitting Garment Deformations Using Bone-Driven Motion Networks",
SIGGRAPH 2022.

=========================  ==========================================================
``garmentnet.paper``       the paper's four parts, each from its section: bones (4.1,
                           equation 1), low (4.2, equation 2), high (4.3), ensemble
                           (4.4, equation 4); and train
``garmentnet.networks``    what the paper's parts are made of: features, GRU, detail by
                           components, the motion network, checkpoints (equation 3)
``garmentnet.training``    batches, the loop, targets
``garmentnet.data``        stores of clips, skeletons, simulation parameters
``garmentnet.importing``   stores of cloth and rigs of other programs; the quality gate
``garmentnet.collision``   distances to the body, vertices moved out of it
``garmentnet.evaluation``  errors beside baselines and bounds, reports, pictures
``garmentnet.prediction``  a checkpoint's garment for a motion, and files of it
``garmentnet.drawing``     body and cloth in pictures
``garmentnet.runtime``     the garment frame by frame without torch, from an ONNX file
``garmentnet.configs``     settings of a run
``garmentnet.io``          files and TOML tables
``garmentnet.cli``         the command
=========================  ==========================================================
"""
