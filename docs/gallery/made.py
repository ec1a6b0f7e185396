"""The files that the pages of the gallery work on: ``python docs/gallery/made.py FOLDER``.

A face, a ball and a starfish come from the formulas below, two clips from the sample.  The dress
was simulated (dress.toml) and lies beside this script.
"""

from __future__ import annotations

import dataclasses
import shutil
import sys
from pathlib import Path

import numpy as np
import trimesh

import ssdr

Array = np.ndarray


def starfish(frames: int = 32) -> ssdr.MeshSequence:
    """A starfish of radius 1 whose arms curl one after the other, in a loop of two seconds."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    angle = np.arctan2(ball.vertices[:, 2], ball.vertices[:, 0])
    along = np.hypot(ball.vertices[:, 0], ball.vertices[:, 2])
    along *= 0.3 + 0.7 * np.cos(2.5 * angle) ** 4
    height = 0.2 * ball.vertices[:, 1] * (1 - 0.5 * along)
    phase = 2 * np.pi * np.arange(frames)[:, None] / frames
    curl = 0.6 + 0.9 * np.sin(phase + 2 * angle)
    turn = angle + 0.35 * along * np.sin(phase + angle)
    out = np.sin(curl * along) / curl - height * np.sin(curl * along)
    up = (1 - np.cos(curl * along)) / curl + height * np.cos(curl * along)
    vertices = np.stack([out * np.cos(turn), up, out * np.sin(turn)], axis=-1)
    return ssdr.MeshSequence(vertices, ball.faces, 16, name="starfish")


def bouncing_ball(frames: int = 48) -> ssdr.MeshSequence:
    """A rubber ball of 20 cm that bounces twice: long as it flies, flat where it lands."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    turn = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    part = (2 * np.arange(frames) / frames) % 1.0
    flight = np.clip((part - 0.2) / 0.8, 0, 1)
    speed = np.where(part < 0.2, -np.cos(np.pi * part / 0.2), 1 - 2 * flight)
    flat = 0.6 * np.sin(np.pi * np.clip(part / 0.2, 0, 1))
    long = 1 + 0.4 * speed**2
    high, lean = long - flat + 6 * flight * (1 - flight), 0.3 * speed * np.cos(turn)
    x, y, z = ball.vertices.T[:, None]
    flat, long, high, lean, way = (a[:, None] for a in (flat, long, high, lean, np.sin(turn)))
    up = np.logaddexp(0, 20 * (y * long + high)) / 20  # nothing goes through the floor
    wide = (1 + 0.5 * flat * np.exp(-1.5 * up)) / np.sqrt(long)
    vertices = np.stack([
        x * wide + lean * (up - high) + 1.2 * way, up, z * wide,
    ], axis=-1)  # fmt: skip
    return ssdr.MeshSequence(0.1 * vertices, ball.faces, 24, name="ball")


