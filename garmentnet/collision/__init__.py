"""Collision of cloth with the body: distances to the skin, and vertices moved out of the body."""
