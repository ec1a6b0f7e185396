"""Error of a live garment against the time of a frame: detail components, widths, bits, pivots.

Every checkpoint is run frame by frame on the test dances of a store, with all its detail
components and with fewer; with ``--bits``, a single network also as an ONNX file of 32, 16 and 8
bits in onnxruntime.  A checkpoint and the store are given by name::

    python benchmarks/garment/live_error.py --bits --store out/dress.clips dress NARROWER PIVOTS ...

RMSE of all vertices and of their high frequencies (the creases) in mm, milliseconds a frame of one
thread, and megabytes of the weights that a frame reads.  ``--chart FILE`` draws one against the
other.  ``--parameters`` prints instead, of the first model, for every parameter set of the store
the depth of the creases, predicted and simulated, and the RMSE, on its test dances; ``--time`` its
RMSE in the first half of every second since the start of the test dances.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks import common
from benchmarks.garment.live import native
from ssdr.laplacian import LaplacianSmoother

RANKS = (0, 4, 8, 16, 32, 64)
LENGTH = 0.02  # m, of the split into low frequencies and creases


def with_rank(garment: Any, rank: int) -> Any:
    """The garment with its first components of the detail alone; 0: its mean detail."""

    def cut(pivot: Any) -> Any:
        high = dataclasses.replace(
            pivot.high, w_out=pivot.high.w_out[:rank].copy(), b_out=pivot.high.b_out[:rank]
        )
        return dataclasses.replace(pivot, high=high, basis=pivot.basis[: 1 + rank].copy())

    pivots = tuple(cut(p) for p in garment.pivots)
    return type(garment)(garment.subject, garment.features, pivots, garment.mixture)


class Exported:
    """A garment as an ONNX file in onnxruntime, one thread."""

    def __init__(self, garment: Any, bits: int, folder: Path) -> None:
        import onnxruntime

        from garmentnet.runtime.onnx_file import export_onnx

        self.subject, path = garment.subject, export_onnx(garment, folder / "a.onnx", bits=bits)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(path, options)
        self.names = [o.name for o in self.session.get_outputs()]
        self.inputs = {i.name: np.zeros(i.shape, np.float32) for i in self.session.get_inputs()}
        self.size = path.stat().st_size

    def step(self, state: dict[str, Any] | None, pose: Any, parameters: Any) -> Any:
        feed = self.inputs | (state or {})
        feed["pose"], feed["reset"] = pose.astype(np.float32), np.float32([state is None])
        if "parameters" in feed:
            feed["parameters"] = np.float32(dataclasses.astuple(parameters))
        out = dict(zip(self.names, self.session.run(self.names, feed), strict=True))
        vertices = out.pop("vertices")
        return {k.removesuffix("_out"): v for k, v in out.items()}, vertices


def run(garment: Any, clips: list[Any]) -> tuple[float, float, float]:
    """RMSE of the vertices and of their creases, mm; milliseconds a frame, the quickest clip."""
    rest = garment.subject.garment
    smoother = LaplacianSmoother(rest.rest, rest.faces, LENGTH)
    total, creases, count, times = 0.0, 0.0, 0, []
    for clip in clips:
        truth = clip.sequence.frames(slice(None))
        began = time.perf_counter()
        made = native(garment, clip.joints, clip.parameters)
        times.append(1e3 * (time.perf_counter() - began) / len(made))
        gap = made - truth
        total += float((gap**2).sum())
        creases += float(((gap - np.asarray(smoother.smooth(gap))) ** 2).sum())
        count += made.shape[0] * made.shape[1]
    rmse = [1e3 * (part / count) ** 0.5 for part in (total, creases)]
    return rmse[0], rmse[1], min(times)


def dances(store: Any) -> list[Any]:
    return [c for c in store.clips("test") if c.motion.startswith("dance-")]


def by_parameters(garment: Any, store: Any) -> list[common.Row]:
    """Depth of creases (RMS of the high frequencies, mm) and RMSE of every parameter set."""
    smoother = LaplacianSmoother(store.rest, store.faces, LENGTH)

    def depth(mesh: Any) -> float:
        return float(((mesh - np.asarray(smoother.smooth(mesh))) ** 2).sum(-1).mean())

    rows: list[common.Row] = []
    for parameters in store.parameters():
        sums = np.zeros(3)
        clips = [c for c in dances(store) if c.parameters == parameters]
        for clip in clips:
            truth = clip.sequence.frames(slice(None))
            made = native(garment, clip.joints, parameters)
            gap = float(((made - truth) ** 2).sum(-1).mean())
            sums += np.array([gap, depth(made), depth(truth)]) / len(clips)
        names = ("rmse_mm", "creases_mm", "simulated_mm")
        rows.append(
            {"parameters": str(parameters)} | dict(zip(names, 1e3 * sums**0.5, strict=True))
        )
    return rows


def by_time(garment: Any, clips: list[Any]) -> list[float]:
    """RMSE, mm, over the first half of every second of the clips."""
    gaps = [native(garment, c.joints, c.parameters) - c.sequence.frames(slice(None)) for c in clips]
    squares = [(gap**2).sum(-1).mean(-1) for gap in gaps]
    second = round(garment.subject.fps)
    starts = range(0, max(map(len, squares)), second)
    parts = [np.concatenate([q[t : t + second // 2] for q in squares]) for t in starts]
    return [1e3 * float(part.mean()) ** 0.5 for part in parts]


def megabytes(garment: Any) -> float:
    """Of the weights and the basis that a frame reads."""
    arrays = [a for p in garment.pivots for a in (*vars(p.low).values(), p.basis)]
    arrays += [a for p in garment.pivots if p.high for a in vars(p.high).values()]
    return sum(a.nbytes for a in arrays if a is not None) / 1e6


def chart(rows: list[common.Row], path: Path) -> None:
    plt = common.pyplot()
    figure, axis = plt.subplots(figsize=(6.5, 4))
    for name in dict.fromkeys(r["model"] for r in rows):
        some = [r for r in rows if r["model"] == name]
        axis.plot([r["ms"] for r in some], [r["rmse_mm"] for r in some], "o-", label=name)
        for r in some:
            axis.annotate(
                r["point"], (r["ms"], r["rmse_mm"]), xytext=(3, 4), textcoords="offset points"
            )
    axis.set(xlabel="ms a frame, one thread", ylabel="RMSE on unseen dances, mm")
    axis.legend(title="beside the points: components, bits")
    common.save_figure(figure, path)


def main() -> None:
    from garmentnet.data.store import ClipStore
    from garmentnet.runtime import load_live

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="+")
    parser.add_argument("--store", required=True)
    parser.add_argument("--clips", type=int, default=24)
    parser.add_argument("--bits", action="store_true")
    parser.add_argument("--chart", type=Path)
    parser.add_argument("--parameters", action="store_true")
    parser.add_argument("--time", action="store_true")
    args = parser.parse_args()
    store = ClipStore.open(args.store)
    base = store.parameters()[0]
    clips = [c for c in dances(store) if c.parameters == base][: args.clips]
    if args.parameters:
        found = by_parameters(load_live(args.models[0]), store)
        print(common.table(found, ["parameters", "rmse_mm", "creases_mm", "simulated_mm"]))
        return
    if args.time:
        print(" ".join(f"{e:.1f}" for e in by_time(load_live(args.models[0]), clips)))
        return
    rows: list[common.Row] = []

    def measure(model: str, point: str, garment: Any, size: float) -> None:
        run(garment, clips[:1])
        error, creases, ms = run(garment, clips)
        row = {"model": model, "point": point, "rmse_mm": error, "ms": ms}
        rows.append(row | {"creases_mm": creases, "MB": size})

    for model in args.models:
        whole, name = load_live(model), Path(model).stem
        most = 0 if whole.pivots[0].basis is None else len(whole.pivots[0].basis) - 1
        for rank in [r for r in RANKS if r < most] + [most]:
            garment = with_rank(whole, rank) if rank < most else whole
            measure(name, str(rank), garment, megabytes(garment))
        if args.bits and len(whole.pivots) == 1:
            with tempfile.TemporaryDirectory() as folder:
                for bits in (32, 16, 8):
                    file = Exported(whole, bits, Path(folder))
                    measure(f"{name}, ONNX", f"{bits} bits", file, file.size / 1e6)
    print(common.tell(common.machine()))
    print(common.table(rows, ["model", "point", "rmse_mm", "creases_mm", "ms", "MB"]))
    if args.chart:
        chart(rows, args.chart)


if __name__ == "__main__":
    main()
