"""Skinning decomposition: rest pose, sparse skin weights and rigid bones from an animated mesh.

Names are imported when they are first used, so that ``import ssdr`` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public names by the module that defines them; the other public names are modules.
_PUBLIC = {
    "clips": ("Clip",),
    "decomposition": ("decompose",),
    "errors": (
        *("Cancelled", "FormatError", "InputError", "MissingDependencyError"),
        *("SsdrError", "SsdrWarning"),
    ),
    "driving": ("drive",),
    "expressions": ("Expressions", "decompose_expressions"),
    "fit.bones": ("fit_bones",),
    "fit.ssdr2012": ("ssdr2012",),
    "fit.start": ("initialize",),
    "fit.rest_pose": ("fit_rest_pose",),
    "fit.shapes": ("fit_shapes",),
    "fit.weights": ("fit_weights",),
    "io": ("list_clips", "load", "load_skinning", "save"),
    "joints.mirror": ("Mirror", "find_mirror"),
    "lbs": ("SkinGradients", "skin", "skin_gradients"),
    "levels_of_detail": ("LevelsOfDetail", "levels"),
    "parallel": ("get_threads", "set_threads"),
    "parsimony.smallest": ("smallest",),
    "result": ("Decomposition",),
    "rigid": ("kabsch",),
    "weight_rounding": ("round_weights",),
    "sequence": ("MeshSequence", "WeldReport"),
    "shapes": ("Shapes",),
    "skinning": ("Skinning",),
    "space": ("Space",),
    "start": ("Skeleton", "Start"),
    "surface": ("Material", "Surface"),
    "viewer.page": ("view",),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "Cancelled",
    "Clip",
    "Decomposition",
    "Expressions",
    "FormatError",
    "InputError",
    "LevelsOfDetail",
    "Material",
    "MeshSequence",
    "Mirror",
    "MissingDependencyError",
    "Shapes",
    "Skeleton",
    "SkinGradients",
    "Skinning",
    "Space",
    "SsdrError",
    "SsdrWarning",
    "Start",
    "Surface",
    "WeldReport",
    "__version__",
    "decompose",
    "decompose_expressions",
    "drive",
    "errors",
    "find_mirror",
    "fit_bones",
    "fit_rest_pose",
    "fit_shapes",
    "fit_weights",
    "get_threads",
    "initialize",
    "io",
    "kabsch",
    "laplacian",
    "levels",
    "list_clips",
    "load",
    "load_skinning",
    "metrics",
    "parallel",
    "parsimony",
    "rigid",
    "round_weights",
    "samples",
    "save",
    "sequence",
    "set_threads",
    "skin",
    "skin_gradients",
    "skinning",
    "smallest",
    "ssdr2012",
    "view",
]

if TYPE_CHECKING:
    from . import errors, io, metrics, parallel, rigid, samples, sequence, skinning
    from .clips import Clip
    from .decomposition import decompose
    from .driving import drive
    from .errors import (
        Cancelled,
        FormatError,
        InputError,
        MissingDependencyError,
        SsdrError,
        SsdrWarning,
    )
    from .expressions import Expressions, decompose_expressions
    from .fit.bones import fit_bones
    from .fit.rest_pose import fit_rest_pose
    from .fit.shapes import fit_shapes
    from .fit.ssdr2012 import ssdr2012
    from .fit.start import initialize
    from .fit.weights import fit_weights
    from .io import list_clips, load, load_skinning, save
    from .joints.mirror import Mirror, find_mirror
    from .lbs import SkinGradients, skin, skin_gradients
    from .levels_of_detail import LevelsOfDetail, levels
    from .parallel import get_threads, set_threads
    from .parsimony.smallest import smallest
    from .result import Decomposition
    from .rigid import kabsch
    from .sequence import MeshSequence, WeldReport
    from .shapes import Shapes
    from .skinning import Skinning
    from .space import Space
    from .start import Skeleton, Start
    from .surface import Material, Surface
    from .viewer.page import view
    from .weight_rounding import round_weights


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    elif name in __all__:
        value = importlib.import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
