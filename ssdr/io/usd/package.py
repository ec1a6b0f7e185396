"""Packages (``.usdz``): zip archives whose first file is a stage, unpacked before USD opens them.

Unpacked, a package is a folder like any other: its layers are checked and may not refer outside it.
"""

from __future__ import annotations

import tempfile
import weakref
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any

from ..budget import afford
from ..registry import check

_STAGES = (".usd", ".usda", ".usdc")
_ENCRYPTED = 1  # flag of a file in a zip archive


def unpacked(path: Path, owner: Any) -> Path:
    """Unpack a package to a folder that lives as long as `owner`, and return its first file.

    To be called inside :func:`~ssdr.io.registry.reading`.

    Raises
    ------
    FormatError
        If the file is no package; if a file in it is compressed, encrypted or damaged, or has a
        name that leads out of it; or if the files together are larger than the package.

    References
    ----------
    Pixar, "Usdz file format specification", https://openusd.org/release/spec_usdz.html
    """
    check(zipfile.is_zipfile(path), "not a package: no zip archive")
    with zipfile.ZipFile(path) as archive:
        files = [item for item in archive.infolist() if not item.is_dir()]
        check(files, "an empty package")
        first = files[0].filename
        problem = f"a package begins with a stage ({', '.join(_STAGES)}), this one with {first!r}"
        check(PurePosixPath(first).suffix.lower() in _STAGES, problem)
        for item in files:
            _check_file(item)
        names = {item.filename.casefold() for item in files}
        check(len(names) == len(files), "two files of a package have one name")
        total, held = sum(item.file_size for item in files), path.stat().st_size
        check(total <= held, f"its files state {total} bytes, it holds {held}")
        afford(total, "the whole package", path)
        folder = tempfile.TemporaryDirectory(prefix="ssdr-", ignore_cleanup_errors=True)
        weakref.finalize(owner, folder.cleanup)
        for item in files:
            target = Path(folder.name, *PurePosixPath(item.filename).parts)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(archive.read(item))
    return Path(folder.name, *PurePosixPath(first).parts)


def _check_file(item: zipfile.ZipInfo) -> None:
    """Refuse a file of a package that the format does not allow or that leads out of it."""
    name = item.filename
    parts = PurePosixPath(name).parts
    inside = ".." not in parts and not name.startswith("/") and not set(name) & set("\\:\0")
    check(inside and parts, f"the name {name[:200]!r} in a package leads out of it")
    plain = item.compress_type == zipfile.ZIP_STORED and not item.flag_bits & _ENCRYPTED
    check(plain, f"{name[:200]!r} in the package is compressed or encrypted, which none may be")
