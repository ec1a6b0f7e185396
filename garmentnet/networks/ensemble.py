"""Networks of several simulation parameters, mixed by a kernel (Pan et al. 2022, section 4.4).

All pivots have the same rest pose, skin weights and moving frame.  LBS is linear in the transforms,
so Σ Ψ̄ LBS(M_i) = LBS(Σ Ψ̄ M_i): the low-frequency mesh is skinned once.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ssdr.errors import InputError

from .features import transforms_in_frame
from .network import FRAMES_AT_ONCE, Motion, MotionNetwork, NetworkState

__all__ = ["Ensemble", "Kernel"]

Array = NDArray[np.float64]
# Added to a squared distance whose root must have a gradient at 0.
_SQUARE = 1e-12


class Kernel(nn.Module):
    """Ψ(θ_i, θ), which falls with d = ‖g(θ_i) − g(θ)‖, normalised over the pivots.

    exp(−d² / (2 σ²)), or exp(−d / σ) as the published code has it.

    Parameters
    ----------
    inputs : int
        Number of simulation parameters.
    hidden, latent : int
        Widths of the MLP g.
    sigma : float
        Bandwidth, in the units of g.
    shape : {"gaussian", "exponential"}

    Examples
    --------
    >>> kernel = Kernel()
    >>> float(kernel.weights([[0.0, 0, 0], [1, 1, 1]], [0.5, 0.5, 0.5]).sum().round(6))
    1.0
    """

    def __init__(
        self,
        inputs: int = 3,
        *,
        hidden: int = 16,
        latent: int = 4,
        sigma: float = 0.5,
        shape: str = "gaussian",
    ) -> None:
        super().__init__()
        self.sigma, self.shape = float(sigma), shape
        self.sizes = (inputs, hidden, latent)
        self.g = nn.Sequential(
            nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, latent)
        ).double()

    def forward(self, pivots: Tensor, theta: Tensor) -> Tensor:
        """Weights ``(..., K)``, summing to 1, of pivots ``(..., K, P)`` at ``(..., P)``."""
        gap = (self.g(pivots) - self.g(theta)[..., None, :]).square().sum(-1)
        # The normalised kernel is a softmax, which does not divide by 0 where every Ψ underflows.
        if self.shape == "exponential":
            return torch.softmax(-(gap + _SQUARE).sqrt() / self.sigma, dim=-1)
        return torch.softmax(-gap / (2 * self.sigma**2), dim=-1)

    def weights(self, pivots: Any, theta: Any) -> Array:
        """As :meth:`forward`, for arrays."""
        with torch.no_grad():
            out = self(
                torch.as_tensor(np.asarray(pivots, float)),
                torch.as_tensor(np.asarray(theta, float)),
            )
        weights: Array = np.array(out.numpy(), np.float64)
        return weights


@dataclasses.dataclass(frozen=True, eq=False)
class Ensemble:
    """Pivot networks and the kernel that mixes them.

    A pivot that reads the simulation parameters reads its own, whatever is asked for.

    Attributes
    ----------
    networks : tuple of MotionNetwork
    parameters : (K, P) float64
        Normalised parameters of the pivots.
    kernel : Kernel
    common : MotionNetwork or None
        A network that reads the parameters asked for, mixed with the pivots.
    share : float
        Its weight, 0 to 1; the pivots have the rest.

    Raises
    ------
    InputError
        If the networks differ in rest pose, skin weights or moving frame, or the share is not
        from 0 to 1.
    """

    networks: tuple[MotionNetwork, ...]
    parameters: Array
    kernel: Kernel
    common: MotionNetwork | None = None
    share: float = 0.0

    def __post_init__(self) -> None:
        if not self.networks or len(self.networks) != len(self.parameters):
            raise InputError("networks", "as many as parameters", len(self.networks))
        if not 0 <= self.share <= 1 or (self.share > 0 and self.common is None):
            raise InputError("share", "0 to 1, and 0 without a common network", self.share)
        first = self.networks[0]
        for other in self._all()[1:]:
            a, b = first.subject.garment, other.subject.garment
            same = (
                a.rest.shape == b.rest.shape
                and a.indices.shape == b.indices.shape
                and np.array_equal(a.rest, b.rest)
                and np.array_equal(a.indices, b.indices)
                and np.array_equal(a.weights, b.weights)
                and first.config.features.frame == other.config.features.frame
            )
            if not same:
                raise InputError("networks", "pivots of one rest pose, weights and frame", "others")

    def _all(self) -> tuple[MotionNetwork, ...]:
        return self.networks if self.common is None else (*self.networks, self.common)

    def weights(self, theta: Any) -> Array:
        """Ψ̄ ``(K,)`` of the pivots at normalised parameters; sums to 1."""
        return self.kernel.weights(self.parameters, theta)

    @torch.no_grad()
    def run(
        self,
        joints: Any,
        state: tuple[NetworkState, ...] | None = None,
        *,
        theta: Any,
        detail: bool = True,
    ) -> tuple[Motion, tuple[NetworkState, ...]]:
        """As :meth:`MotionNetwork.run`, at normalised parameters `theta`."""
        theta = np.asarray(theta, float)
        w = (1 - self.share) * self.weights(theta)
        own = [*self.parameters]
        if self.common is not None:
            w, own = np.append(w, self.share), [*own, theta]
        networks = self._all()
        before = state or (NetworkState(),) * len(networks)
        # A network of weight 0 is not run; of the pivots at least one has some.
        used = [k for k in range(len(networks)) if w[k] > 0]
        runs = {
            k: networks[k].run(
                joints,
                before[k],
                parameters=own[k] if networks[k].condition else None,
                detail=detail,
            )
            for k in used
        }
        motions = [runs[k][0] for k in used]
        transforms = sum(float(w[k]) * runs[k][0].transforms for k in used)
        assert isinstance(transforms, Tensor)
        first = self.networks[0]
        moved = torch.from_numpy(transforms_in_frame(joints, motions[0].frame).astype(np.float32))
        low, _ = first.carry(first.lbs(transforms), None, moved.to(first.device))
        high: Tensor | None = None
        if all(m.high is not None for m in motions):
            parts = [
                float(w[k]) * m.high
                for k, m in zip(used, motions, strict=True)
                if m.high is not None
            ]
            high = torch.stack(parts).sum(0)
        after = tuple(runs[k][1] if k in runs else before[k] for k in range(len(networks)))
        return Motion(transforms, low, high, motions[0].frame), after

    def motions(self, joints: Any, *, theta: Any, detail: bool = True) -> list[Motion]:
        """The motion in parts of at most 128 frames."""
        joints, state, out = np.asarray(joints), None, []
        for start in range(0, max(1, len(joints)), FRAMES_AT_ONCE):
            part = joints[start : start + FRAMES_AT_ONCE]
            motion, state = self.run(part, state, theta=theta, detail=detail)
            out.append(motion)
        return out

    def predict(self, joints: Any, theta: Any, *, detail: bool = True) -> NDArray[np.float32]:
        """World positions ``(F, V, 3)`` at normalised parameters."""
        parts = self.motions(joints, theta=theta, detail=detail)
        return np.concatenate([m.vertices() for m in parts])

    def step(
        self, state: tuple[NetworkState, ...] | None, pose: Any, theta: Any
    ) -> tuple[tuple[NetworkState, ...], NDArray[np.float32]]:
        """One frame: joints ``(J, 3, 4)`` to world positions ``(V, 3)``."""
        motion, state = self.run(np.asarray(pose)[None], state, theta=theta)
        return state, motion.vertices()[0]
