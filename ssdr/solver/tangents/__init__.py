"""Tangents: the unknowns by which a Gauss–Newton step moves bones, a class per bone model."""

from .affine import AffineTangent
from .chain import ChainTangent
from .rigid import RigidTangent
from .similarity import SimilarityTangent
from .tangent import Tangent

__all__ = ["AffineTangent", "ChainTangent", "RigidTangent", "SimilarityTangent", "Tangent"]
