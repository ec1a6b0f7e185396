"""Tables read into dataclasses, and what is said of those that cannot be."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import pytest

from garmentnet.configs.config import Amount, Count
from garmentnet.io.tables import from_table, read_toml
from ssdr.common.errors import FormatError, InputError


@dataclasses.dataclass(frozen=True)
class Inner:
    size: int = 1

    def __post_init__(self) -> None:
        if self.size < 1:
            raise InputError("size", "an integer >= 1", self.size)


@dataclasses.dataclass(frozen=True)
class Outer:
    name: str
    scale: Amount = 1.0
    flag: bool = False
    kind: Literal["a", "b"] = "a"
    widths: tuple[Count, ...] = ()
    inner: Inner = Inner()
    several: tuple[Inner, ...] = ()
    other: Inner | None = None
    free: dict[str, Any] = dataclasses.field(default_factory=dict)


def test_every_kind_of_field() -> None:
    table = {
        "name": "x",
        "scale": 2,
        "flag": True,
        "kind": "b",
        "widths": [8, 16],
        "inner": {"size": 2},
        "several": [{}, {"size": 3}],
        "other": {"size": 4},
        "free": {"a": [1]},
    }
    assert from_table(Outer, table, file="t.toml") == Outer(
        "x", 2.0, True, "b", (8, 16), Inner(2), (Inner(), Inner(3)), Inner(4), {"a": [1]}
    )
    assert isinstance(from_table(Outer, table, file="t.toml").scale, float)
    assert from_table(Outer, {"name": "x"}, file="t.toml") == Outer("x")


@pytest.mark.parametrize(
    ("table", "text"),
    [
        ({}, "t.toml: Object missing required field `name`"),
        ({"name": 3}, r"t.toml: Expected `str`, got `int` - at `\$.name`"),
        ({"name": "x", "nane": "y"}, "t.toml: nane: expected one of name, scale, .*, got this key"),
        ({"name": "x", "scale": "2"}, "t.toml: .*`float`, got `str`.*scale"),
        ({"name": "x", "scale": True}, "t.toml: .*`float`, got `bool`.*scale"),
        ({"name": "x", "scale": math.inf}, "t.toml: .*scale"),
        ({"name": "x", "scale": math.nan}, "t.toml: .*scale"),
        ({"name": "x", "scale": -1}, "t.toml: .*`float` >= 0.*scale"),
        ({"name": "x", "flag": 1}, "t.toml: .*`bool`, got `int`.*flag"),
        ({"name": "x", "kind": "c"}, "t.toml: .*'c'.*kind"),
        ({"name": "x", "widths": 8}, "t.toml: .*`array`, got `int`.*widths"),
        ({"name": "x", "widths": [0]}, r"t.toml: .*`int` >= 1.*widths\[0\]"),
        ({"name": "x", "widths": [1.5]}, r"t.toml: .*`int`, got `float`.*widths\[0\]"),
        ({"name": "x", "inner": 3}, "t.toml: .*inner"),
        ({"name": "x", "inner": {"size": 1.5}}, "t.toml: .*inner.size"),
        ({"name": "x", "several": [{}, {"s": 1}]}, r"t.toml: several\[1\].s: expected one of size"),
        ({"name": "x", "free": 3}, "t.toml: .*free"),
    ],
)
def test_errors_name_file_table_and_key(table: dict[str, Any], text: str) -> None:
    with pytest.raises(FormatError, match=text):
        from_table(Outer, table, file="t.toml")


def test_values_that_the_dataclass_refuses() -> None:
    with pytest.raises(InputError, match=r"t\.toml: inner\.size: expected an integer >= 1, got 0"):
        from_table(Outer, {"name": "x", "inner": {"size": 0}}, file="t.toml")


def test_files_that_are_not_toml(tmp_path) -> None:
    path = tmp_path / "t.toml"
    for data in (b"[low", b"\xff\xfe", b"a = "):
        path.write_bytes(data)
        with pytest.raises(FormatError, match=r"t\.toml: not"):
            read_toml(path)
    with pytest.raises(FormatError, match=r"nothing\.toml"):
        read_toml(tmp_path / "nothing.toml")
