"""Low frequencies of clips as coefficients of principal components, kept on disk.

A million frames of vertices fit neither into memory nor through a matrix product in every epoch;
their coefficients take 400 bytes a frame.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.clip import MIRRORED
from ..io.files import kept
from ..io.tensors import digest
from ..networks.features import PoseFeatures
from ..paper.bones import VirtualBones, remove_frame
from .batches import Track
from .losses import mesh_laplacian
from .shapes import ShapeBasis

# Number of components: 192 leave an error of 1 to 2 mm on a loose dress; networks have 15 to 20 mm.
_RANK = 192
# Number of training frames, evenly spread, from which the components are found.
_FRAMES = 2000


class LowTargets:
    """Coefficients of the low-frequency meshes of clips, in the moving frame of a network.

    Parameters
    ----------
    bones : VirtualBones
        Virtual bones, in whose folder the coefficients are stored, one file per clip.
    features : PoseFeatures
        Features that define the moving frame.
    names : sequence of str
        Training clips, from which the components are found.

    Attributes
    ----------
    basis : ShapeBasis
    free : (n,) int array
        Vertices that a network predicts.
    laplacian : (n, n) sparse array
        Laplacian Δ restricted to these vertices.
    """

    def __init__(self, bones: VirtualBones, features: PoseFeatures, names: list[str]) -> None:
        self.bones, self.features = bones, features
        self._folder = f"low-{features.options.frame}-{digest({}, {'clips': names})[:8]}"
        store, n = bones.store, bones.store.n_vertices
        self.free = bones.subject.free
        laplacian = mesh_laplacian(store.faces, n)
        self.laplacian = laplacian[self.free][:, self.free]
        found = kept(
            bones.folder / self._folder / "basis.npz",
            lambda: dataclasses.asdict(self._fit(names)),
        )
        self.basis = ShapeBasis(**found)

    def rows(self, name: str) -> NDArray[np.float16]:
        """Coefficients of every frame of a clip, and the norms of the residuals, ``(F, r + 2)``.

        The last two columns are norms over the vertices that a network predicts, in metres: that
        of the mesh minus its approximation by the components, and that of the Laplacian of this
        difference.
        """
        plain = name.removesuffix(MIRRORED)
        rows: NDArray[np.float16] = self.bones.kept(
            self._folder, plain, lambda: {"rows": self._encode(plain)}
        )["rows"]
        if name != plain:
            rows[:, :-2] *= self.basis.sign.astype(np.float16)
        return rows

    def _fit(self, names: list[str]) -> ShapeBasis:
        plain = [n for n in names if not n.endswith(MIRRORED)]
        sample = self.bones.store.sample(plain, _FRAMES)
        meshes = [self._local(clip.name, frames) for clip, frames in sample]
        return ShapeBasis.fit(np.concatenate(meshes), _RANK, self.bones.store.mirror_vertices)

    def _local(self, name: str, frames: NDArray[np.int64] | slice) -> NDArray[np.float64]:
        """Low-frequency meshes of a clip in the moving frame."""
        frame = self.features(self.bones.store.clip(name).joints)[1][frames]
        local: NDArray[np.float64] = remove_frame(frame, self.bones.split(name, frames)[0])
        return local

    def _encode(self, name: str) -> NDArray[np.float16]:
        mesh = self._local(name, slice(None))
        rows = self.basis.encode(mesh)
        rest = (mesh - self.basis.decode(rows))[:, self.free]
        bent = self.laplacian @ rest.transpose(1, 0, 2).reshape(len(self.free), -1)
        norms = [
            np.sqrt((x**2).sum(axis=axes))
            for x, axes in ((rest, (1, 2)), (bent.reshape(len(self.free), -1, 3), (0, 2)))
        ]
        return np.column_stack([rows, *norms]).astype(np.float16)


@torch.no_grad()
def bone_motion(network: Any, track: Track) -> Tensor:
    """Normalised bone motion ``(F, B, C)`` that the low-frequency module predicts."""
    return network.low(track.inputs[None].to(network.device))[0][0]


@torch.no_grad()
def detail_target(network: Any, track: Track, z: Tensor, frames: Any = slice(None)) -> Tensor:
    """Target detail Ĝ_HF ``(f, V, 3)`` of frames with predicted bone motion `z` ``(f, B, C)``.

    With ``high.target = "residual"``, the default, it is the difference of the clip from the
    predicted low-frequency mesh, with "detail" the high-frequency part of the clip.
    """
    if network.config.high.target == "detail":
        return track.detail(frames)
    return track.mesh(frames) - network.mesh(z, track.joints(frames).to(z.device)).cpu()
