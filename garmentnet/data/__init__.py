"""Clips of a simulated garment, body motion and skeletons, without torch."""
