"""Bones that hang on joints: where joints are, which tree, and the search for a better one."""
