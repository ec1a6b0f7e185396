"""Passes over frames that are not in memory: on disk, in a store, on the workers of a cluster."""
