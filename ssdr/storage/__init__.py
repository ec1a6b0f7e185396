"""Storage of a model: its size in bytes, and which keys of its bones can be left out."""
