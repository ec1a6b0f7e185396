"""The motion network of a garment, made of the paper's modules, and its checkpoints."""
