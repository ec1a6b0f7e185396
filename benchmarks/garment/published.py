"""The baselines of the paper's tables 2 and 3, as published and in stronger variants.

Parts of a publication that depend on several body shapes, styles or images are left out, since all
clips are of one body and one garment.
"""

from __future__ import annotations

import copy
from pathlib import Path

import torch
from torch import Tensor, nn

from benchmarks.garment.regression import FrameMLP, Variant, WindowMLP
from garmentnet.evaluation.methods import Network
from garmentnet.io.files import Progress, silent
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.networks.detail_basis import DetailBasis
from garmentnet.training.batches import Track
from garmentnet.training.detail import DetailObjective
from garmentnet.training.loop import fit

# Santesteban, Otaduy & Casas 2019, "Learning-based animation of clothing for virtual try-on": a GRU
# from the body's pose to offsets of the rest pose.  Here it reads the features of the network that
# it is compared with.
SANTESTEBAN = Variant("Santesteban 2019")
BASELINES = (
    # Patel, Liao & Pons-Moll 2020: MLPs that read the pose of one frame, one for the smoothed
    # garment and one for its detail.  With one body and one style, the mixture has one component.
    Variant(
        "TailorNet",
        parts=("low", "high"),
        network=FrameMLP,
        features="rooted",
        changes=tuple(f"features.{n}=false" for n in ("velocities", "root_motion", "joint_motion")),
    ),
    # After the coarse garment of Zhang, Wang, Ceylan & Mitra 2021, "Dynamic Neural Garments": an
    # MLP that reads the last frames of the body's motion, without skinning.
    Variant("DNG, coarse", parts=("low",), network=WindowMLP, unposed=False, features="rooted"),
    # The published version reads rotations alone, not the translation of the body.
    Variant(
        "Santesteban 2019, as published",
        parts=("low",),
        features="faithful",
        changes=("features.translation=false",),
    ),
    Variant("Santesteban 2019, features of faithful", parts=("low",), features="faithful"),
    Variant("Santesteban 2019, features of rooted", parts=("low",), features="rooted"),
)


class TransformerDetail(DetailBasis):
    """Detail by a transformer over windows of the bones' motion.

    After Chen, Gao, Wen, Wang & Yuan 2021, "Deep deformation detail synthesis for thin shell
    models", whose transformer reads deformation features of a coarse cloth.

    Parameters
    ----------
    inputs, n_vertices, hidden, rank
        As for :class:`~garmentnet.networks.detail_basis.DetailBasis`.
    frames : int
        Length of a window; the last one of a motion may be shorter.
    """

    def __init__(
        self, inputs: int, n_vertices: int, *, hidden: int, rank: int, frames: int = 30
    ) -> None:
        super().__init__(inputs, n_vertices, hidden=8, rank=rank)
        self.frames = frames
        self.enter = nn.Linear(inputs, hidden)
        self.place = nn.Parameter(torch.zeros(frames, hidden))
        layer = nn.TransformerEncoderLayer(hidden, 4, 2 * hidden, dropout=0.1, batch_first=True)
        self.encoder = nn.TransformerEncoder(layer, 2, enable_nested_tensor=False)
        self.leave = nn.Linear(hidden, rank)

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        windows = x.split(self.frames, dim=1)
        coded = [self.encoder(self.enter(w) + self.place[: w.shape[1]]) for w in windows]
        out = self.leave(torch.cat(coded, dim=1)) * self.deviation
        return out, x.new_zeros(1, len(x), 1)


def train_chen(
    model: Checkpoint,
    tracks: list[Track],
    validation: list[Track],
    folder: Path,
    *,
    hidden: int = 256,
    progress: Progress = silent,
) -> Network:
    """Trained copy of a network in which a transformer predicts the detail.

    Parameters
    ----------
    model : Checkpoint
        A trained network with detail in a basis.
    tracks, validation : list of Track
        Tracks with the inputs of that network.
    folder : Path
        Folder of the training's state, from which an interrupted training continues and a finished
        one is read.
    hidden : int
        Width of the transformer, a multiple of 4.
    progress : callable, optional
    """
    folder.mkdir(parents=True, exist_ok=True)
    network = copy.deepcopy(model.networks[0])
    o = network.config
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(o.train.seed)
        network.high = TransformerDetail(
            network.high.gru.input_size, len(network.free), hidden=hidden, rank=o.high.rank
        ).to(network.device)
    fit(
        DetailObjective(network, tracks, validation),
        o.train,
        name="high",
        epochs=o.train.high_epochs,
        # A transformer does not converge at the rate of a GRU.
        learning_rate=o.train.high_learning_rate / 10,
        folder=folder,
        progress=progress,
    )
    return Network("Chen 2021", Checkpoint((network,), model.parameters, None))
