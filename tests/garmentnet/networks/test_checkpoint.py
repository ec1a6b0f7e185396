import dataclasses
import json
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save as save_bytes

from garmentnet.data.outfit import Outfit
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.skeleton import Skeleton
from garmentnet.data.store import ClipStore
from garmentnet.io.tensors import load_arrays, save_arrays
from garmentnet.networks import checkpoint
from garmentnet.networks.checkpoint import (
    Checkpoint,
    load_checkpoint,
    load_weights,
    save_checkpoint,
    tensors_of,
)
from garmentnet.paper.ensemble import Kernel
from helpers import toy_store as toy
from ssdr.common.errors import FormatError, InputError


@pytest.fixture(scope="module")
def file(toy_run):
    return toy_run / "checkpoint.safetensors"


def altered(file, target, change):
    """The same tensors under a document that was tampered with."""
    arrays, document = load_arrays(file, "checkpoint")
    tensors = tensors_of(arrays, "")
    change(tensors, document)
    return save_arrays(target, tensors, "checkpoint", document)


def test_round_trip(file, toy_network, toy_store, tmp_path):
    again = save_checkpoint(toy_network, tmp_path / "again.safetensors")
    assert again.read_bytes() == file.read_bytes()
    assert again.stat().st_mode & 0o777 == (toy_store.path / "outfit.npz").stat().st_mode & 0o777
    assert str(toy_store.path.parent).encode() not in file.read_bytes()  # no path of this machine
    joints = toy_store.clip("base-test-1").joints[:15]
    assert np.array_equal(load_checkpoint(again).predict(joints), toy_network.predict(joints))
    assert toy_network.parameters == (toy.BASE,)
    toy_network.subject.check_fits(toy_store)


def test_half_precision(file, toy_network, toy_store, tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint, "_MANY", 1000)
    small = save_checkpoint(toy_network, tmp_path / "small.safetensors", half=True)
    assert small.stat().st_size < 0.6 * file.stat().st_size
    joints = toy_store.clip("base-test-1").joints
    gap = load_checkpoint(small).predict(joints) - toy_network.predict(joints)
    assert 0 < np.linalg.norm(gap, axis=-1).max() < 2e-3
    # Its bones are those of the store, rounded.
    load_weights(toy_network.networks[0], load_checkpoint(small), "low")


