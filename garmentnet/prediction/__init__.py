"""Prediction of a garment for a motion by a trained network, and files of the result."""
