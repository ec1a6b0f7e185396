"""Fixtures that several test modules share."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

import ssdr

# a machine that is busy with other things is no fault of a test
settings.register_profile("suite", deadline=None, max_examples=40)
settings.load_profile("suite")
# what garmentnet installs: its tests, and those of what is measured with it, need it
collect_ignore = ["garmentnet", "benchmarks/garment", "gallery"]
if importlib.util.find_spec("torch"):
    collect_ignore = []
# what extras may change, which CI tests where all of them are installed
WITH_EXTRAS = (
    "garmentnet", "benchmarks", "gallery", "ssdr/mesh/test_executor.py",
    "ssdr/io/gltf/test_compression.py", "ssdr/model/test_lbs.py", "ssdr/test_other_libraries.py",
)  # fmt: skip
pytest.register_assert_rewrite("helpers.measures", "helpers.stretches", "helpers.surfaces")


def pytest_report_header() -> str:
    """What is left out without a line for each test."""
    return f"not installed, so not collected: {', '.join(collect_ignore)}" if collect_ignore else ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.relative_to(Path(__file__).parent).as_posix().startswith(WITH_EXTRAS):
            item.add_marker("extra")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real animations; tests that need it are skipped where it is absent."""
    stated = os.environ.get("SSDR_TEST_DATA")
    folder = Path(stated) if stated else Path(__file__).parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real animations at {folder}; SSDR_TEST_DATA names their folder")
    return folder


@pytest.fixture(scope="session")
def real(data_dir: Path) -> Callable[[str], ssdr.MeshSequence]:
    """Load a real animation by name."""

    def load(name: str) -> ssdr.MeshSequence:
        path = data_dir / f"{name}.npz"
        if not path.is_file():
            pytest.skip(f"no {path.name} in {data_dir}")
        return ssdr.load(path)

    return load


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)