def face(frames: int = 72) -> tuple[ssdr.MeshSequence, ssdr.Skinning]:
    """A head of 21 cm that speaks, in metres, and the rig of eight morph targets that moves it."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    x, y, z = ball.vertices.T
    polar = np.arccos(np.clip(z, -1, 1))  # half of the vertices go to the face
    ring = np.sin(np.pi * (polar / np.pi) ** 1.5) / np.maximum(np.sin(polar), 1e-9)
    x, y, z = x * ring, y * ring, np.cos(np.pi * (polar / np.pi) ** 1.5)

    def spot(cx: float, cy: float, wx: float, wy: float) -> Array:
        return (z > 0) * np.exp(-(((x - cx) / wx) ** 2) - ((y - cy) / wy) ** 2)

    def pair(cx: float, cy: float, wx: float, wy: float) -> Array:
        return spot(cx, cy, wx, wy) + spot(-cx, cy, wx, wy)

    mouth, side = spot(0, -0.45, 0.26, 0.03), np.sign(x)
    bumps = (
        0.26 * spot(0, -0.1, 0.1, 0.13) + 0.12 * spot(0, 0.1, 0.08, 0.2)
        - 0.12 * pair(0.32, 0.15, 0.17, 0.12) + 0.1 * pair(0.32, 0.14, 0.1, 0.08)
        + 0.06 * pair(0.32, 0.36, 0.2, 0.07) + 0.1 * spot(0, -0.8, 0.2, 0.15)
        + 0.07 * spot(0, -0.37, 0.22, 0.05) + 0.08 * spot(0, -0.54, 0.2, 0.06) - 0.06 * mouth
    )  # fmt: skip
    rest = np.stack([0.8 * x, 1.05 * y, 0.95 * z + bumps], axis=-1)
    jaw = (z > -0.2) / (1 + np.exp((y + 0.46) / 0.015)) * np.exp(-((x / 0.7) ** 2))
    corner, lips, none = pair(0.26, -0.45, 0.13, 0.13), spot(0, -0.45, 0.25, 0.13), 0 * x
    left, right = spot(0.32, 0.36, 0.25, 0.13), spot(-0.32, 0.36, 0.25, 0.13)
    targets = np.stack([
        np.stack(target, axis=-1) for target in (
            (none, -0.2 * jaw, -0.05 * jaw - 0.15 * mouth),         # the jaw falls
            (0.09 * side * corner, 0.1 * corner, -0.04 * corner),   # smile
            (-0.5 * x * lips, none, 0.1 * lips),                    # pucker
            (none, 0.1 * left, 0.02 * left),                        # left brow
            (none, 0.1 * right, 0.02 * right),                      # right brow
            (none, -0.1 * pair(0.32, 0.22, 0.13, 0.06), 0.03 * pair(0.32, 0.22, 0.13, 0.06)),
            (none, none, 0.12 * pair(0.45, -0.35, 0.17, 0.17)),     # cheeks
            (none, 0.05 * spot(0, -0.1, 0.2, 0.12), none),          # nose
        )
    ])  # fmt: skip
    time = np.arange(frames)[:, None] / frames
    rate, start = np.array([6, 1, 2, 2, 1, 3, 1, 2]), np.array([0, 3, 5, 1, 1, 2, 5, 4]) / 6
    strength = np.maximum(np.sin(2 * np.pi * (rate * time - start)), 0) ** 2
    names = ("jaw", "smile", "pucker", "brow_left", "brow_right", "blink", "cheeks", "nose")
    bones = ssdr.Skinning.from_dense(
        0.1 * rest, np.ones((len(rest), 1)), np.tile(np.eye(3, 4), (frames, 1, 1, 1)),
        faces=ball.faces, fps=24, name="face",
    )  # fmt: skip
    rig = ssdr.ShapedSkinning(bones, ssdr.Shapes(0.1 * targets, strength, names=names))
    return ssdr.MeshSequence(rig.skin(), ball.faces, 24, name="face"), rig


def write(folder: Path) -> None:
    """Write the files of all pages."""
    (folder / "generated").mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("dress.npz"), folder)
    head, rig = face()
    ssdr.save(head, folder / "face.npz")
    ssdr.save(rig, folder / "rig.glb")
    ssdr.save(bouncing_ball(), folder / "ball.npz")
    clean = starfish()
    jitter = np.random.default_rng(0).normal(0, 0.004, clean.vertices.shape)
    generated = dataclasses.replace(clean, vertices=clean.vertices + jitter)
    ssdr.save(generated, folder / "generated" / "frame_%04d.ply")
    ssdr.save(clean, folder / "clean.npz")
    dancer = ssdr.samples.load("dancer")
    for name, part in (("step", slice(0, 24)), ("jump", slice(24, 48))):
        clip = dataclasses.replace(dancer, vertices=dancer.vertices[part], clip=name)
        ssdr.save(clip, folder / f"{name}.npz")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
