"""Splits of imported clips."""

from __future__ import annotations

import types

import pytest

from garmentnet.importing.importing import ImportOptions, _splits, import_clips
from ssdr.common.errors import InputError


@pytest.mark.parametrize(
    ("count", "named", "found"),
    [
        (1, {}, "r"),
        (2, {}, "rv"),
        (3, {}, "rvt"),
        (20, {}, "r" * 16 + "vvtt"),
        (3, {"test": ("a",)}, "trv"),
        (3, {"validation": ("c",)}, "rtv"),
        (2, {"test": ("b",)}, "rt"),
    ],
)
def test_the_last_clips_are_for_validation_and_testing(count, named, found):
    said: list[str] = []
    splits = _splits(
        list("abcdefghijklmnopqrst"[:count]), ImportOptions(**named), None, said.append
    )
    assert "".join({"train": "r"}.get(s, s[0]) for s in splits.values()) == found
    assert len(said) == 3 - len(set(found))


class Stored(dict):
    """Splits of the clips of a store, by name."""

    def names(self, split, _):
        return [name for name, own in self.items() if own == split]

    def clip(self, name):
        return types.SimpleNamespace(split=self[name])


def test_splits_of_a_store_that_grows_or_whose_import_was_interrupted():
    names = list("abcdefghijklmnopqrstuvwx")
    whole = _splits(names, ImportOptions(), None, print)
    for done in range(len(names)):
        some = Stored({name: whole[name] for name in names[:done]})
        assert _splits(names, ImportOptions(), some, print) == whole
    grown = Stored()
    for count in range(3, 13):
        grown |= _splits(names[:count], ImportOptions(), grown, print)
    assert list(grown.values()) == ["train", "validation", "test"] + ["train"] * 9


def test_a_clip_keeps_its_split(files, tmp_path):
    """Imported once more in another, frames for testing would be trained on."""
    for options in ({"test": ("walk",)}, {}):
        store = import_clips([files], tmp_path / "a.clips", ImportOptions(**options))
        assert store.names("test") == ("walk",)
    with pytest.raises(InputError, match=r"the split in which the store has walk \(test\)"):
        import_clips([files], tmp_path / "a.clips", ImportOptions(validation=("walk",)))
