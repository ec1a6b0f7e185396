"""Motion: poses between frames, BVH files and what becomes of them on another body."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.bvh import read_bvh
from benchmarks.garment.scenes.dataset import find_bvh
from benchmarks.garment.scenes.retarget import retarget
from ssdr.common.errors import FormatError, InputError

BODY = default_body()
TREE = BODY.skeleton
# A figure in a T-pose, centimetres, y up, facing z: joint, parent, position.
FIGURE = (
    ("Hips", "", (0, 90, 0)),
    ("Spine", "Hips", (0, 100, 0)),
    ("Chest", "Spine", (0, 120, 0)),
    ("Neck", "Chest", (0, 145, 0)),
    ("Head", "Neck", (0, 155, 0)),
    ("LeftShoulder", "Chest", (5, 138, 0)),
    ("LeftArm", "LeftShoulder", (18, 138, 0)),
    ("LeftForeArm", "LeftArm", (45, 138, 0)),
    ("LeftHand", "LeftForeArm", (70, 138, 0)),
    ("RightShoulder", "Chest", (-5, 138, 0)),
    ("RightArm", "RightShoulder", (-18, 138, 0)),
    ("RightForeArm", "RightArm", (-45, 138, 0)),
    ("RightHand", "RightForeArm", (-70, 138, 0)),
    ("LeftUpLeg", "Hips", (10, 88, 0)),
    ("LeftLeg", "LeftUpLeg", (10, 48, 0)),
    ("LeftFoot", "LeftLeg", (10, 8, 0)),
    ("RightUpLeg", "Hips", (-10, 88, 0)),
    ("RightLeg", "RightUpLeg", (-10, 48, 0)),
    ("RightFoot", "RightLeg", (-10, 8, 0)),
)


def write_bvh(
    root: np.ndarray,
    angles: dict[str, np.ndarray],
    *,
    turn: np.ndarray | None = None,
    scale: float = 1.0,
) -> str:
    """BVH text; `turn` writes the same figure in other axes. Angles are z, x, y in degrees."""
    frames = len(root)
    turn = np.eye(3) if turn is None else turn
    place = {n: turn @ np.array(p, float) * scale for n, _, p in FIGURE}
    lines, columns = ["HIERARCHY"], []

    def joint(name: str, parent: str, indent: str) -> None:
        offset = place[name] - (place[parent] if parent else 0)
        if not parent:
            offset = offset * 0
        lines.append(f"{indent}{'JOINT' if parent else 'ROOT'} {name}")
        lines.append(indent + "{")
        lines.append(indent + "  OFFSET " + " ".join(f"{v:.6f}" for v in offset))
        channels = "Zrotation Xrotation Yrotation"
        own = angles.get(name, np.zeros((frames, 3)))
        rotation = Rotation.from_euler("ZXY", own, degrees=True).as_matrix()
        turned = Rotation.from_matrix(turn @ rotation @ turn.T).as_euler("ZXY", degrees=True)
        if parent:
            lines.append(indent + f"  CHANNELS 3 {channels}")
        else:
            lines.append(indent + f"  CHANNELS 6 Xposition Yposition Zposition {channels}")
            columns.append(root @ turn.T * scale)
        columns.append(turned)
        children = [n for n, p, _ in FIGURE if p == name]
        for child in children:
            joint(child, name, indent + "  ")
        if not children:
            lines.extend([f"{indent}  End Site", indent + "  {", indent + "    OFFSET 0 1 0"])
            lines.append(indent + "  }")
        lines.append(indent + "}")

    joint("Hips", "", "")
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.008333333333333333"]
    table = np.concatenate(columns, axis=1)
    lines += [" ".join(f"{v:.9f}" for v in row) for row in table]
    return "\n".join(lines) + "\n"


def wave(frames: int = 41) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    t = np.linspace(0, 1, frames)
    root = np.stack([10 * t, 90 + 0 * t, 20 * t], axis=1)
    zero = 0 * t
    return root, {
        "Hips": np.stack([zero, zero, 90 * t], axis=1),
        "LeftArm": np.stack([-60 * t, zero, zero], axis=1),
        "RightUpLeg": np.stack([zero, -70 * t, zero], axis=1),
        "RightLeg": np.stack([zero, 50 * t, zero], axis=1),
    }


def read(tmp_path: Path, text: str | bytes, name: str = "a.bvh") -> Any:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_bvh(path)


def direction(joints: np.ndarray, a: str, b: str) -> np.ndarray:
    p = TREE.positions(joints)
    d = p[:, TREE.names.index(b)] - p[:, TREE.names.index(a)]
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_reads_what_was_written(tmp_path: Path) -> None:
    root, angles = wave()
    bvh = read(tmp_path, write_bvh(root, angles))
    assert bvh.names[0] == "Hips"
    assert len(bvh.names) == len(FIGURE)
    assert bvh.fps == pytest.approx(120)
    np.testing.assert_allclose(bvh.root, root, atol=1e-6)
    j = bvh.names.index("RightUpLeg")
    wanted = Rotation.from_euler("ZXY", angles["RightUpLeg"], degrees=True).as_matrix()
    np.testing.assert_allclose(bvh.rotations[:, j], wanted, atol=1e-6)
    np.testing.assert_allclose(bvh.offsets[j], [-10, -2, 0], atol=1e-6)


def test_limbs_point_where_they_did_and_the_root_scales_with_the_legs(tmp_path: Path) -> None:
    root, angles = wave()
    motion = retarget(read(tmp_path, write_bvh(root, angles)), TREE, fps=30)
    assert motion.n_frames == 11
    assert set(motion.classes.tolist()) == {8}
    # Forward kinematics by hand: the last frame faces x, the left arm hangs 60 degrees below
    # the horizontal, the right thigh is raised by 70 degrees.
    last = motion.joints[-1:]
    np.testing.assert_allclose(
        direction(last, "arm_l", "forearm_l")[0],
        [0, -np.sin(np.pi / 3), -np.cos(np.pi / 3)],
        atol=1e-5,
    )
    np.testing.assert_allclose(direction(last, "arm_r", "forearm_r")[0], [0, 0, 1], atol=1e-5)
    raised = np.radians(70)
    np.testing.assert_allclose(
        direction(last, "thigh_r", "shin_r")[0], [np.sin(raised), -np.cos(raised), 0], atol=1e-5
    )
    np.testing.assert_allclose(direction(last, "thigh_l", "shin_l")[0], [0, -1, 0], atol=1e-5)
    # The root's way scales with the legs.
    hips = TREE.positions(motion.joints)[:, 0]
    legs = sum(
        np.linalg.norm(TREE.rest[TREE.names.index(b)] - TREE.rest[TREE.names.index(a)])
        for a, b in (("thigh_l", "shin_l"), ("shin_l", "foot_l"))
    )
    np.testing.assert_allclose(hips[0, [0, 2]], 0, atol=1e-9)
    np.testing.assert_allclose(hips[-1, [0, 2]], np.array([10, 20]) * legs / 80, atol=1e-4)


@pytest.mark.parametrize(
    "turn",
    [
        np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),  # z up
        np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),  # facing away
        np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    ],
)
def test_axes_and_units_of_the_file_do_not_matter(tmp_path: Path, turn: np.ndarray) -> None:
    root, angles = wave()
    plain = retarget(read(tmp_path, write_bvh(root, angles)), TREE)
    other = retarget(read(tmp_path, write_bvh(root, angles, turn=turn, scale=0.393)), TREE)
    np.testing.assert_allclose(other.joints, plain.joints, atol=1e-5)


def test_a_pose_before_the_motion_is_left_out(tmp_path: Path) -> None:
    root, angles = wave()
    text = write_bvh(root, angles)
    strange = {n: np.concatenate([[[50.0, 20.0, 10.0]], a]) for n, a in angles.items()}
    with_pose = write_bvh(np.concatenate([[[0, 90, 0]], root]), strange)
    np.testing.assert_allclose(
        retarget(read(tmp_path, with_pose), TREE).joints,
        retarget(read(tmp_path, text), TREE).joints,
        atol=1e-6,
    )


def test_packed_files_and_folders(tmp_path: Path) -> None:
    root, angles = wave(5)
    text = write_bvh(root, angles)
    read(tmp_path, gzip.compress(text.encode()), "b.bvh.gz")
    read(tmp_path, text, "a.BVH")
    (tmp_path / "notes.txt").write_text("no")
    assert [p.name for p in find_bvh(tmp_path)] == ["a.BVH", "b.bvh.gz"]
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="folder with BVH"):
        find_bvh(tmp_path / "none")


GOOD = write_bvh(*wave(4))


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "HIERARCHY",
        GOOD[: len(GOOD) // 2],
        GOOD[:-30],
        GOOD.replace("HIERARCHY", "HIER"),
        GOOD.replace("Frames: 4", "Frames: 5"),
        GOOD.replace("Frames: 4", "Frames: 0"),
        GOOD.replace("Frames: 4", "Frames: 99999999999"),
        GOOD.replace("Frame Time: 0.0083", "Frame Time: -1 0"),
        GOOD.replace("Frame Time: 0.0083", "Frame Time: nan 0"),
        GOOD.replace("OFFSET", "OFFSET nan", 3),
        GOOD.replace("Zrotation", "Zspin"),
        GOOD.replace("CHANNELS 3 Zrotation", "CHANNELS 2"),
        GOOD.replace("JOINT Head", "ROOT Head"),
        GOOD.replace("End Site", "Start Site"),
        GOOD.rsplit(" ", 1)[0] + " nan\n",
        b"\x1f\x8b not gzip",
        b"\xff\xfe\x00",
    ],
)
def test_damaged_files_are_named(tmp_path: Path, damage: str | bytes) -> None:
    with pytest.raises(FormatError, match=r"a\.bvh"):
        read(tmp_path, damage)


def test_a_figure_without_legs(tmp_path: Path) -> None:
    text = GOOD.replace("LeftUpLeg", "Tail")
    with pytest.raises(InputError, match="thigh_l"):
        retarget(read(tmp_path, text), TREE)


def test_motion_capture_moves_the_body_upright_and_on_the_floor(data_dir: Path) -> None:
    folder = data_dir / "motion"
    if not folder.is_dir():
        pytest.skip(f"no motion capture at {folder}")
    for path in find_bvh(folder):
        motion = retarget(read_bvh(path), TREE)
        assert 500 < motion.n_frames < 700
        heads = TREE.positions(motion.joints)
        # Upright, on the floor, limbs as long as the body's, no jump between frames.
        up = heads[:, TREE.names.index("head"), 1] - heads[:, 0, 1]
        assert np.percentile(up, 5) > 0.3
        soles = heads[:, [TREE.names.index("foot_l"), TREE.names.index("foot_r")], 1].min(axis=1)
        assert soles.min() > -0.03
        assert np.median(soles) < 0.15
        step = np.linalg.norm(np.diff(heads, axis=0), axis=2).max() * motion.fps
        assert step < 14
