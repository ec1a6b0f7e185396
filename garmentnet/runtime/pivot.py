"""Evaluation of one network, and the kernel that mixes several (pivots), in NumPy."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.common.errors import FormatError

from ..data.subject import Subject
from ..networks.document import HIDDEN, LATENT, CheckpointDocument, NetworkRecord

Single = NDArray[np.float32]
_SQUARE = 1e-12  # as the torch side adds to a squared distance


@dataclasses.dataclass(frozen=True, eq=False)
class Recurrent:
    """A GRU of width H followed by a linear layer; its gates are in torch's order r, z, n.

    Attributes
    ----------
    w_in, w_state : (3H, D), (3H, H) float32
    b_in, b_state : (3H,) float32
    w_out, b_out : (O, H), (O,) float32
    """

    w_in: Single
    w_state: Single
    b_in: Single
    b_state: Single
    w_out: Single
    b_out: Single

    @property
    def size(self) -> int:
        return self.w_state.shape[1]

    def __call__(self, x: Single, h: Single) -> tuple[Single, Single]:
        """Output ``(O,)`` and new state ``(H,)``, given input ``(D,)`` and state ``(H,)``."""
        # In place: at this size a new array costs as much as the arithmetic in it.
        n = self.size
        given, past = self.w_in @ x, self.w_state @ h
        given += self.b_in
        past += self.b_state
        # σ(x) = (1 + tanh(x / 2)) / 2 does not overflow.
        gates = given[: 2 * n] + past[: 2 * n]
        gates *= 0.5
        np.tanh(gates, out=gates)
        gates += 1.0
        gates *= 0.5
        new = past[2 * n :]
        new *= gates[:n]
        new += given[2 * n :]
        np.tanh(new, out=new)
        h = h - new
        h *= gates[n:]
        h += new
        out = self.w_out @ h
        out += self.b_out
        return out, h


@dataclasses.dataclass(frozen=True, eq=False)
class Pivot:
    """A network without torch: trained at one set of simulation parameters, or reading them.

    Attributes
    ----------
    mean, deviation : (D,) float64
        Statistics by which the pose features are normalised.
    clamp : float
        Bound of the absolute value of a normalised feature; 0: no bound.
    condition : bool
        Whether the network reads the simulation parameters.
    low : Recurrent
        Maps body motion to normalised bone motion.
    scale, shift : (B, 9) float32
        Deviation and mean of the bone motion.
    centres : (B, 3) float32
        Points of the rest pose about which the bones rotate.
    followed : (B,) int64
        Joint relative to which each bone moves; -1: none, but the moving frame.
    high : Recurrent or None
        Maps motion to weights of the detail; None without detail.
    reads_body : bool
        Whether `high` reads the motion of the body instead of that of the bones.
    basis : (1 + rank, 3 n) float32 or None
        Mean detail and components, in metres; in each row all x come first, then y, then z.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    clamp: float
    condition: bool
    low: Recurrent
    scale: Single
    shift: Single
    centres: Single
    followed: NDArray[np.int64]
    high: Recurrent | None = None
    reads_body: bool = False
    basis: Single | None = None

    @property
    def start(self) -> tuple[Single, Single]:
        """Initial states of the two GRUs."""
        high = 0 if self.high is None else self.high.size
        return np.zeros(self.low.size, np.float32), np.zeros(high, np.float32)

    @property
    def nothing(self) -> Single:
        """Weights of the detail that are all 0."""
        return np.zeros(0 if self.basis is None else len(self.basis), np.float32)

    def __call__(
        self, features: NDArray[np.float64], theta: Single, state: tuple[Single, Single]
    ) -> tuple[Single, Single, tuple[Single, Single]]:
        """Bone motion ``(B, 9)``, weights of the detail ``(1 + rank,)`` and the new states."""
        z = (features - self.mean) / self.deviation
        if self.clamp > 0:
            z = z.clip(-self.clamp, self.clamp)
        x = z.astype(np.float32)
        if self.condition:
            x = np.concatenate([x, theta])
        motion, low = self.low(x, state[0])
        numbers, high = self.nothing, state[1]
        if self.high is not None:
            read = x if self.reads_body else np.concatenate([motion, theta])
            numbers[0] = 1.0
            numbers[1:], high = self.high(read, state[1])
        return motion.reshape(self.scale.shape) * self.scale + self.shift, numbers, (low, high)


