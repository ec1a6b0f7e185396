"""Every setting of a training run: typed, read from TOML, written into checkpoints.

``faithful.toml`` and ``rooted.toml`` beside this module list all of them with
comments; a file of one's own needs only those that differ from the defaults,
which are the faithful ones.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from ssdr.errors import FormatError, InputError

from ..io.tables import from_table, parse_toml, read_toml

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


@dataclasses.dataclass(frozen=True)
class DataOptions:
    store: str = ""
    parameters: str = ""
    mirror: bool = True
    condition: bool = False


@dataclasses.dataclass(frozen=True)
class BoneOptions:
    length: float = 0.02
    count: int = 80
    influences: int = 8
    effort: Literal["fast", "balanced", "best"] = "balanced"
    frames: int = 1000
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class FeatureOptions:
    rotation: Literal["vector", "sixd"] = "vector"
    heading_free: bool = False
    translation: bool = True
    velocities: bool = False
    root_motion: bool = False
    floor: float = 0.001
    clamp: float = 0.0
    frame: Literal["world", "root", "heading"] = "root"


@dataclasses.dataclass(frozen=True)
class LowOptions:
    hidden: int = 600
    rotation: Literal["euler", "vector", "sixd"] = "euler"
    laplacian: float = 1.0
    dropout: float = 0.0


@dataclasses.dataclass(frozen=True)
class HighOptions:
    hidden: int = 600
    source: Literal["bones", "body"] = "bones"
    local: bool = True
    global_features: int = 10
    edge_features: tuple[int, ...] = (8, 8, 16)
    mlp: tuple[int, ...] = (32,)
    collision: float = 0.1
    frames: int = 4


@dataclasses.dataclass(frozen=True)
class TrainOptions:
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
    time_limit: float = 0.0
    threads: int = 0
    device: str = "auto"
    tensorboard: bool = True


@dataclasses.dataclass(frozen=True)
class EnsembleOptions:
    pivots: int = 0
    start_from_base: bool = True
    epochs: int = 40
    high_epochs: int = 15
    learning_rate: float = 3e-4
    frames: int = 60
    sigmas: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0)
    steps: int = 600


@dataclasses.dataclass(frozen=True)
class Config:
    """All settings; see the commented TOML files.

    Raises
    ------
    InputError
        If a number is out of its range.
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
                low = 0 if field.name in _ZERO else 1
                for number in value if isinstance(value, tuple) else (value,):
                    if type(number) is int and number < low:
                        raise InputError(name, f"an integer >= {low}", number)

        if self.low.dropout >= 1:
            raise InputError("low.dropout", "a share below 1", self.low.dropout)

    def as_dict(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @classmethod
    def of(cls, table: Any, origin: str = "config") -> Config:
        """From nested dictionaries, as TOML and JSON give them.

        Raises
        ------
        FormatError
            If a setting is unknown or of the wrong kind; the message names
            `origin` and the setting.
        """
        return from_table(cls, table, file=origin)


_ZERO = ("seed", "threads", "pivots")


def preset_names() -> list[str]:
    """Configurations that ship with the package."""
    files = resources.files(__package__).iterdir()
    return sorted(f.name[:-5] for f in files if f.name.endswith(".toml"))


def load_config(path: Path | str) -> Config:
    """Read a TOML file, or a preset by its name.

    Raises
    ------
    InputError
        If there is neither such a file nor such a preset, or a number is out of range.
    FormatError
        If the file is no TOML or a setting is unknown or of the wrong kind.
    """
    name = str(path)
    if name in preset_names():
        text = resources.files(__package__).joinpath(f"{name}.toml").read_text("utf-8")
        return Config.of(parse_toml(text, name), name)
    file = Path(path)
    if not file.is_file():
        presets = ", ".join(preset_names())
        raise InputError("config", f"a TOML file or one of {presets}", name)
    return Config.of(read_toml(file), name)


def override(config: Config, changes: Sequence[str]) -> Config:
    """A configuration with settings changed as ``section.name=value``, values as in TOML.

    Raises
    ------
    FormatError
        If a change is unreadable, unknown or of the wrong kind.
    """
    table = config.as_dict()
    for change in changes:
        path, sign, value = change.partition("=")
        section, dot, name = path.strip().partition(".")
        if not (sign and dot and section in table and name in table[section]):
            raise FormatError(f"{change}: expected section.name=value with a setting that exists")
        try:
            table[section][name] = parse_toml(f"value = {value}", change)["value"]
        except FormatError:
            table[section][name] = value.strip()  # a plain word needs no quotes
    return Config.of(table, ", ".join(changes))
