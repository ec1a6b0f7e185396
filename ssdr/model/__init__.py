"""Skinned models: linear blend skinning, rigid motions, trees, stored keys and bytes, errors."""
