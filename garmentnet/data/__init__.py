"""Clips of a simulated garment, body motion, skeletons and virtual bones; no torch here."""
