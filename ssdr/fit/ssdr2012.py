"""The method of 2012: bones and weights in turns, from a start, with the rest pose held."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.checks import check_callback, check_whole, names_arguments
from ..mesh.sequence import MeshSequence, as_sequences
from ..model.frame_error import rmse_of
from ..search.progress import Callback, Monitor, Stop
from ..solver.alternation import repeat_alternation
from ..solver.model import Lowest
from .fit import Fit, fit_of
from .initial_model import fitted_skinning, started


@names_arguments
def ssdr2012(
    sequence: MeshSequence | Any,
    faces: Any = None,
    *,
    bones: int,
    influences: int = 4,
    rest: Any = None,
    iterations: int = 100,
    rng: int | np.random.Generator = 0,
    callback: Callback | None = None,
) -> Fit:
    """Decompose by the block coordinate descent of Le and Deng 2012, as a baseline.

    The rest pose is held.  From the start of :func:`initialize`, an iteration fits every rigid bone
    in turn to the weights, by weighted Kabsch problems, and then the weights of every vertex to the
    bones, a convex QP of which the K largest weights are kept and solved for again.  The best model
    of all iterations is returned.  :func:`decompose` descends further.  Differences from the paper:
    the start is that of this package, and no bone is re-seeded.

    Parameters
    ----------
    sequence : MeshSequence, list of them, or (F, V, 3) array
    faces : (T, 3) int array, optional
        Triangles, if `sequence` is a plain array.
    bones : int
        Number of bones, from 1 to V.
    influences : int
        Most influences per vertex.
    rest : (V, 3) array, optional
        Rest pose, in the mesh's units; by default the first frame.
    iterations : int
    rng : int or numpy.random.Generator
        Seed of the start.
    callback : callable, optional
        Called with a :class:`Progress` after the start and after every iteration; the descent ends
        if it returns True.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If an argument is not usable.

    References
    ----------
    Le and Deng, "Smooth skinning decomposition with rigid bones", 2012, algorithm 1.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fit = ssdr.ssdr2012(dancer, bones=4, iterations=5)
    >>> fit.skinning.n_bones, fit.rmse < 0.02 * dancer.diagonal()
    (4, True)
    """
    sequences = as_sequences(sequence, faces)
    iterations = check_whole(iterations, "iterations", 0)
    monitor = Monitor(check_callback(callback))
    if rest is None:
        rest = sequences[0].frames(slice(0, 1))[0]
    data, model, constraints = started(
        sequences, bones=bones, influences=influences, rest=rest, rng=rng
    )
    best = Lowest()
    for k in range(iterations + 1):
        if k:
            repeat_alternation(data, model, 1, constraints)
        best.offer(model, float(model.error.sum()))
        least = rmse_of(best.model.error * data.alignment.scale**2, data.n_frames)
        try:
            monitor.report("descent", iteration=k, rmse=least, fraction=(k + 1) / (iterations + 1))
        except Stop:
            break
    return fit_of(sequences, fitted_skinning(sequences, data, best.model, constraints))
