"""What a model takes to store: bytes, and which keys of its bones can be left out."""
