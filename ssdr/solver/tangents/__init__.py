"""Tangents: the unknowns by which a Gauss–Newton step moves the bones, one class a bone model."""

from .affine import AffineTangent
from .chain import ChainTangent
from .rigid import RigidTangent
from .similarity import SimilarityTangent
from .tangent import Tangent

__all__ = ["AffineTangent", "ChainTangent", "RigidTangent", "SimilarityTangent", "Tangent"]
