"""A trained network's garment for a motion, and files of it."""
