"""Scores of methods on clips, kept in a folder so that no pair is scored twice."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import ssdr.metrics
from ssdr.errors import FormatError

from ..collision import push_out
from ..data.clip import Clip
from ..data.store import ClipStore
from ..io.files import write_file, writing
from ..networks import checkpoint
from . import clip_scores
from .clip_scores import ClipScore

__all__ = ["ScoreCache", "digest_of_clips", "digest_of_file"]

_FORMAT, _VERSION = "garmentnet score", 1

_logger = logging.getLogger(__name__)


class ScoreCache:
    """A folder with one file for each method and clip.

    A file's name is a hash of the method, the clip, what is compared, and the code that predicts
    and compares: what changes one of them is scored again, and everything else is not.

    Parameters
    ----------
    folder : Path
    methods : dict
        A digest for the name of each method whose scores are to be kept.
    identity : str
        Of what is compared; see :meth:`Scorer.identity`.
    n_vertices : int
    renew : bool
        Whether to ignore what is there, and replace it.

    Attributes
    ----------
    notices : list of str
        Damaged files, by name.
    read, written : int
        Numbers of scores.
    """

    def __init__(
        self,
        folder: Path,
        methods: dict[str, str],
        *,
        identity: str,
        n_vertices: int,
        renew: bool = False,
    ) -> None:
        self.folder, self.methods, self.n_vertices, self.renew = folder, methods, n_vertices, renew
        self.base = _digest([identity, _digest_of_code()])
        self.notices: list[str] = []
        self.read = self.written = 0

    def get(self, method: str, clip: Clip) -> ClipScore | None:
        """A score, or None if there is none that can be used."""
        path = self._path(method, clip)
        if path is None or self.renew or not path.is_file():
            return None
        try:
            score = self._load(path, clip)
        except FormatError as error:
            notice = f"{error}; scored again"
            _logger.warning("%s", notice)
            self.notices.append(notice)
            return None
        self.read += 1
        return score

    def put(self, method: str, clip: Clip, score: ClipScore) -> None:
        """Write a score, complete or not at all."""
        path = self._path(method, clip)
        if path is None:
            return
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(score.as_dict(per_vertex=True), sort_keys=True)
        document = {
            "format": _FORMAT,
            "version": _VERSION,
            "method": method,
            "digest": _digest([text]),
            "score": json.loads(text),
        }
        write_file(path, json.dumps(document).encode())
        self.written += 1

    def _path(self, method: str, clip: Clip) -> Path | None:
        if method not in self.methods:
            return None
        name = _digest([self.base, self.methods[method], _digest_of_clip(clip)])
        return self.folder / f"{name}.json"

    def _load(self, path: Path, clip: Clip) -> ClipScore:
        try:
            document: Any = json.loads(path.read_bytes())
            score, digest = document["score"], document["digest"]
            known = (document["format"], document["version"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{path}: damaged ({type(error).__name__})") from error
        if known != (_FORMAT, _VERSION):
            raise FormatError(f"{path}: {known[0]}, version {known[1]}, is not read here")
        if digest != _digest([json.dumps(score, sort_keys=True)]):
            raise FormatError(f"{path}: damaged (its digest differs)")
        found = ClipScore.of(score, self.n_vertices, file=str(path))
        if (found.clip, found.frames) != (clip.name, clip.n_frames):
            raise FormatError(f"{path}: of another clip, {found.clip}")
        return found


def digest_of_file(path: Path) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def digest_of_clips(store: ClipStore, names: Iterable[str]) -> str:
    """Hash of what clips were made from and measured to be."""
    return _digest([_digest_of_clip(store.clip(name)) for name in names])


def _digest_of_clip(clip: Clip) -> str:
    # A clip's attributes hold everything that it was made from, and measurements of the result.
    return _digest([clip.name, digest_of_file(clip.path / "zarr.json")])


def _digest_of_code() -> str:
    # A checkpoint's prediction changes with the code that runs it.
    folders = [Path(str(m.__file__)).parent for m in (checkpoint, push_out, ssdr.metrics)]
    files = [f for folder in folders for f in sorted(folder.glob("*.py"))]
    return _digest([digest_of_file(f) for f in (*files, Path(clip_scores.__file__))])


def _digest(parts: Iterable[str]) -> str:
    return hashlib.sha256(json.dumps(list(parts)).encode()).hexdigest()[:20]
