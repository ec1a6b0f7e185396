"""Errors of networks, baselines and bounds on unseen clips."""
