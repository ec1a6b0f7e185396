"""Tangents: the unknowns by which a Gauss–Newton step moves bones, a class per bone model."""

from .chain import ChainTangent
from .tangent import AffineTangent, RigidTangent, SimilarityTangent, Tangent

__all__ = ["AffineTangent", "ChainTangent", "RigidTangent", "SimilarityTangent", "Tangent"]
