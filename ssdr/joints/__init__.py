"""Bones attached at joints: places of the joints, the tree, and the search for a better tree."""
