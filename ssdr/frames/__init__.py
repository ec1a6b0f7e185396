"""Passes over frames on disk or in a store, in this process or on the workers of a cluster."""
