"""Joints of bones: their places, the tree that they span, limbs, mirror images."""