def test_the_dress_that_ships(tmp_path, monkeypatch):
    """It hangs from a body that stands still: edges as they were cut, the hem at the knee."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dress").mkdir()  # no checkpoint
    model = load_checkpoint("dress")
    still = np.tile(np.eye(3, 4), (60, model.subject.skeleton.n_joints, 1, 1))
    before, hanging = model.predict(still, SimulationParameters())[-2:]
    i, j = model.subject.garment.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    edges = np.linalg.norm(hanging[i] - hanging[j], axis=1)
    assert edges.min() > 0.015
    assert edges.max() < 0.045
    assert hanging[:, 1].min() == pytest.approx(0.4, abs=0.1)
    assert np.abs(hanging - before).max() < 1e-3


def test_ensemble_round_trip(toy_network, toy_store, tmp_path):
    network = toy_network.networks[0]
    other = SimulationParameters(bending=2.0)
    both = Checkpoint((network, network), (toy.BASE, other), Kernel())
    loaded = load_checkpoint(save_checkpoint(both, tmp_path / "e.safetensors"))
    theta = SimulationParameters(bending=1.0)
    assert loaded.kernel is not None
    assert np.array_equal(loaded.weights(theta), both.weights(theta))
    joints = toy_store.clip("base-test-1").joints[:5]
    assert np.array_equal(loaded.predict(joints, theta), both.predict(joints, theta))


def test_another_garment_or_skeleton(toy_network, tmp_path):
    (rest, faces, _), (wide, others, _) = toy.skirt(), toy.skirt(columns=18)
    rig, skeleton = toy.body()
    tall = Skeleton(skeleton.names, skeleton.parents, skeleton.rest * 1.1)
    given = {"rest": rest, "faces": faces, "body": rig, "skeleton": skeleton, "fps": toy.FPS}
    for text, change in (
        ("garment", {"rest": wide, "faces": others}),
        ("body", {"skeleton": tall}),
        ("fps", {"fps": 60.0}),
    ):
        other = ClipStore.create(tmp_path / text, Outfit(**(given | change)))
        with pytest.raises(InputError, match=text):
            toy_network.subject.check_fits(other)


def test_start_from_another_network(toy_network, toy_faithful):
    with pytest.raises(InputError, match="configuration"):
        load_weights(toy_faithful.networks[0], toy_network, "low")


def safetensors(**metadata):
    return save_bytes({"weight": torch.zeros(2)}, metadata or None)


def test_hostile_bytes(file, tmp_path):
    good, bad = file.read_bytes(), tmp_path / "bad.safetensors"
    for data, text in (
        (b"", ""),
        (b"\x00" * 64, ""),
        (good[:200], ""),
        (good[:-7], ""),
        (b"PK\x03\x04" + good, ""),
        (pickle.dumps({"format": "garmentnet"}), ""),
        (struct.pack("<Q", 1 << 60) + b"{}", ""),
        (safetensors(), "garmentnet"),
        (safetensors(garmentnet="{}"), "checkpoint"),
        # Its name and a weight damaged: no file without a checksum.
        (good[:-1].replace(b"sha256", b"sha257") + bytes([good[-1] ^ 1]), "sha257"),
    ):
        bad.write_bytes(data)
        with pytest.raises(FormatError, match=rf"bad\.safetensors.*{text}"):
            load_checkpoint(bad)
    assert good.count(b"sha256") == 1


def test_damage_is_seen_by_the_checksum(file, tmp_path, rng):
    """Bytes changed, blocks zeroed, moved or cut off: refused, or every number is what it was."""
    good, bad = file.read_bytes(), tmp_path / "bad.safetensors"
    known = load_arrays(file, "checkpoint")
    header = int.from_bytes(good[:8], "little")
    refused = 0
    for k in range(60):
        data = np.frombuffer(good, np.uint8).copy()
        at = int(rng.integers(0, header if k % 3 else len(data)))
        stop = at + int(rng.choice([1, 1, 16, 4096]))
        kind = k % 4
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at:stop] = 0
        elif kind == 2:
            data[at:stop] = np.roll(data, 16)[at:stop]
        else:
            data[at:stop] = rng.integers(0, 256, len(data[at:stop]))
        bad.write_bytes(data.tobytes())
        try:
            arrays, document = load_arrays(bad, "checkpoint")
        except FormatError:
            refused += 1
            continue
        assert document == known[1]
        assert all(np.array_equal(v, arrays[k]) for k, v in known[0].items())
    assert refused > 40


def test_a_file_without_a_checksum_is_refused(file, tmp_path):
    arrays, document = load_arrays(file, "checkpoint")
    old, text = tmp_path / "old.safetensors", json.dumps({"checkpoint": document})
    old.write_bytes(save_bytes(tensors_of(arrays, ""), {"garmentnet": text}))
    with pytest.raises(FormatError, match=r"old\.safetensors: it has no checksum"):
        load_checkpoint(old)


@pytest.mark.parametrize(
    "change",
    [
        lambda t, d: d.update(format="other"),
        lambda t, d: d.update(version=2),
        lambda t, d: d.pop("networks"),
        lambda t, d: d["networks"][0]["config"]["low"].update(hidden=10**9),
        lambda t, d: d["networks"][0]["config"]["high"].update(hidden=10**9),
        lambda t, d: d["networks"][0]["config"]["high"].update(global_features=10**9),
        lambda t, d: d["networks"][0]["config"]["high"].update(edge_features=[10**9]),
        lambda t, d: d["networks"][0]["config"]["low"].update(rotation="euler"),
        lambda t, d: d["networks"][0]["config"].update(surprise=1),
        lambda t, d: d["networks"][0].update(parameters={"bending": -1}),
        lambda t, d: d["networks"].append(d["networks"][0]),
        lambda t, d: d.update(kernel={"sizes": [3, 10**9, 4], "sigma": 1.0, "shape": "gaussian"}),
        lambda t, d: t.pop("network.0.low.out.bias"),
        lambda t, d: t.update({"garment.indices": t["garment.indices"] + 1000}),
        lambda t, d: t.update({"garment.rest": t["garment.rest"][:5]}),
        lambda t, d: t.update({"body.rest": t["body.rest"] + 1}),
        lambda t, d: t.update({"skeleton.parents": t["skeleton.parents"] * 0}),
        lambda t, d: t["network.0.low.out.bias"].fill_(float("nan")),
        lambda t, d: t["network.0.features.mean"].fill_(1e300),  # infinite in single precision
        lambda t, d: d.update(fps=float("nan")),
        lambda t, d: d.update(kernel=3),
        lambda t, d: t.update({"network.0.low.code.followed": torch.full((10,), 99)}),
        lambda t, d: t.update({"network.0.low.code.followed": torch.zeros(10)}),
        lambda t, d: t.update({"network.0.low.code.followed": torch.zeros(10, dtype=torch.uint8)}),
        lambda t, d: t.update({"network.0.low.code.followed": torch.zeros(9, dtype=torch.int64)}),
        lambda t, d: d["networks"][0].update(clamp=float("inf")),
        lambda t, d: t.update({"network.0.low.code.centres": torch.zeros(10**7, 3)}),
        lambda t, d: t.update({"network.0.features.mean": torch.zeros(3)}),
        lambda t, d: t["bound.index"][-1:].fill_(10**6),
        lambda t, d: t.update({"bound.rest": t["bound.rest"][:-1]}),
    ],
)
def test_contradictions(file, tmp_path, change):
    path = altered(file, tmp_path / "changed.safetensors", change)
    with pytest.raises(FormatError, match=r"changed\.safetensors"):
        load_checkpoint(path)


def test_full_disk_leaves_the_old_file(file, toy_network, tmp_path, monkeypatch):

    path = tmp_path / "kept.safetensors"
    save_checkpoint(toy_network, path)
    before = path.read_bytes()

    def full(name, data):
        with open(name, "wb") as f:
            f.write(data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"No space left.*kept\.safetensors"):
        save_checkpoint(dataclasses.replace(toy_network), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["kept.safetensors"]