def sheet(n_frames: int = 4, rows: int = 3, columns: int = 4) -> ssdr.MeshSequence:
    """A waving grid of triangles, float32."""
    x, y = np.meshgrid(np.linspace(0, 2, columns), np.linspace(0, 1, rows), indexing="xy")
    t = np.arange(n_frames)[:, None, None]
    z = 0.3 * np.sin(2 * x[None] + 0.7 * t) * (0.5 + y[None])
    shape = (n_frames, rows, columns)
    vertices = np.stack([np.broadcast_to(x, shape), np.broadcast_to(y, shape), z], axis=-1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 1, corner + columns
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return ssdr.MeshSequence(
        vertices.reshape(n_frames, -1, 3).astype(np.float32), faces, 25.0, name="sheet"
    )


@pytest.fixture
def wave() -> ssdr.MeshSequence:
    """Four frames of a waving grid of 12 vertices."""
    return sheet()


@pytest.fixture
def seam() -> ssdr.MeshSequence:
    """A waving grid whose middle column is doubled, as a UV seam does; surface and all."""
    whole = sheet(columns=5)
    left = np.arange(15).reshape(3, 5)[:, 2]
    vertices = np.concatenate([whole.vertices, whole.vertices[:, left]], axis=1)
    faces = whole.faces.copy()
    right_side = vertices[0, faces].mean(axis=1)[:, 0] > 1.0
    for new, old in enumerate(left):
        faces[right_side] = np.where(faces[right_side] == old, 15 + new, faces[right_side])
    uv = vertices[0, faces][..., :2].astype(np.float32) / 2
    uv[right_side] += 0.25
    normals = np.zeros((len(faces), 3, 3), dtype=np.float32)
    normals[..., 2] = 1
    normals[right_side] = np.float32([0.6, 0, 0.8])
    surface = ssdr.Surface(
        uv=uv,
        normals=normals,
        material_index=right_side.astype(np.int32),
        materials=(
            ssdr.Material(name="red", base_color=(1.0, 0.25, 0.125, 1.0)),
            ssdr.Material(name="skin", roughness=0.5, texture=b"\x89PNG\r\n\x1a\nnot a picture"),
        ),
    )
    return ssdr.MeshSequence(vertices, faces, 25.0, name="seam", surface=surface)


@pytest.fixture
def skinned(wave: ssdr.MeshSequence, rng: np.random.Generator) -> ssdr.Skinning:
    """A small exact skinning: 12 vertices, 5 bones, 3 influences, 6 frames."""
    weights = rng.random((12, 3))
    weights[rng.random((12, 3)) < 0.2] = 0
    weights[:, 0] += 0.5
    weights /= weights.sum(axis=1, keepdims=True)
    order = np.argsort(-weights, axis=1)
    weights = np.take_along_axis(weights, order, axis=1)
    indices = np.argsort(rng.random((12, 4)), axis=1)[:, :3]  # bone 4 moves nothing
    indices[weights == 0] = 0
    angle = rng.normal(0, 0.3, (6, 5))
    transforms = np.zeros((6, 5, 3, 4))
    transforms[..., 2, 2] = 1
    transforms[..., 0, 0] = transforms[..., 1, 1] = np.cos(angle)
    transforms[..., 1, 0] = np.sin(angle)
    transforms[..., 0, 1] = -np.sin(angle)
    transforms[..., 3] = rng.normal(0, 0.2, (6, 5, 3))
    return ssdr.Skinning(
        wave.vertices[0], indices, weights, transforms, faces=wave.faces, fps=30.0, name="arm"
    )


# --- a toy store of clips and networks trained on it, made once for all tests --------------------


@pytest.fixture(scope="session")
def toy_config():
    from garmentnet.configs.config import BoneOptions, load_config

    def make(preset="rooted", **train):
        c = load_config(preset)
        defaults = {
            "epochs": 50,
            "high_epochs": 12,
            "learning_rate": 3e-3,
            "window": 30,
            "threads": 1,
            "device": "cpu",
        }
        # The paper's high module; that of the preset has tests of its own.
        paper = {
            "kind": "vertices",
            "edge_features": (8, 8, 16),
            "batch_norm": False,
            "edge_dropout": 0.0,
            "collision": 0.1,
            "dropout": 0.0,
        }
        if preset == "faithful":
            paper = {}
        return dataclasses.replace(
            c,
            bones=BoneOptions(length=0.03, count=10, influences=4, effort="fast", frames=160),
            # The toy body has other joints.
            features=dataclasses.replace(c.features, joints=()),
            low=dataclasses.replace(c.low, hidden=64),
            high=dataclasses.replace(c.high, hidden=32, **paper),
            train=dataclasses.replace(c.train, **(defaults | train)),
        )

    return make


def _stored(folder, **sizes):
    from garmentnet.data.parameters import SimulationParameters as P
    from helpers import toy_store as toy

    others = [
        (P(0.2, 0.2, 1.0), "train"),
        (P(2.0, 0.2, 1.0), "train"),
        (P(0.5, 0.2, 0.7), "train"),
        (P(0.5, 0.2, 1.3), "train"),
        (P(0.8, 0.2, 0.9), "test"),
    ]
    return toy.make_store(folder / "store", others=others, **sizes)


@pytest.fixture(scope="session")
def toy_store(tmp_path_factory):
    return _stored(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="session")
def short_store(tmp_path_factory):
    """The same clips, fewer and shorter, for what does not depend on how well a network learns."""
    return _stored(tmp_path_factory.mktemp("short"), frames=40, train=3)


@pytest.fixture(scope="session")
def toy_bones(toy_store, toy_config):
    from garmentnet.paper.bones import virtual_bones

    return virtual_bones(toy_store, toy_config().bones)


@pytest.fixture(scope="session")
def toy_run(toy_store, toy_config, toy_bones, tmp_path_factory):
    """Folder of a finished run of the rooted configuration."""
    from garmentnet.paper.train import train

    folder = tmp_path_factory.mktemp("run")
    train(toy_store, toy_config(), folder)
    return folder


@pytest.fixture(scope="session")
def toy_network(toy_run):
    from garmentnet.networks.checkpoint import load_checkpoint

    return load_checkpoint(toy_run / "checkpoint.safetensors")


@pytest.fixture(scope="session")
def toy_faithful(toy_store, toy_config, toy_bones, tmp_path_factory):
    """A network of the faithful configuration, hardly trained."""
    from garmentnet.networks.checkpoint import load_checkpoint
    from garmentnet.paper.train import train

    folder = tmp_path_factory.mktemp("faithful")
    return load_checkpoint(
        train(toy_store, toy_config("faithful", epochs=2, high_epochs=1), folder)
    )


@pytest.fixture(scope="session")
def toy_basis(toy_store, toy_config, toy_bones, tmp_path_factory):
    """A network whose detail is a mixture of components."""
    from garmentnet.configs.config import HighOptions
    from garmentnet.networks.checkpoint import load_checkpoint
    from garmentnet.paper.train import train

    high = HighOptions(
        kind="basis", target="detail", hidden=32, rank=12, collision=0.0, dropout=0.1
    )
    config = dataclasses.replace(toy_config(epochs=6, high_epochs=35), high=high)
    return load_checkpoint(train(toy_store, config, tmp_path_factory.mktemp("basis")))
