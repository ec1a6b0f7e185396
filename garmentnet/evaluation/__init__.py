"""Errors on unseen clips, beside baselines and bounds."""
