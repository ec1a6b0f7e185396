"""Runs of the solver: stages of a schedule, changes that improve a model, and the best model."""
