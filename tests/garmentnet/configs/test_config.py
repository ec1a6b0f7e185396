"""Presets, files that cannot be read, and changes on the command line."""

import dataclasses
import tomllib
from importlib import resources

import pytest

from garmentnet.configs.config import Config, load_config, override, preset_names
from ssdr.common.errors import FormatError, InputError


def tables(name):
    text = resources.files("garmentnet.configs").joinpath(f"{name}.toml").read_text()
    lines = [x for x in text.splitlines() if " = " in x and not x.startswith("#")]
    assert all("# " in x for x in lines), name  # a comment for every setting
    return tomllib.loads(text)


def test_one_preset_lists_every_setting_and_the_others_what_differs():
    plain = dataclasses.asdict(Config())
    every = tables("faithful")
    assert load_config("faithful") == Config()
    assert {k: set(v) for k, v in every.items()} == {k: set(v) for k, v in plain.items()}
    assert {"faithful", "rooted"} <= set(preset_names())
    for name in set(preset_names()) - {"faithful"}:
        for section, part in tables(name).items():
            assert all(every[section][k] != v for k, v in part.items()), (name, section)


def test_bad_configurations(tmp_path):
    file = tmp_path / "c.toml"
    for text, error, what in (
        ("[low]\nwidth = 3", FormatError, r"c\.toml.*width"),
        ("[high]\nedge_features = [8, 'x']", FormatError, "edge_features"),
        ("[low]\nhidden = 0", FormatError, "hidden"),
        ("[high]\nframes = 1", FormatError, "frames"),
        ("[train]\ngradient_norm = 0", FormatError, "gradient_norm"),
        ("[train]\ndevice = 'gpu'", FormatError, "device"),
        ("[high]\nkind = 'basis'\ncollision = 0.1", InputError, r"high\.collision.*basis"),
    ):
        file.write_text(text)
        with pytest.raises(error, match=what):
            load_config(file)
    with pytest.raises(InputError, match="config"):
        load_config(tmp_path / "nothing.toml")


def test_override():
    c = override(Config(), ["train.seed=3", "low.rotation=sixd", "high.edge_features=[8, 8]"])
    assert (c.train.seed, c.low.rotation, c.high.edge_features) == (3, "sixd", (8, 8))
    for wrong in ("train.sed=3", "seed=3", "train.seed"):
        with pytest.raises(FormatError):
            override(Config(), [wrong])
