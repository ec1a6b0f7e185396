"""Numba's cache on disk with a file for each signature, which is checked before it is used."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import pickle
from pathlib import Path
from typing import Any

_log = logging.getLogger(__name__)


class CheckedFiles:
    """Files of the machine code of one kernel, in place of the index and data files of Numba.

    A file that is damaged counts as missing, so that its kernel is compiled anew; in an index
    shared by all signatures, two processes that compile at once may exchange their files.

    Parameters
    ----------
    files : numba.core.caching.IndexDataCacheFile
        The files that are replaced.
    """

    def __init__(self, files: Any) -> None:
        self._files = files
        self._stamp = repr((files._version, files._source_stamp)).encode()

    def _path(self, key: Any) -> Path:
        name = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        base = self._files._index_name.removesuffix(".nbi")
        return Path(self._files._cache_path) / f"{base}.{name}.nbc"

    def _seal(self, body: bytes) -> bytes:
        return hashlib.sha256(self._stamp + body).digest()

    def save(self, key: Any, data: Any) -> None:
        """Write the code of a signature; where the disk is full, it is only not kept."""
        body = self._files._dump(data)
        try:
            with self._files._open_for_write(str(self._path(key))) as file:
                file.write(self._seal(body) + body)
        except OSError as error:
            _log.warning("compiled code cannot be kept: %s", error)

    def load(self, key: Any) -> Any:
        """Code of a signature; None if there is none of these sources, or it is damaged."""
        with contextlib.suppress(OSError):
            content = self._path(key).read_bytes()
            if content[:32] == self._seal(content[32:]):
                return pickle.loads(content[32:])  # written by this user's own processes
        return None
