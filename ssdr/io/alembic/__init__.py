"""Alembic: caches of moving meshes, by alembic3d or, where that is missing, by Blender."""
