"""Settings of a training run: typed, read from TOML, stored in checkpoints.

``faithful.toml`` beside this module lists and explains all of them; they are the defaults.  Any
other file holds only the settings that differ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from ssdr.common.errors import FormatError, InputError

from ..io.tables import from_table, parse_toml, read_toml

_PRESETS = Path(__file__).parent
# Ranges, which are checked where a file or a checkpoint is read.
Count = Annotated[int, Meta(ge=1)]
Number = Annotated[int, Meta(ge=0)]
Amount = Annotated[float, Meta(ge=0, le=1e9)]  # finite
Positive = Annotated[float, Meta(gt=0, le=1e9)]
Share = Annotated[float, Meta(ge=0, lt=1)]


@dataclasses.dataclass(frozen=True)
class DataOptions:
    """Choice of the clips on which a network is trained."""

    parameters: str = ""
    motions: str = ""
    leave_out: str = ""
    frames: Number = 0
    mirror: bool = True
    condition: bool = False


@dataclasses.dataclass(frozen=True)
class BoneOptions:
    """Settings of the virtual bones and of the split by frequency; `length` is in metres."""

    length: Amount = 0.02
    count: Count = 80
    influences: Count = 8
    effort: Literal["fast", "balanced", "best"] = "balanced"
    frames: Count = 1000
    motions: str = ""
    seed: Number = 0


@dataclasses.dataclass(frozen=True)
class FeatureOptions:
    """Settings of the pose features, a network's input, and of the moving frame of its output."""

    rotation: Literal["vector", "sixd"] = "vector"
    joints: tuple[str, ...] = ()
    heading_free: bool = False
    translation: bool = True
    velocities: bool = False
    root_motion: bool = False
    joint_motion: bool = False
    floor: Amount = 0.001
    clamp: Amount = 0.0
    frame: Literal["world", "root", "heading"] = "root"


@dataclasses.dataclass(frozen=True)
class LowOptions:
    """Settings of the low-frequency module."""

    hidden: Count = 600
    rotation: Literal["euler", "sixd"] = "euler"
    relative_to: Literal["frame", "joints"] = "frame"
    laplacian: Amount = 1.0
    dropout: Share = 0.0


@dataclasses.dataclass(frozen=True)
class HighOptions:
    """Settings of the high-frequency module."""

    kind: Literal["vertices", "basis"] = "vertices"
    hidden: Count = 600
    source: Literal["bones", "body"] = "bones"
    target: Literal["detail", "residual"] = "residual"
    rank: Count = 64
    local: bool = True
    global_features: Count = 10
    edge_features: tuple[Count, ...] = (8, 16)
    batch_norm: bool = True
    dropout: Share = 0.5
    edge_dropout: Share = 0.8
    collision: Amount = 0.1
    frames: Annotated[int, Meta(ge=2)] = 4  # a single one has no variance to normalise by


@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """Settings of the training loop."""

    seed: Number = 0
    batch: Count = 8
    window: Count = 30
    learning_rate: Positive = 1e-3
    high_learning_rate: Positive = 1e-3
    weight_decay: Amount = 0.0
    gradient_norm: Positive = 1.0
    epochs: Count = 48
    high_epochs: Number = 12
    validate_every: Count = 2
    patience: Count = 10
    threads: Number = 0
    device: Annotated[str, Meta(pattern=r"^(auto|cpu|mps|cuda(:\d+)?)$")] = "auto"


@dataclasses.dataclass(frozen=True)
class EnsembleOptions:
    """Settings of the pivots and of the kernel that mixes them."""

    pivots: Number = 0
    frames: Count = 60
    steps: Count = 600


@dataclasses.dataclass(frozen=True)
class Config:
    """All settings of a training run; ``faithful.toml`` explains each.

    Raises
    ------
    InputError
        If the detail by components has a weight of collisions.

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
        if self.high.kind == "basis" and self.high.collision:
            expected = 'collision = 0 where kind = "basis", which computes no mesh in training'
            raise InputError("high.collision", expected, self.high.collision)


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
        If there is neither such a file nor such a preset.
    FormatError
        If the file is not TOML, or a setting is unknown, of the wrong type or out of its range.

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
        If a change cannot be read, or the setting is unknown, of another type or out of its range.

    Examples
    --------
    >>> override(Config(), ["train.seed=3", "high.edge_features=[8, 8]"]).high.edge_features
    (8, 8)
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
