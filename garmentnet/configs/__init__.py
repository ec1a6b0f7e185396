"""Settings of a training run, and the presets that ship (TOML)."""

from .config import (
    BoneOptions,
    Config,
    DataOptions,
    EnsembleOptions,
    FeatureOptions,
    HighOptions,
    LowOptions,
    TrainOptions,
    load_config,
    override,
    preset_names,
)

__all__ = [
    "BoneOptions",
    "Config",
    "DataOptions",
    "EnsembleOptions",
    "FeatureOptions",
    "HighOptions",
    "LowOptions",
    "TrainOptions",
    "load_config",
    "override",
    "preset_names",
]