@dataclasses.dataclass(frozen=True, eq=False)
class Mixture:
    """The normalised kernel of equation 4 of the paper, and the pivots' parameters.

    Attributes
    ----------
    layers : tuple of float64 arrays
        Weight and bias of the MLP's first layer, slope of its PReLU, weight and bias of the last.
    pivots : (K, 3) float64
        Normalised simulation parameters of each pivot.
    power : {2, 1}
        Exponent of the distance.
    """

    layers: tuple[NDArray[np.float64], ...]
    pivots: NDArray[np.float64]
    power: int

    @classmethod
    def read(cls, arrays: dict[str, Any], document: CheckpointDocument) -> Mixture | None:
        """From the arrays and the document of a checkpoint; None if it has one network alone."""
        if not document.kernel:
            return None
        rows = [r.parameters.normalised() for r in document.networks if r.parameters is not None]
        shapes = ((HIDDEN, len(rows[0])), (HIDDEN,), (1,), (LATENT, HIDDEN), (LATENT,))
        names = ("g.0.weight", "g.0.bias", "g.1.weight", "g.2.weight", "g.2.bias")
        layers = tuple(
            _take(arrays, f"kernel.{n}", s, np.float64) for n, s in zip(names, shapes, strict=True)
        )
        return cls(layers, np.stack(rows), document.power)

    def __call__(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of each pivot ``(K,)`` at normalised parameters ``(3,)``; the shares sum to 1."""
        gap = ((self._g(self.pivots) - self._g(theta)) ** 2).sum(-1)
        size = (gap + _SQUARE) ** (self.power / 2)
        weights = np.exp(size.min() - size)
        return weights / weights.sum()

    def _g(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        w, b, slope, v, c = self.layers
        h = x @ w.T + b
        return np.where(h > 0, h, slope * h) @ v.T + c


def read_pivot(arrays: dict[str, Any], k: int, record: NetworkRecord, subject: Subject) -> Pivot:
    """Network k of a checkpoint.

    Raises
    ------
    FormatError
        If an array is missing or of another shape, or the network is of a kind that needs torch.
    """
    config = record.config
    if config.low.rotation != "sixd":
        raise FormatError(
            f"low.rotation {config.low.rotation!r}; only 'sixd' is run here: train the preset "
            "rooted, or with --set low.rotation=sixd"
        )
    if record.high and config.high.kind != "basis":
        raise FormatError(
            f"high.kind {config.high.kind!r}; only 'basis' is run here: train the preset rooted, "
            "or with --set high.kind=basis --set high.collision=0"
        )
    name, b = f"network.{k}.", subject.garment.n_bones
    mean = arrays[f"{name}features.mean"]
    theta = 3 if config.data.condition else 0

    def take(key: str, *shape: int) -> Single:
        return _take(arrays, name + key, shape)

    def recurrent(part: str, inputs: int, size: int, outputs: int) -> Recurrent:
        return Recurrent(
            take(f"{part}.gru.weight_ih_l0", 3 * size, inputs),
            take(f"{part}.gru.weight_hh_l0", 3 * size, size),
            take(f"{part}.gru.bias_ih_l0", 3 * size),
            take(f"{part}.gru.bias_hh_l0", 3 * size),
            take(f"{part}.out.weight", outputs, size),
            take(f"{part}.out.bias", outputs),
        )

    followed = np.full(b, -1, np.int64)
    if config.low.relative_to == "joints":
        followed = _take(arrays, f"{name}low.code.followed", (b,), np.int64)
    high = basis = None
    o, body = config.high, record.high and config.high.source == "body"
    if record.high:
        n, deviation = len(subject.free), take("high.deviation", o.rank)
        high = recurrent("high", (len(mean) if body else 9 * b) + theta, o.hidden, o.rank)
        # The deviations of the weights are multiplied into the last layer.
        high = dataclasses.replace(
            high, w_out=high.w_out * deviation[:, None], b_out=high.b_out * deviation
        )
        components = take("high.basis", o.rank, 3 * n).reshape(-1, n, 3)
        basis = np.concatenate([take("high.mean", n, 3)[None], components])
        basis = np.ascontiguousarray(basis.transpose(0, 2, 1).reshape(len(basis), -1))
    return Pivot(
        np.asarray(mean, np.float64),
        _take(arrays, f"{name}features.deviation", mean.shape, np.float64),
        record.clamp,
        bool(theta),
        recurrent("low", len(mean) + theta, config.low.hidden, 9 * b),
        take("low.code.deviation", b, 9),
        take("low.code.mean", b, 9),
        take("low.code.centres", b, 3),
        followed,
        high,
        body,
        basis,
    )


def _take(
    arrays: dict[str, Any], name: str, shape: tuple[int, ...], kind: Any = np.float32
) -> NDArray[Any]:
    if name not in arrays or arrays[name].shape != shape:
        got = arrays[name].shape if name in arrays else "nothing"
        raise FormatError(f"{name}: expected shape {shape}, got {got}")
    return np.ascontiguousarray(arrays[name], kind)
