"""Settings of a training run: typed, read from TOML, stored in checkpoints.

``faithful.toml`` beside this module lists and explains all of them; they are the defaults.  Any
other file holds only the settings that differ.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from ssdr.common.errors import FormatError, InputError

from ..io.tables import from_table, parse_toml, read_toml

_PRESETS = Path(__file__).parent


@dataclasses.dataclass(frozen=True)
class DataOptions:
    """Choice of the clips on which a network is trained."""

    store: str = ""
    parameters: str = ""
    motions: str = ""
    leave_out: str = ""
    frames: int = 0
    mirror: bool = True
    condition: bool = False


@dataclasses.dataclass(frozen=True)
class BoneOptions:
    """Settings of the virtual bones and of the split by frequency; `length` is in metres."""

    length: float = 0.02
    count: int = 80
    influences: int = 8
    effort: Literal["fast", "balanced", "best"] = "balanced"
    frames: int = 1000
    motions: str = ""
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class FeatureOptions:
    """Settings of the pose features, a network's input, and of the moving frame of its output."""

    rotation: Literal["vector", "sixd"] = "vector"
    joints: tuple[str, ...] = ()
    heading_free: bool = False
    translation: bool = True
    velocities: bool = False
    root_motion: bool = False
    floor: float = 0.001
    clamp: float = 0.0
    frame: Literal["world", "root", "heading"] = "root"


@dataclasses.dataclass(frozen=True)
class LowOptions:
    """Settings of the low-frequency module."""

    hidden: int = 600
    rotation: Literal["euler", "sixd"] = "euler"
    relative_to: Literal["frame", "joints"] = "frame"
    laplacian: float = 1.0
    dropout: float = 0.0


@dataclasses.dataclass(frozen=True)
class HighOptions:
    """Settings of the high-frequency module."""

    kind: Literal["vertices", "basis"] = "vertices"
    hidden: int = 600
    source: Literal["bones", "body"] = "bones"
    target: Literal["detail", "residual"] = "residual"
    rank: int = 64
    local: bool = True
    global_features: int = 10
    edge_features: tuple[int, ...] = (8, 16)
    mlp: tuple[int, ...] = ()
    activation: Literal["relu", "prelu"] = "prelu"
    batch_norm: bool = True
    dropout: float = 0.5
    edge_dropout: float = 0.8
    collision: float = 0.1
    frames: int = 4


@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """Settings of the training loop."""

    seed: int = 0
    batch: int = 8
    window: int = 30
    learning_rate: float = 1e-3
    high_learning_rate: float = 1e-3
    weight_decay: float = 0.0
    gradient_norm: float = 1.0
    epochs: int = 48
    high_epochs: int = 12
    validate_every: int = 2
    patience: int = 10
    threads: int = 0
    precision: Literal["single", "bfloat16", "auto"] = "auto"
    device: str = "auto"
    tensorboard: bool = True


@dataclasses.dataclass(frozen=True)
class EnsembleOptions:
    """Settings of the pivots and of the kernel that mixes them."""

    pivots: int = 0
    frames: int = 60
    steps: int = 600


@dataclasses.dataclass(frozen=True)
class Config:
    """All settings of a training run; ``faithful.toml`` explains each.

    Raises
    ------
    InputError
        If a number is out of its range.

    Examples
    --------
    >>> Config(low=LowOptions(hidden=64)).low.rotation
    'euler'
    """

    data: DataOptions = DataOptions()
    bones: BoneOptions = BoneOptions()
    features: FeatureOptions = FeatureOptions()
    low: LowOptions = LowOptions()
    high: HighOptions = HighOptions()
    train: TrainOptions = TrainOptions()
    ensemble: EnsembleOptions = EnsembleOptions()

    def __post_init__(self) -> None:
        for section in dataclasses.fields(self):
            part = getattr(self, section.name)
            for field in dataclasses.fields(part):
                value = getattr(part, field.name)
                name = f"{section.name}.{field.name}"
                if isinstance(value, float) and not (math.isfinite(value) and value >= 0):
                    raise InputError(name, "a number >= 0", value)
                if "dropout" in field.name and value >= 1:
                    raise InputError(name, "a fraction below 1", value)
                low = 0 if field.name in _ZERO or name == "data.frames" else 1
                for number in value if isinstance(value, tuple) else (value,):
                    if type(number) is int and number < low:
                        raise InputError(name, f"an integer >= {low}", number)
        if self.high.kind == "basis" and self.high.collision:
            expected = 'collision = 0 where kind = "basis", which computes no mesh in training'
            raise InputError("high.collision", expected, self.high.collision)


# Integers that may be 0; all others are at least 1.
_ZERO = ("seed", "threads", "pivots", "high_epochs")


def preset_names() -> list[str]:
    """Names of the configurations that ship with the package.

    Examples
    --------
    >>> preset_names()
    ['faithful', 'rooted', 'tiny']
    """
    return sorted(path.stem for path in _PRESETS.glob("*.toml"))


def load_config(path: Path | str) -> Config:
    """Read a configuration from a TOML file, or a preset by its name.

    Raises
    ------
    InputError
        If there is neither such a file nor such a preset, or a number is out of range.
    FormatError
        If the file is not TOML or a setting is unknown or of the wrong type.

    Examples
    --------
    >>> load_config("rooted").low.rotation
    'sixd'
    """
    file = _PRESETS / f"{path}.toml" if str(path) in preset_names() else Path(path)
    if not file.is_file():
        presets = ", ".join(preset_names())
        raise InputError("config", f"a TOML file or one of {presets}", str(path))
    return from_table(Config, read_toml(file), file=str(file))


def override(config: Config, changes: Sequence[str]) -> Config:
    """Copy of a configuration with changes such as ``section.name=value``, with values as in TOML.

    Raises
    ------
    FormatError
        If a change cannot be read, or the setting is unknown or of another type.

    Examples
    --------
    >>> override(Config(), ["train.seed=3", "high.mlp=[16, 16]"]).high.mlp
    (16, 16)
    """
    table = dataclasses.asdict(config)
    for change in changes:
        path, sign, value = change.partition("=")
        section, dot, name = path.strip().partition(".")
        if not (sign and dot and section in table and name in table[section]):
            raise FormatError(f"{change}: expected section.name=value with a setting that exists")
        try:
            table[section][name] = parse_toml(f"value = {value}", change)["value"]
        except FormatError:
            table[section][name] = value.strip()  # a plain word needs no quotes
    return from_table(Config, table, file=", ".join(changes))
