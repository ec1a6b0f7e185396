"""High-frequency modules side by side on a garment's creases, beside the mean detail alone.

From a store with clips of every split, with the bones of ``detail.py``::

    python benchmarks/garment/modules.py out/soft_dress.clips --work out/modules

Every module sees the same: every third frame, every fourth free vertex, and of the low frequencies
the bones as they were fitted to the simulation, not as a network predicts them: the error is the
least that the module has behind any low-frequency module.  Small widths (``--hidden``), no
mirrored clips, no collision loss.  What is finished in ``--work`` is not trained again.

Without a split (``--set bones.length=0 --set bones.count=20``) modules learn what skinning by bones
of the whole garment leaves.  *Overall* compares skinning and module with the whole garment, as the
size of what is learned depends on the bones.
"""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common
from benchmarks.garment.detail import Detail, rms
from benchmarks.garment.intervals import paired_ratio
from benchmarks.garment.matching import Windows
from benchmarks.garment.published import TransformerDetail
from benchmarks.garment.regression import FrameMLP
from garmentnet.configs.config import (
    Config,
    FeatureOptions,
    HighOptions,
    load_config,
    override,
)
from garmentnet.data.store import ClipStore
from garmentnet.data.virtual_bones import VirtualBones, virtual_bones
from garmentnet.networks.detail_basis import DetailBasis, SurfaceTurns
from garmentnet.networks.features import Normaliser, PoseFeatures
from garmentnet.networks.gru import dropout_mask
from garmentnet.networks.high_frequency import HighFrequency
from garmentnet.networks.skinning import TorchSkinning, remove_frame
from garmentnet.training.batches import Batch, Track
from garmentnet.training.coefficients import CoefficientObjective
from garmentnet.training.loop import TrainingObjective, fit, mixed_precision
from garmentnet.training.losses import frame_norm

RANK = 64
HELD = 4  # clips for validation
NEAREST = 6  # vertices that the local stream joins to each of those that are left
EDGES = (8, 8, 16)  # three EdgeConvs, as the paper's text has it; widths end as the published ones
MEAN = "mean detail alone"
GRU = "components, GRU of the bones' motion"


