"""Files that readers refuse: how each is made and what is said of it, one table by format."""

from __future__ import annotations

import pickle
import re

import pytest

import ssdr
from ssdr import FormatError

FOREIGN = re.compile(
    r"Traceback|at line \d+ in file|not iterable|subscriptable|pxrInternal|File \""
)

OPTIONS = {suffix: {"faces": "none"} for suffix in ("npy", "pc2", "mdd")}


def raw(path, data):
    path.write_bytes(data.encode() if isinstance(data, str) else data)


def mapped(path, **options):
    return ssdr.load(path, mmap=True, **options)


MISLABELLED = {
    "a zip archive": b"PK\x03\x04" * 20,
    "a NumPy .npy array": b"\x93NUMPY\x01\x00" + bytes(100),
    "a Python pickle": pickle.dumps({"vertices": [1.0] * 30}),
    "a PNG picture": b"\x89PNG\r\n\x1a\n" + bytes(100),
    "text": b"dear diary, today I was renamed\n" * 4,
    "the file is empty": b"",
}
"""Contents that files of another suffix have, by what is said of them."""


def looks(*known):
    """Cases of all that is mislabelled, but for what a format is itself."""
    return {what: (data, what) for what, data in MISLABELLED.items() if what not in known}


class Refused(dict):
    """Suffix, function that makes a file, its argument, text of the error and readers, by case."""

    def add(self, suffix, make, cases, *readers):
        """Cases of a format: what `make` is given beside the path, and the text, by a name."""
        for what, (given, says) in cases.items():
            self[f"{suffix}: {what}"] = suffix, make, given, says, readers or (ssdr.load,)

    def check(self, case, folder):
        """Make the file of a case; each reader refuses it in words of this package."""
        suffix, make, given, says, readers = self[case]
        path = folder / f"bad.{suffix}"
        make(path, given)
        for read in readers:
            with pytest.raises(FormatError, match=says) as caught:
                read(path, **OPTIONS.get(suffix, {}))
            assert "bad." in str(caught.value)
            assert not FOREIGN.search(str(caught.value))
