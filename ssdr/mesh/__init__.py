"""Animated meshes: sequences of frames, clips, surface, normals, walks over frames."""