class Clip:
    """Motion and detail of a clip, every so many frames.

    local (F, B, 3, 4)  bones in the body's moving frame; body (F, D): features of `rooted`
    detail (F, n, 3)    in frames that turn with the surface; joints: the body's rotations alone
    left (F, n, 3)      what skinning by the bones leaves of the whole, in the same frames
    """

    left: np.ndarray

    def __init__(self, detail: Detail, name: str, memory: PoseFeatures, pose: PoseFeatures) -> None:
        motion, found = detail(name)
        columns = motion[:, : motion.shape[1] // 2].reshape(len(motion), -1, 3, 3)
        a, b, t = (columns[..., k] for k in range(3))
        self.name, self.detail = name, found
        self.local = np.stack([a, b, np.cross(a, b), t], axis=-1)
        joints = detail.bones.store.clip(name).joints
        self.body, self.joints = (f(joints)[0][:: detail.every] for f in (memory, pose))


class FrameDetail(DetailBasis):
    """TailorNet's network for detail: an MLP that reads the pose of one frame."""

    def __init__(self, inputs: int, n_vertices: int, *, hidden: int, rank: int) -> None:
        super().__init__(inputs, n_vertices, hidden=8, rank=rank)
        self.net = FrameMLP(inputs, hidden, rank)

    def forward(
        self, x: Tensor, state: Tensor | None = None, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        out, state = self.net(x, None, mask)
        return out * self.deviation, state


class VertexObjective(TrainingObjective):
    """Loss ‖Ĝ_HF − G_HF‖ of the paper's module; a track's extra is (F, 2, n, 3): mesh, detail."""

    def __init__(
        self, module: HighFrequency, config: Config, tracks: list[Track], validation: list[Track]
    ) -> None:
        self.module, self.config, self.tracks, self.validation = module, config, tracks, validation
        low, goal = torch.cat([t.extra for t in tracks]).unbind(1)
        module.mean.copy_(goal.mean(0))
        module.deviation.fill_(float((goal - module.mean).square().mean().sqrt()))
        module.centre.copy_(low[0].mean(0))

    def loss(
        self, batch: Batch, state: Tensor | None, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor]:
        o, x = self.config.high, batch.inputs()
        lanes, frames, chosen = batch.some_frames(o.frames, rng)
        known = torch.stack([t.extra[torch.from_numpy(f)] for t, f in frames])
        low = torch.zeros(len(x), *known.shape[1:2], *known.shape[3:])
        low[lanes] = known[:, :, 0]
        mask = dropout_mask(rng, (*chosen.shape, o.hidden), o.dropout, torch.device("cpu"))
        with mixed_precision(self.config.train, torch.device("cpu")):
            got, state = self.module(x, low, state, torch.from_numpy(chosen), mask)
        return frame_norm(got.float()[lanes] - known[:, :, 1]), state

    def predict(self, track: Track) -> Tensor:
        state, out = None, []
        for part in track.parts():
            low = track.extra[None, part, 0]
            got, state = self.module(track.inputs[None, part], low, state)
            out.append(got[0])
        return torch.cat(out)

    def squared_error(self, track: Track) -> Tensor:
        return (self.predict(track) - track.extra[:, 1]).double().square().sum(-1).mean(-1)


class Comparison:
    """The modules, trained on some clips and asked for others."""

    def __init__(self, bones: VirtualBones, config: Config, every: int, work: Path) -> None:
        self.bones, self.config, self.work = bones, config, work
        store = bones.store
        self.some = Detail(bones, every, config.features)
        still = FeatureOptions(rotation="sixd", heading_free=True, translation=False, floor=0.01)
        self.readers = [
            PoseFeatures(store.skeleton, o, store.fps) for o in (config.features, still)
        ]
        base = store.parameters()[0]
        names = {split: store.names(split, base) for split in ("train", "validation", "test")}
        names["validation"] = names["validation"][:HELD]
        s, free = bones.skinning, self.some.free
        self.lbs = TorchSkinning(s.rest[free], s.indices[free], s.weights[free], s.n_bones)
        self.turns = SurfaceTurns(s.indices, s.weights, s.n_bones, free)
        near = cKDTree(s.rest[free]).query(s.rest[free], NEAREST + 1)[1]
        # Triangles of a vertex and two of its neighbours: only their edges are used.
        self.fans = np.concatenate([near[:, [0, k, k + 1]] for k in range(1, NEAREST)])
        self.clips = {s: [self.read(n) for n in names[s]] for s in names}

    def read(self, name: str) -> Clip:
        clip, known = Clip(self.some, name, *self.readers), self.bones.store.clip(name)
        here = slice(None, None, self.some.every)
        frame = self.some.features(known.joints)[1][here]
        whole = remove_frame(frame, known.sequence.frames(here)[:, self.some.free])
        local = torch.from_numpy(clip.local).float()
        gap = torch.from_numpy(whole).float() - self.lbs(local)
        clip.left = (self.turns(local).mT @ gap[..., None])[..., 0].numpy()
        if not self.bones.options.length:
            clip.detail = clip.left
        return clip

    @functools.cached_property
    def components(self) -> dict[str, Tensor]:
        """Mean and principal components of the training clips' detail."""
        module = DetailBasis(1, len(self.some.free), hidden=8, rank=RANK)
        module.fit(torch.from_numpy(np.concatenate([c.detail for c in self.clips["train"]])))
        return dict(module.named_buffers())

    def tracks(self, kind: str, split: str, extra: Callable[[Clip], Tensor]) -> list[Track]:
        """Tracks whose inputs are the motion of the "bones" or the "body", or the "joints"."""

        def read(clip: Clip) -> np.ndarray:
            if kind == "bones":
                return np.asarray(clip.local[..., [0, 1, 3]].reshape(len(clip.local), -1), float)
            return np.asarray(getattr(clip, kind), float)

        scale = Normaliser.fit(map(read, self.clips["train"]), floor=0.01, clamp=5.0)
        frame = np.zeros((0, 3, 4))
        return [
            Track(c.name, self.bones, torch.from_numpy(scale(read(c))), frame, extra(c))
            for c in self.clips[split]
        ]

    def vertices(self, clip: Clip) -> Tensor:
        """Low-frequency mesh and detail in the moving frame, ``(F, 2, n, 3)``."""
        local = torch.from_numpy(clip.local).float()
        turned = (self.turns(local) @ torch.from_numpy(clip.detail)[..., None])[..., 0]
        return torch.stack([self.lbs(local), turned], dim=1)

    def basis(self, kind: str, make: type[DetailBasis], rate: float) -> tuple[Any, nn.Module]:
        """Detail of the test clips, in surface frames, by weights of principal components."""
        n, o = len(self.some.free), self.config
        inputs = self.tracks(kind, "test", lambda c: torch.empty(0))[0].inputs.shape[1]
        module = make(inputs, n, hidden=o.high.hidden, rank=RANK)
        for name, value in self.components.items():
            getattr(module, name).copy_(value)

        def coded(clip: Clip) -> Tensor:
            numbers, rest = module.code(torch.from_numpy(clip.detail))
            return torch.cat([numbers, rest[:, None]], dim=1)

        tracks, held, test = (self.tracks(kind, s, coded) for s in self.clips)
        objective = CoefficientObjective(
            module,
            o.train,
            n,
            hidden=o.high.hidden,
            # A transformer has dropout of its own.
            dropout=0.0 if make is TransformerDetail else o.high.dropout,
            tracks=tracks,
            validation=held,
        )
        self.fit(objective, f"{make.__name__}-{kind}", rate)
        with torch.no_grad():
            return [module.local(module(t.inputs[None])[0][0]).numpy() for t in test], module

    def edges(self, widths: tuple[int, ...]) -> tuple[Any, nn.Module]:
        """Detail of the test clips by the paper's module, in surface frames."""
        tracks, held, test = (self.tracks("bones", s, self.vertices) for s in self.clips)
        n = len(self.some.free)
        edge = self.bones.skinning.rest[self.some.free][self.fans]
        options = HighOptions(
            hidden=self.config.high.hidden, edge_features=widths, batch_norm=False
        )
        length = float(np.linalg.norm(edge[:, 0] - edge[:, 1], axis=-1).mean())
        inputs = tracks[0].inputs.shape[1]
        module = HighFrequency(inputs, self.fans, n, options, edge_length=length)
        objective = VertexObjective(module, self.config, tracks, held)
        self.fit(objective, f"edges-{len(widths)}", self.config.train.high_learning_rate)
        found = []
        with torch.no_grad():
            for clip, track in zip(self.clips["test"], test, strict=True):
                turn = self.turns(torch.from_numpy(clip.local).float())
                got = objective.predict(track)
                found.append((turn.mT @ got[..., None])[..., 0].numpy())
        return found, module

    def fit(self, objective: TrainingObjective, name: str, rate: float) -> None:
        folder = self.work / name
        folder.mkdir(parents=True, exist_ok=True)
        o = self.config.train
        fit(objective, o, name="high", epochs=o.high_epochs, learning_rate=rate, folder=folder)

    def matching(self, count: int) -> tuple[Any, None]:
        """Detail of the test clips: that of the training frames whose windows are most alike."""
        kinds = {s: self.tracks("body", s, lambda c: torch.empty(0)) for s in self.clips}
        windows = Windows([t.inputs.numpy() for t in kinds["train"]], lags=(0, 1, 2, 4, 8))
        known = np.concatenate([c.detail for c in self.clips["train"]])
        found = []
        for track in kinds["test"]:
            index, weight = windows.nearest(track.inputs.numpy(), count)
            found.append(np.einsum("fk,fkvi->fvi", weight, known[index]).astype(np.float32))
        return found, None

    def chaos(self) -> tuple[Any, None]:
        """The test clips' detail, off by 1/√2 of what separates it from a clip's moved twin."""
        twins = dict(self.bones.store.pairs())
        pairs = [(c.detail, self.read(twins[c.name]).detail) for c in self.clips["test"]]
        return [a + (b - a) / np.sqrt(2) for a, b in pairs], None

    def mean(self) -> tuple[Any, None]:
        whole = np.concatenate([c.detail for c in self.clips["train"]])
        mean = whole.mean(axis=0)
        return [np.broadcast_to(mean, c.detail.shape) for c in self.clips["test"]], None


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path)
    options.add_argument("--work", type=Path, default=Path("out/modules"))
    options.add_argument("--every", type=int, default=3, help="frames between those that are used")
    options.add_argument("--hidden", type=int, default=128)
    options.add_argument("--epochs", type=int, default=40)
    options.add_argument("--set", action="append", default=[], help="settings of the bones")
    options.add_argument("--only", nargs="+", default=[""], help="rows whose name contains one")
    options.add_argument("--out", type=Path, default=common.RESULTS / "garment-modules.json")
    given = options.parse_args()
    torch.set_num_threads(1)
    changes = [
        "bones.effort=fast",
        *given.set,
        f"high.hidden={given.hidden}",
        f"train.high_epochs={given.epochs}",
        "train.high_learning_rate=2e-3",
        "train.batch=5",
        "train.tensorboard=false",
    ]
    config = override(load_config("rooted"), changes)
    bones = virtual_bones(ClipStore.open(given.store), config.bones)
    target = "" if bones.options.length else f"residual of {bones.options.count} bones: "
    work = given.work / f"{given.hidden}-{given.epochs}"
    if target:
        work /= f"residual-{bones.options.count}"
    run = Comparison(bones, config, given.every, work)
    rate = config.train.high_learning_rate
    methods: dict[str, Callable[[], tuple[Any, nn.Module | None]]] = {
        MEAN: run.mean,
        "motion matching, nearest window": lambda: run.matching(1),
        "motion matching, 8 windows": lambda: run.matching(8),
        GRU: lambda: run.basis("bones", DetailBasis, rate),
        "the paper's: GRU and three EdgeConvs": lambda: run.edges(EDGES),
        "the paper's without the local stream": lambda: run.edges(()),
        "components, GRU of the body's motion": lambda: run.basis("body", DetailBasis, rate),
        "components, transformer (Chen 2021)": lambda: run.basis(
            "bones", TransformerDetail, rate / 4
        ),
        "components, MLP of one pose (TailorNet)": lambda: run.basis("joints", FrameDetail, rate),
        "chaos floor": run.chaos,
    }
    clips = run.clips["test"]
    count = np.array([len(c.detail) for c in clips])

    def pooled(errors: list[float]) -> float:
        return float(np.sqrt(np.average(np.square(errors), weights=count)))

    rows = common.read_rows(given.out)
    command = ["python benchmarks/garment/modules.py", given.store.name]
    command += [f"--{k} {vars(given)[k]}" for k in ("every", "hidden", "epochs")]
    for method, make in methods.items():
        name = target + method
        if name in rows or (method != MEAN and not any(t in method for t in given.only)):
            continue
        began = time.process_time()
        found, module = make()
        each = [rms(a - c.detail) for a, c in zip(found, clips, strict=True)]
        error, size = pooled(each), pooled([rms(c.detail) for c in clips])
        mean = rows.get(target + MEAN)
        against = mean["clips, mm"] if mean else each
        rows[name] = {
            "rmse, mm": error,
            "left": error / size,
            "detail, mm": size,
            "skinning alone, mm": pooled([rms(c.left) for c in clips]),
            "overall, mm": pooled([rms(a - c.left) for a, c in zip(found, clips, strict=True)]),
            "of the mean's error": list(paired_ratio(each, against, frames=count)),
            "clips, mm": each,
            "parameters": sum(p.numel() for p in module.parameters()) if module else 0,
            "cpu seconds": time.process_time() - began,
            "frames learned": int(sum(len(c.detail) for c in run.clips["train"])),
            "command": " ".join([*command, *(f"--set {text}" for text in given.set)]),
            "revision": common.revision(),
        }
        common.write_rows(given.out, rows)
        print(name, rows[name], flush=True)
    columns = ["module", "rmse, mm", "left", "overall, mm", "parameters", "cpu seconds"]
    print(f"{len(clips)} test clips, {len(run.some.free)} vertices")
    print(common.table([{"module": n} | r for n, r in rows.items()], columns))


if __name__ == "__main__":
    main()
