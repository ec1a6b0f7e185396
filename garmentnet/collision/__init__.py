"""Cloth against the body: distances to the skin, and vertices moved out of it."""
