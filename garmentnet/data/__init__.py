"""Clips of a simulated garment, body motion, skeletons and virtual bones, without torch."""
