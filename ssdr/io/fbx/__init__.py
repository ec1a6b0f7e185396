"""FBX: read by ufbx; written through Blender, see the package ``blender``."""
