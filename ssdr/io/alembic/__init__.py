"""Alembic: caches of moving meshes, by alembic3d."""
