"""Point caches: PC2 and MDD."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import ssdr
from ssdr import FormatError, MeshSequence


def test_point_caches_follow_their_layouts(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.pc2")
    data = (tmp_path / "a.pc2").read_bytes()
    assert data[:12] == b"POINTCACHE2\0"
    assert struct.unpack("<iiffi", data[12:32]) == (1, 12, 0.0, 1.0, 4)
    assert data[32:] == wave.vertices.astype("<f4").tobytes()
    ssdr.save(wave, tmp_path / "a.mdd")
    data = (tmp_path / "a.mdd").read_bytes()
    assert struct.unpack(">ii4f", data[:24]) == (4, 12, *np.float32([0, 0.04, 0.08, 0.12]).tolist())
    assert data[24:] == wave.vertices.astype(">f4").tobytes()


@pytest.mark.parametrize("fps", [12.5, 23.976, 24, 29.97, 60, 120])
def test_mdd_times_carry_the_rate(tmp_path, fps):
    sequence = MeshSequence(np.zeros((500, 1, 3)), None, fps)
    ssdr.save(sequence, tmp_path / "a.mdd")
    assert ssdr.load(tmp_path / "a.mdd", faces="none").fps == pytest.approx(fps, abs=1e-3)
    assert ssdr.load(tmp_path / "a.mdd", faces="none", fps=7).fps == 7


def test_uneven_mdd_times_are_told(tmp_path):
    for times in ((0.0, 0.04, 0.2), (0.0, 0.2, 0.1)):
        (tmp_path / f"{times[2]}.mdd").write_bytes(struct.pack(">ii3f", 3, 1, *times) + bytes(36))
    said = "uneven times, 0.04 to 0.16 s apart, are taken as even: .* up to 0.06 s from"
    with pytest.warns(ssdr.SsdrWarning, match=said):
        assert ssdr.load(tmp_path / "0.2.mdd", faces="none").fps == 10
    with pytest.raises(FormatError, match="not increasing"):
        ssdr.load(tmp_path / "0.1.mdd", faces="none")


def test_frames_per_sample_of_a_pc2(tmp_path, wave):
    ssdr.save(wave, tmp_path / "a.pc2")
    data = bytearray((tmp_path / "a.pc2").read_bytes())
    for step, fps in ((0.5, 50), (2.0, 12.5), (0.0, 25), (float("nan"), 25)):
        data[24:28] = struct.pack("<f", step)
        (tmp_path / "b.pc2").write_bytes(data)
        assert ssdr.load(tmp_path / "b.pc2", faces=wave).fps == fps
        assert ssdr.load(tmp_path / "b.pc2", faces=wave, fps=7).fps == 7
