"""Dances generated from a seed: moves, their choreography and the joints."""
