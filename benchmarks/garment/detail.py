"""What there is to learn in the detail of a garment: mean alone, regressions by frames, chaos.

From a store with clips of every split::

    python benchmarks/garment/detail.py out/soft_dress.clips
    python benchmarks/garment/detail.py out/soft_dress.clips --clip base-dance-20002 --picture a.png

Detail is what the smoother of 20 mm takes away, in frames that turn with the skinned surface, over
every fourth free vertex.  Printed are its RMS on the test clips, what a constant vector for each
vertex leaves of it, what regressions from the motion of the virtual bones leave (ridge, and a
Gaussian kernel; the penalty is chosen on the validation clips), by training frames, and the chaos
floor second by second.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from scipy.linalg import eigh

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from garmentnet.configs.config import FeatureOptions, load_config, override
from garmentnet.data.store import ClipStore
from garmentnet.data.virtual_bones import VirtualBones, virtual_bones
from garmentnet.drawing.dressed import dressed, facing_the_camera, outfit_look
from garmentnet.networks.detail_basis import SurfaceTurns
from garmentnet.networks.features import PoseFeatures, transforms_in_frame
from ssdr import MeshSequence
from ssdr.render import render_frame

PENALTIES = 10.0 ** np.arange(-4, 2)
SECOND = 30  # frames
SPARSE = 4  # free vertices between those that are measured
SIZE = (900, 1200)  # pixels of a picture
Array = np.ndarray


class Detail:
    """Detail of clips in the surface's frame, and the motion of the bones under it."""

    def __init__(
        self, bones: VirtualBones, every: int, options: FeatureOptions | None = None
    ) -> None:
        self.bones, self.every = bones, every
        s, store = bones.skinning, bones.store
        self.free = np.flatnonzero(~np.asarray(store.pinned, bool))[::SPARSE]
        self.turns = SurfaceTurns(s.indices, s.weights, s.n_bones, self.free)
        options = options or load_config("rooted").features
        self.features = PoseFeatures(store.skeleton, options, store.fps)

    def __call__(self, name: str) -> tuple[Array, Array]:
        """Motion ``(f, n)`` of the bones, and detail ``(f, v, 3)``, every so many frames."""

        def make() -> dict[str, Any]:
            low, high = self.bones.split(name, slice(None, None, self.every))
            m = self.bones.fit(low, tolerance=1e-3)
            turn = self.turns(torch.from_numpy(m)).numpy()
            frame = self.features(self.bones.store.clip(name).joints)[1][:: self.every]
            local = transforms_in_frame(m, frame)
            pose = local[..., [0, 1, 3]].reshape(len(local), -1)
            motion = np.concatenate([pose, np.diff(pose, axis=0, prepend=pose[:1])], axis=1)
            detail = np.einsum("fvji,fvj->fvi", turn, high[:, self.free])
            return {"motion": motion.astype(np.float32), "detail": detail.astype(np.float32)}

        found = self.bones.kept(f"detail-{self.every}", name, make)
        return found["motion"], found["detail"]

    def of(self, names: Sequence[str]) -> tuple[Array, Array]:
        motion, detail = zip(*map(self, names), strict=True)
        return np.concatenate(motion), np.concatenate(detail).reshape(sum(map(len, detail)), -1)


def rms(x: Array) -> float:
    """RMS, mm, of vectors; they may be stored flat."""
    return 1e3 * float(np.sqrt(3 * np.square(x, dtype=np.float64).mean()))


