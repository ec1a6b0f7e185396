"""Sequences that do not fit into memory: solve on telling frames, finish on all of them.

    scan (one pass) -> frames that differ most -> the usual run on those
         -> passes over all frames, each an exact alternation: bones of every
            frame, then weights and rest pose from the sums that the pass gathers

A pass keeps a chunk of frames, the transforms and two (V, 4B) matrices; what it
states is the error over all frames, not an estimate from a part of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from .initialization import farthest_points
from .kernels.polish import polish_vertices
from .model import CHUNK, Fixed, Model, bone_step, gram_tables
from .parallel import chunk_bounds, run_chunks, serial_blas
from .sequence import MeshSequence
from .trajectories import Alignment, Array, Trajectories, centred, turn_onto

__all__ = ["AllFrames", "Scan", "needs_streaming", "scan"]

_IN_MEMORY = 1 << 30  # bytes of float64 trajectories up to which everything is held at once
_SUBSET = 1 << 29  # bytes of those of the telling frames
_FEWEST, _MOST = 200, 1000  # telling frames
_BLOCK = 32 << 20  # bytes of a chunk in a pass
_PROBES = 64  # vertices by which frames are compared
_SWEEPS = 4


def needs_streaming(sequences: Sequence[MeshSequence]) -> bool:
    """Whether the trajectories are too large to be held at once."""
    frames = sum(len(s) for s in sequences)
    return sequences[0].n_vertices * frames * 24 > _IN_MEMORY and frames > _FEWEST


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """What the first pass found.

    Attributes
    ----------
    alignment : Alignment
        Of all frames.
    x2 : (V,) float64
        Squared length of each vertex's trajectory in the solver's space.
    chosen : (S,) int64
        Telling frames, ascending; the first frame is one of them.
    nearest : (F,) int64
        For each frame, the position in `chosen` of the one that it is most like.
    """

    alignment: Alignment
    x2: Array
    chosen: NDArray[np.int64]
    nearest: NDArray[np.int64]

    def importance(self, frames: Array | None) -> Array:
        """(S,) importance of the telling frames: that of the frames they stand for."""
        whole = np.ones(len(self.nearest)) if frames is None else frames
        counts = np.bincount(self.nearest, weights=whole, minlength=len(self.chosen))
        return counts.astype(np.float64)


@serial_blas()
def scan(
    sequences: Sequence[MeshSequence],
    importance: Array | None,
    keep: Sequence[int] = (),
) -> Scan:
    """Walk over all frames once: alignment, size, and which frames tell most.

    Frames are compared by a few vertices after alignment and chosen by
    farthest-point sampling, so that rare poses are among them; `keep` are chosen
    in any case.
    """
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    share = None if importance is None else importance / importance.sum()
    probes = np.linspace(0, n - 1, min(n, _PROBES)).astype(np.int64)
    centre, turn = np.empty((n_frames, 3)), np.empty((n_frames, 3, 3))
    features = np.empty((n_frames, 3 * len(probes)))
    x2 = np.zeros(n)
    first = None
    for t, frame in _frames(sequences):
        here, centre[t] = centred(frame, share)
        if first is None:
            first = here
        turn[t] = turn_onto(here, first, share) if t else np.eye(3)
        x2 += np.einsum("ic,ic->i", here, here)
        features[t] = (here[probes] @ turn[t]).ravel()
    scale = float(np.sqrt(x2.sum() / (n * n_frames))) or 1.0
    count = int(np.clip(_SUBSET // (24 * n), _FEWEST, _MOST))
    seeds, nearest = farthest_points(features, min(count, n_frames), 0)
    chosen = np.union1d(seeds, np.asarray(keep, dtype=np.int64)).astype(np.int64)
    where = np.searchsorted(chosen, seeds)[nearest]
    where[chosen] = np.arange(len(chosen))
    return Scan(
        alignment=Alignment(centre=centre, turn=turn, scale=scale),
        x2=x2 / scale**2,
        chosen=chosen,
        nearest=where.astype(np.int64),
    )


def subset(sequences: Sequence[MeshSequence], frames: NDArray[np.int64]) -> MeshSequence:
    """The named frames, ascending, as one sequence in memory."""
    first = sequences[0]
    out = np.empty((len(frames), first.n_vertices, 3), dtype=first.vertices.dtype)
    wanted = {int(t): k for k, t in enumerate(frames)}
    for t, frame in _frames(sequences):
        if t in wanted:
            out[wanted[t]] = frame
    return dataclasses.replace(first, vertices=out, validate=False)


class AllFrames:
    """Exact alternations over all frames of a model that was found on some of them.

    Parameters
    ----------
    sequences : list of MeshSequence
    found : Scan
    data : Trajectories
        Of the telling frames.
    model : Model
        Found on them; copied.
    given : (F, B0, 3, 4) array or None
        Transforms handed over, in the solver's space of all frames.
    importance : (F,) array or None
        Of the frames.
    """

    def __init__(
        self,
        sequences: Sequence[MeshSequence],
        found: Scan,
        data: Trajectories,
        model: Model,
        *,
        fixed: Fixed,
        given: Array | None,
        importance: Array | None,
    ) -> None:
        self.sequences, self.found, self.fixed = sequences, found, fixed
        self.alignment = found.alignment
        ratio = data.scale / self.alignment.scale
        # only telling frames are copied, one chunk at a time: F transforms are large enough
        transforms = model.transforms[found.nearest]
        transforms[..., 3] *= ratio
        if given is not None:
            transforms[:, : given.shape[1]] = given
        self.model = model.copy()
        self.model.transforms = transforms
        self.model.rest = model.rest * ratio
        self.vertex_importance = data.importance
        mean = 1.0 if importance is None else float(importance.mean())
        self.frame_scale = (
            np.ones(len(transforms)) if importance is None else np.sqrt(importance / mean)
        )

    def pass_over(self, *, entering: int, told: Callable[[float], None] | None = None) -> float:
        """One exact alternation; returns the objective in the solver's space.

        `told` hears the share of the frames that are done.
        """
        model, n_frames = self.model, len(self.frame_scale)
        n, n_bones = len(model.rest), model.n_bones
        y = np.zeros((n, 4 * n_bones))
        g = np.zeros((4 * n_bones, 4 * n_bones))
        x2 = np.zeros(n)
        with serial_blas():
            for start, block in _blocks(self.sequences, n):
                stop = start + len(block)
                x = self.alignment.inward(block, start)
                x *= self.frame_scale[start:stop, None]
                flat = x.reshape(n, -1)
                x2 += np.einsum("ij,ij->i", flat, flat)
                part = Trajectories(
                    z=flat, q=None, x2=x2, importance=self.vertex_importance,
                    frame_scale=self.frame_scale[start:stop],
                    centre=self.alignment.centre[start:stop],
                    turn=self.alignment.turn[start:stop], scale=self.alignment.scale, lost=0.0,
                )  # fmt: skip
                piece = dataclasses.replace(model, transforms=model.transforms[start:stop])
                bone_step(part, piece, sweeps=_SWEEPS, fixed=self.fixed)
                hat = part.hat(piece.transforms)
                g += hat.T @ hat

                def add(_: int, i: int, k: int, flat: Array = flat, hat: Array = hat) -> None:
                    y[i:k] += flat[i:k] @ hat

                run_chunks(add, chunk_bounds(n, 2 * CHUNK))
                if told is not None:
                    told(stop / n_frames)
            self._vertices(y, g, x2, entering)
        return float(self.vertex_importance @ model.error)

    def _vertices(self, y: Array, g: Array, x2: Array, entering: int) -> None:
        model, fixed = self.model, self.fixed
        n, n_bones, size = len(model.rest), model.n_bones, model.n_influences + 2
        gram, gram4 = gram_tables(g, n_bones)
        keep = fixed.keep_weights(n)

        def work(_: int, i: int, k: int) -> None:
            polish_vertices(
                y[i:k].reshape(k - i, 4, n_bones), x2[i:k], gram, gram4, model.rest[i:k],
                model.joints[i:k], model.weights[i:k], model.error[i:k], keep[i:k],
                not fixed.rest, entering, 3, np.empty((k - i, size, size)),
                np.empty((k - i, size)), 0, k - i,
            )  # fmt: skip

        run_chunks(work, chunk_bounds(n, CHUNK))


def _frames(sequences: Sequence[MeshSequence]) -> Iterator[tuple[int, NDArray[np.floating]]]:
    offset = 0
    for sequence in sequences:
        for start, block in sequence.chunks():
            for k, frame in enumerate(block):
                yield offset + start + k, frame
        offset += len(sequence)


def _blocks(
    sequences: Sequence[MeshSequence], n_vertices: int
) -> Iterator[tuple[int, NDArray[np.floating]]]:
    """Chunks of all shots that are a few dozen MiB in float64."""
    step = max(1, _BLOCK // (24 * n_vertices))
    offset = 0
    for sequence in sequences:
        for start, block in sequence.chunks():
            for i, k in chunk_bounds(len(block), step):
                yield offset + start + i, block[i:k]
        offset += len(sequence)
