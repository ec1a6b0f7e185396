"""Forward skinning: this package beside a plain C loop, NumPy's einsum and SciPy's sparse product.

    python benchmarks/speed/skinning.py --out out/skinning

V = 12273, B = 80, K = 8, float32; one frame and many.  The C loop is compiled by the system's
compiler with -O3 -march=native and runs in one thread; errors are against float64.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

import ssdr

V, B, K = 12273, 80, 8
SOURCE = """
void skin(const float *restrict rest, const int *restrict joints, const float *restrict weights,
          const float *restrict transforms, float *restrict out, long F, long V, long B, long K) {
  for (long t = 0; t < F; t++)
    for (long i = 0; i < V; i++) {
      float x = rest[3*i], y = rest[3*i+1], z = rest[3*i+2], a = 0, b = 0, c = 0;
      for (long k = 0; k < K; k++) {
        const float *m = transforms + (t*B + joints[i*K+k])*12;
        float w = weights[i*K+k];
        a += w * (m[0]*x + m[1]*y + m[2]*z + m[3]);
        b += w * (m[4]*x + m[5]*y + m[6]*z + m[7]);
        c += w * (m[8]*x + m[9]*y + m[10]*z + m[11]);
      }
      float *o = out + 3*(t*V + i);
      o[0] = a; o[1] = b; o[2] = c;
    }
}
"""


def best_of(function: Callable[[], object], repeats: int) -> float:
    function()
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return best


def compile_c(folder: str) -> ctypes.CDLL | None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    source, library = Path(folder, "skin.c"), Path(folder, "skin.so")
    source.write_text(SOURCE)
    options = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *options, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library))


def with_torch() -> Any:
    try:
        import torch
    except ImportError:
        return None
    torch.set_num_threads(1)
    return torch


def measure(n_frames: int, c_loop: ctypes.CDLL | None) -> list[dict[str, float | int | str]]:
    rng = np.random.default_rng(0)
    rest = rng.normal(size=(V, 3)).astype(np.float32)
    indices = rng.integers(0, B, (V, K)).astype(np.int32)
    weights = rng.dirichlet(np.ones(K), V).astype(np.float32)
    transforms = rng.normal(size=(n_frames, B, 3, 4)).astype(np.float32)
    probe = slice(0, 1)
    truth = ssdr.skin(rest, indices, weights, transforms[probe], dtype=np.float64)
    homogeneous = np.c_[rest, np.ones(V, dtype=np.float32)]
    buffer = np.empty((n_frames, V, 3), dtype=np.float32)

    def with_c() -> np.ndarray:
        pointers = [
            a.ctypes.data_as(ctypes.c_void_p) for a in (rest, indices, weights, transforms, buffer)
        ]
        c_loop.skin(*pointers, *(ctypes.c_long(n) for n in (n_frames, V, B, K)))
        return buffer

    def with_ssdr(threads: int) -> np.ndarray:
        ssdr.set_threads(threads)
        return ssdr.skin(rest, indices, weights, transforms)

    def with_einsum() -> np.ndarray:
        for t in range(n_frames):
            blend = np.einsum("vk,vkxy->vxy", weights, transforms[t][indices])
            buffer[t] = np.einsum("vxy,vy->vx", blend, homogeneous)
        return buffer

    rows = np.repeat(np.arange(V), 4 * K)
    columns = (4 * indices[:, :, None] + np.arange(4)).ravel()
    values = (weights[:, :, None] * homogeneous[:, None, :]).ravel()
    basis = csr_array((values, (rows, columns)), shape=(V, 4 * B))

    def with_sparse() -> np.ndarray:
        step = 32
        for t in range(0, n_frames, step):
            part = transforms[t : t + step]
            flat = part.transpose(1, 3, 0, 2).reshape(4 * B, -1)
            buffer[t : t + step] = (basis @ flat).reshape(V, -1, 3).transpose(1, 0, 2)
        return buffer

    methods: dict[str, Callable[[], np.ndarray]] = {
        "ssdr, 1 thread": lambda: with_ssdr(1),
        "ssdr, 2 threads": lambda: with_ssdr(2),
        "NumPy einsum": with_einsum,
        "SciPy sparse (product alone)": with_sparse,
    }
    if (torch := with_torch()) is not None:
        place = [torch.from_numpy(a) for a in (indices.astype(np.int64), weights, homogeneous)]

        def blended() -> np.ndarray:
            j, w, p = place
            with torch.inference_mode():
                for t, m in enumerate(torch.from_numpy(transforms)):
                    blend = (w[:, :, None] * m.reshape(B, 12)[j]).sum(dim=1).reshape(V, 3, 4)
                    buffer[t] = torch.einsum("vxy,vy->vx", blend, p).numpy()
            return buffer

        methods["torch, 1 thread"] = blended
    if c_loop is not None:
        methods = {"C, 1 thread": with_c} | methods
    repeats = 200 if n_frames == 1 else 3
    table = []
    for name, method in methods.items():
        error = float(np.abs(method()[probe] - truth).max())
        table.append(
            {
                "method": name,
                "frames": n_frames,
                "max_error": error,
                "ms_per_frame": 1e3 * best_of(method, repeats) / n_frames,
            }
        )
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/skinning"))
    parser.add_argument("--frames", type=int, default=1000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        c_loop = compile_c(folder)
        table = measure(1, c_loop) + measure(arguments.frames, c_loop)
    out: Path = arguments.out
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_suffix(".json").write_text(json.dumps(table, indent=1) + "\n")
    for row in table:
        print(
            f"{row['frames']:5} frames  {row['method']:30} {row['ms_per_frame']:8.4f} ms a frame"
            f"  max error {row['max_error']:.1e}"
        )
    draw(table, out.with_suffix(".png"))


def draw(table: list[dict[str, float | int | str]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    counts = sorted({int(row["frames"]) for row in table})
    figure, axes = plt.subplots(1, len(counts), figsize=(10, 3), layout="constrained")
    for axis, count in zip(np.atleast_1d(axes), counts, strict=True):
        rows = [row for row in table if row["frames"] == count]
        bars = axis.barh([row["method"] for row in rows], [row["ms_per_frame"] for row in rows])
        axis.bar_label(bars, fmt="%.3f", padding=3, fontsize=8)
        axis.set(xscale="log", xlabel="ms a frame", title=f"{count} frame(s)")
        axis.invert_yaxis()
        axis.margins(x=0.2)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
