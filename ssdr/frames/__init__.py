"""Walks over frames that stay where they are: on disk, in a store, on the workers of a cluster."""
