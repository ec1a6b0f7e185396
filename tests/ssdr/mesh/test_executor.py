"""The same call on the workers of a Dask client: the same result, also when a worker dies."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.mesh import executor
from ssdr.search import scan

distributed = pytest.importorskip(
    "distributed", reason='needs Dask: pip install "ssdr[dask]"', exc_type=ImportError
)


# what event loops and processes that were killed on purpose leave behind
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes, which nobody starts again."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as made:
            yield made


@pytest.fixture
def client(cluster: Any) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.Client(cluster) as made:
            made.wait_for_workers(2, timeout=600)
            yield made


@pytest.fixture(autouse=True)
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "_IN_MEMORY", 1)
    monkeypatch.setattr(scan, "_FEWEST", 40)
    monkeypatch.setattr(scan, "_MOST", 40)
    monkeypatch.setattr(executor, "_SPANS", 8)


def solve(source: Any, **options: Any) -> ssdr.Decomposition:
    return ssdr.decompose(source, bones=4, effort="fast", **options)


def same(a: ssdr.Decomposition, b: ssdr.Decomposition) -> None:
    assert a.rmse == pytest.approx(b.rmse, rel=1e-9)
    np.testing.assert_array_equal(a.skinning.indices, b.skinning.indices)
    np.testing.assert_allclose(a.skinning.weights, b.skinning.weights, atol=1e-7)
    np.testing.assert_allclose(a.skinning.transforms, b.skinning.transforms, atol=1e-7)


def sources(frames: np.ndarray, folder: Path) -> dict[str, Any]:
    """Memory map (a slice of one), zarr and dask arrays of the same frames."""
    import dask.array

    np.save(folder / "frames.npy", np.concatenate([frames[:3] + 1, frames]))
    out = {
        "memmap": np.load(folder / "frames.npy", mmap_mode="r")[3:],
        "dask": dask.array.from_array(frames, chunks=(17, -1, -1)),
    }
    zarr = pytest.importorskip("zarr")
    array = zarr.create_array(folder / "z.zarr", shape=frames.shape, dtype="f8", chunks=(13, 50, 3))
    array[:] = frames
    return out | {"zarr": zarr.open(folder / "z.zarr", mode="r")}


def test_without_a_client_dask_and_zarr_are_read_here(tmp_path: Path) -> None:
    frames = motions.rippled()
    here = solve(frames)
    for source in sources(frames, tmp_path).values():
        assert isinstance(executor.executor_for([ssdr.MeshSequence(source)]), executor.Local)
        same(solve(source), here)


def test_workers_find_what_this_process_finds(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = motions.rippled()
    here = solve(frames)  # in memory: stays in this process, client or not
    assert isinstance(executor.executor_for([ssdr.MeshSequence(frames)]), executor.Local)
    monkeypatch.setattr(executor.Local, "map", None)  # whoever walks here, fails
    for source in sources(frames, tmp_path).values():
        assert isinstance(executor.executor_for([ssdr.MeshSequence(source)]), executor.Cluster)
        same(solve(source), here)
        if isinstance(source, np.memmap):
            cuts = itertools.pairwise([0, 2, 50, 51, 120])
            same(solve([ssdr.MeshSequence(source[a:b]) for a, b in cuts]), here)


def test_bad_frames_are_found_on_workers(client: Any) -> None:
    import dask.array

    frames = motions.rippled()
    frames[77, 5, 1] = np.nan
    with pytest.raises(ssdr.InputError, match="frame 77, vertex 5"):
        solve(dask.array.from_array(frames, chunks=(17, -1, -1)))
    unknown = dask.array.from_array(frames, chunks=(17, -1, -1))
    with pytest.raises(ssdr.InputError, match="compute_chunk_sizes"):
        solve(unknown[unknown[:, 0, 0] > -9])


def test_a_worker_is_killed_and_the_result_is_the_same(client: Any, tmp_path: Path) -> None:
    frames = motions.rippled()
    here = solve(frames)
    source = sources(frames, tmp_path)["memmap"]
    pids = client.run(os.getpid)
    killed: list[int] = []

    def kill(progress: Any) -> bool:
        if progress.phase == "all frames" and not killed:
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)
        return False

    same(solve(source, callback=kill), here)
    assert killed
    deadline = time.monotonic() + 600
    while killed[0] in client.run(os.getpid).values():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_dask_is_not_imported_by_itself() -> None:
    code = """
    import sys, numpy as np, ssdr
    ssdr.decompose(np.random.default_rng(0).normal(size=(4, 9, 3)), bones=2, effort="fast")
    assert not {"dask", "distributed", "zarr"} & set(sys.modules)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=True)