def regressions(
    learned: tuple[Array, Array], held: tuple[Array, Array], test: tuple[Array, Array]
) -> dict[str, float]:
    """Error on the test, mm, of the mean detail and of two regressions from the bones' motion."""
    x, y = learned
    mean, centre = y.mean(axis=0), x.mean(axis=0)
    scale = np.maximum(x.std(axis=0), 1e-2)
    z, *others = (((a - centre) / scale).clip(-5, 5) for a in (x, held[0], test[0]))
    found = {"mean": rms(test[1] - mean)}
    square = (z**2).mean(axis=1)
    width = float(np.median(square[:, None] + square - 2 * z @ z.T / z.shape[1]))

    def kernel(name: str, a: Array) -> Array:
        product = np.asarray(a @ z.T / z.shape[1], np.float64)
        if name == "ridge":
            return product
        gap = (a**2).mean(axis=1)[:, None] + square - 2 * product
        return np.asarray(np.exp(-gap / (2 * width)))

    for name in ("ridge", "kernel"):
        values, vectors = eigh(kernel(name, z))
        right = vectors.T.astype(np.float32) @ (y - mean)
        left = [kernel(name, a) @ vectors for a in others]
        best = np.inf
        for penalty in PENALTIES * values[-1] / 100:
            shrunk = 1 / (values.clip(0) + penalty)
            error, own = (
                rms(b - mean - (a * shrunk).astype(np.float32) @ right)
                for a, b in zip(left, (held[1], test[1]), strict=True)
            )
            if error < best:
                best, found[name] = error, own
    return found


def sizes(counts: Sequence[int]) -> Iterator[int]:
    """Numbers of clips that double, and all of them."""
    k = 1
    while k < len(counts):
        yield k
        k *= 2
    yield len(counts)


def chaos(bones: VirtualBones, free: Array) -> list[float]:
    """RMSE / √2, mm, of the detail between pairs of clips, second by second."""
    pairs = [[bones.split(n)[1][:, free] for n in pair] for pair in bones.store.pairs()]
    gaps = [(a - b).reshape(len(a), -1) for a, b in pairs]
    longest = max(map(len, gaps), default=0)
    return [
        rms(np.concatenate([g[t : t + SECOND] for g in gaps])) / np.sqrt(2)
        for t in range(0, longest, SECOND)
    ]


def picture(store: ClipStore, name: str, frames: list[int], file: Path) -> None:
    """Draw frames of a clip side by side, seen from a little beside the body's front."""
    clip = store.clip(name)
    joints = clip.joints[frames]
    cloth, body = clip.sequence.frames(frames), clip.body()[frames]
    scene = dressed(body, cloth, store.body.faces, store.faces, store.fps)
    root = store.skeleton.positions(joints)[:, 0]
    turned = facing_the_camera(scene.vertices, root, joints)
    sheet = Image.new("RGB", (SIZE[0] * len(frames), SIZE[1]))
    for k, vertices in enumerate(turned):
        look = outfit_look(store.body.n_vertices, store.n_vertices)
        one = MeshSequence(vertices[None], scene.faces, store.fps)
        sheet.paste(render_frame(one, **look, size=SIZE, azimuth=25.0), (SIZE[0] * k, 0))
    sheet.save(file)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("store", type=Path)
    options.add_argument("--every", type=int, default=3, help="frames between those that are used")
    options.add_argument("--set", action="append", default=[], help="settings of the bones")
    options.add_argument("--picture", type=Path, help="draw frames of --clip instead")
    options.add_argument("--clip")
    options.add_argument("--frames", type=int, nargs="+", default=[90, 130, 175, 200])
    given = options.parse_args()
    store = ClipStore.open(given.store)
    if given.picture:
        picture(store, given.clip, given.frames, given.picture)
        return
    config = override(load_config("rooted"), ["bones.effort=fast", *given.set])
    bones = virtual_bones(store, config.bones)
    detail = Detail(bones, given.every)
    base = store.parameters()[0]
    train, held, test = (store.names(s, base) for s in ("train", "validation", "test"))
    checked, unseen = detail.of(held), detail.of(test)
    whole = rms(unseen[1])
    print(f"detail {whole:.2f} mm on {len(test)} test clips, {len(detail.free)} vertices")
    print("| training frames | mean alone | ridge | kernel |\n|---|---|---|---|")
    for count in sizes(train):
        learned = detail.of(train[:count])
        found = regressions(learned, checked, unseen)
        cells = (f"{e:.2f} mm, {100 * e / whole:.0f} %" for e in found.values())
        print(f"| {given.every * len(learned[0]):,} | {' | '.join(cells)} |", flush=True)
    floors = chaos(bones, detail.free)
    print("chaos floor by seconds, mm:", " ".join(f"{x:.2f}" for x in floors))


if __name__ == "__main__":
    main()
