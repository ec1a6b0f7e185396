"""Do two revisions compute the same, to the last bit?

    python benchmarks/robustness/same_bits.py v0.1.0 HEAD
    python benchmarks/robustness/same_bits.py HEAD .          # the working tree, committed or not

Each revision is installed by pip into a folder of its own (no dependencies: those of this
Python serve both) and runs the same table of calls in a process of its own.  What is compared,
call by call, is a digest of the bytes of rest pose, joints, weights, transforms and of the
errors, iterations and phases of the history.  The exit code is 1 if any of them differs.

Both run on this machine: across machines bits may differ, because BLAS chooses its kernels by
the processor.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent
while not (ROOT / "pyproject.toml").exists():
    ROOT = ROOT.parent


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("before", nargs="?", default="HEAD", help="a revision, or a folder")
    parser.add_argument("after", nargs="?", default=".", help="a revision, or a folder")
    parser.add_argument("--only", default="", help="calls whose name holds this text")
    parser.add_argument("--keep", type=Path, help="a folder in which the installations stay")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker is not None:
        work(args.worker, args.only)
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        digests = [measured(rev, folder, args.only) for rev in (args.before, args.after)]
    return compare(*digests, names=(args.before, args.after))


def measured(revision: str, folder: Path, only: str) -> dict[str, Any]:
    """Install a revision and run the table of calls with it."""
    place, environment = installed(revision, folder)
    out = place / "digests.json"
    # -P: the folder of this script must not come before the installation
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--worker", str(out)]
    subprocess.run([*command, "--only", only], env=environment, check=True, cwd=folder)
    return dict(json.loads(out.read_text()))


def installed(revision: str, folder: Path) -> tuple[Path, dict[str, str]]:
    """The folder of a revision's installation, and the environment of a process that uses it."""
    place = folder / hashlib.sha256(revision.encode()).hexdigest()[:12]
    if not (place / "site" / "ssdr").is_dir() or Path(revision).is_dir():
        _install(revision, place)
    paths = {"PYTHONPATH": str(place / "site"), "NUMBA_CACHE_DIR": str(place / "numba")}
    return place, os.environ | paths


def _install(revision: str, place: Path) -> None:
    source = place / "source"
    for stale in (source, place / "site"):
        shutil.rmtree(stale, ignore_errors=True)
    source.mkdir(parents=True)
    if Path(revision).is_dir():
        names = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
        listed = subprocess.run(names, cwd=revision, check=True, capture_output=True).stdout
        present = [n for n in listed.decode().split("\0") if n and (Path(revision) / n).exists()]
        packed = ["tar", "-cf", "-", "-C", revision, "--null", "-T", "-"]
        archive = subprocess.run(
            packed, input="\0".join(present).encode(), check=True, capture_output=True
        ).stdout
    else:
        archive = subprocess.run(
            ["git", "archive", revision], cwd=ROOT, check=True, capture_output=True
        ).stdout
    subprocess.run(["tar", "-xf", "-", "-C", str(source)], input=archive, check=True)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    target = ["--no-deps", "--upgrade", "--target", str(place / "site"), str(source)]
    subprocess.run([*pip, *target], check=True)


def compare(before: dict[str, Any], after: dict[str, Any], *, names: tuple[str, str]) -> int:
    differ = 0
    for call in sorted(before.keys() | after.keys()):
        a, b = before.get(call), after.get(call)
        if a is None or b is None:
            differ += 1
            print(f"{call:44} only in {names[0] if b is None else names[1]}")
            continue
        fields = [f for f in a["digests"] if a["digests"][f] != b["digests"].get(f)]
        differ += bool(fields)
        word = "same" if not fields else "DIFFERS in " + ", ".join(fields)
        times = f"{a['cpu']:6.1f} {b['cpu']:6.1f} CPU s"
        print(f"{call:44} {word:12} rmse {a['rmse']:.6g} {b['rmse']:.6g}  {times}")
    print(f"{len(before)} calls, {differ} differ")
    return int(differ > 0)


# --- what one revision does ------------------------------------------------------------------


def work(out: Path, only: str) -> None:
    """Run every call and write its digests."""
    results: dict[str, Any] = {}
    for name, call in calls().items():
        if only not in name:
            continue
        began = time.process_time()
        value = call()
        cpu = time.process_time() - began
        arrays = digested(value)
        rmse = arrays.pop("rmse", np.nan)
        results[name] = {
            "digests": {k: hashlib.sha256(v).hexdigest() for k, v in arrays.items()},
            "rmse": float(rmse),
            "cpu": cpu,
        }
        print(f"  {name:44} {cpu:6.1f} CPU s", file=sys.stderr, flush=True)
    out.write_text(json.dumps(results, indent=1))


def digested(value: Any) -> dict[str, Any]:
    """The bytes that are compared, by name."""
    if hasattr(value, "history"):
        s, history = value.skinning, value.history
        arrays = digested(s)
        arrays["errors"] = np.array([r.rmse for r in history]).tobytes()
        arrays["steps"] = repr([(r.iteration, r.phase) for r in history]).encode()
        arrays["reason"] = repr((value.stop_reason, value.converged)).encode()
        if value.parsimony is not None:
            p = value.parsimony
            arrays["parsimony"] = repr(
                (p.error, p.held, p.bones, p.least_bones, p.size.total, len(p.attempts))
            ).encode()
        return arrays | {"rmse": value.rmse}
    fields = ("rest", "indices", "weights", "transforms", "keyframes", "bones", "bytes", "error")
    arrays = {}
    for name in (*fields, "squared_error"):
        part = getattr(value, name, None)
        if part is not None:
            arrays[name] = np.ascontiguousarray(part).tobytes()
    rmse = getattr(value, "rmse", np.nan)
    if np.ndim(rmse):
        arrays["rmses"], rmse = np.ascontiguousarray(rmse).tobytes(), rmse[-1]
    return arrays | {"rmse": rmse}


def calls() -> dict[str, Callable[[], Any]]:
    """Every call by name.  Only public names are used, for both revisions must have them."""
    import ssdr

    small = ssdr.load(ssdr.samples.path("dancer_small"))
    beam, faces = bending_beam(), beam_faces()
    sheet = flapping_sheet()
    chain = random_chain(5)
    ball = pulsing_ball()
    n = beam.shape[1]
    rng = np.random.default_rng(3)
    vertex_importance = rng.uniform(0.2, 2.0, n)
    frame_importance = rng.uniform(0.5, 2.0, len(beam))

    def run(*args: Any, **options: Any) -> Callable[[], Any]:
        return lambda: ssdr.decompose(*args, **options)

    table: dict[str, Callable[[], Any]] = {}
    for effort in ("fast", "balanced"):
        table[f"sample {effort}"] = run(small, bones=12, effort=effort)
    table["sample best, 60 steps"] = run(small, bones=8, effort="best", max_iterations=60)
    for effort in ("fast", "balanced", "best"):
        for model in ("rigid", "similarity", "affine"):
            table[f"beam {effort} {model}"] = run(
                beam, faces, bones=4, effort=effort, bone_model=model, max_iterations=250
            )
    table["beam best, whole"] = run(beam, bones=3, effort="best")
    table["chain best"] = run(chain, bones=5, effort="best")
    table["sheet best, many bones"] = run(sheet, bones=26, effort="best", max_iterations=80)
    table["sheet affine"] = run(sheet, bones=3, bone_model="affine")
    table["ball similarity"] = run(ball, bones=4, bone_model="similarity")
    table["ball affine"] = run(ball, bones=4, bone_model="affine")
    table["one bone"] = run(beam, bones=1)
    table["one influence"] = run(beam, bones=6, influences=1)
    table["eight influences"] = run(small, bones=12, influences=8, effort="fast")
    table["float32"] = run(beam.astype(np.float32), bones=4)
    table["another seed"] = run(small, bones=12, effort="fast", rng=7)
    several = [ssdr.MeshSequence(x) for x in (beam, beam[::-1] + 0.5, beam[::3])]
    table["several clips"] = run(several, bones=4)
    table["importances"] = run(
        beam, bones=4, vertex_importance=vertex_importance, frame_importance=frame_importance
    )
    for effort in ("fast", "balanced", "best"):
        table[f"smoothness {effort}"] = run(
            beam, faces, bones=4, smoothness=0.01, effort=effort, max_iterations=300
        )
    table["smoothness affine"] = run(beam, faces, bones=4, smoothness=0.01, bone_model="affine")
    table["rest given"] = run(beam, bones=4, rest=beam[0])
    table["rest frame"] = run(beam, bones=4, rest_frame=9)
    for name, extra in given_parts(beam).items():
        table[name] = run(beam, bones=4, **extra)
    table["stopped and resumed"] = lambda: resumed(beam, bones=4)
    table["stopped and resumed, best"] = lambda: resumed(small, bones=8, effort="best")
    table["tolerance"] = run(beam, tolerance="1%")
    table["tolerance fast"] = run(small, tolerance="0.5%", effort="fast")
    table["tolerance of the largest"] = run(beam, tolerance="2%", tolerance_of="max")
    table["tolerance affine"] = run(ball, tolerance="0.5%", bone_model="affine")
    table["tolerance, several clips"] = run(several[:2], tolerance="1%")
    table["tolerance resumed"] = lambda: resumed(beam, tolerance="0.3%", stop=40)
    long = np.concatenate([beam + 0.01 * k for k in range(12)])
    table["streamed fast"] = streamed(lambda: ssdr.decompose(long, bones=4, effort="fast"))
    table["streamed balanced"] = streamed(
        lambda: ssdr.decompose(
            [ssdr.MeshSequence(long), ssdr.MeshSequence(long[::2])],
            bones=4,
            frame_importance=np.ones(432),
        )
    )
    table["streamed smooth"] = streamed(
        lambda: ssdr.decompose(long, faces, bones=3, effort="fast", smoothness=0.01)
    )
    for stop in (45, 75):
        table[f"streamed, resumed after {stop}"] = streamed(
            lambda stop=stop: resumed(long, bones=4, effort="fast", stop=stop)
        )
    table["streamed tolerance"] = streamed(
        lambda: ssdr.decompose(long, tolerance="1%", effort="fast")
    )
    table["curve"] = lambda: ssdr.parsimony.curve(beam, bones=8)
    table["initialize"] = lambda: ssdr.initialize(small, bones=10, rng=1)
    start = ssdr.initialize(beam, bones=4)
    table["fit_weights"] = lambda: ssdr.fit_weights(
        beam, rest=start.rest, transforms=start.transforms
    )
    for model in ("rigid", "similarity", "affine"):
        table[f"fit_bones {model}"] = lambda model=model: ssdr.fit_bones(
            beam, rest=start.rest, indices=start.indices, weights=start.weights, bone_model=model
        )
    table["fit_rest_pose"] = lambda: ssdr.fit_rest_pose(
        beam, indices=start.indices, weights=start.weights, transforms=start.transforms
    )
    return table


def given_parts(beam: np.ndarray) -> dict[str, dict[str, Any]]:
    import ssdr

    s = ssdr.initialize(beam, bones=4)
    half = np.arange(beam.shape[1]) % 2 == 0
    skin = {"indices": s.indices, "weights": s.weights}
    return {
        "weights given": skin,
        "weights locked in part": skin | {"locked_vertices": half},
        "bones given": {"transforms": s.transforms},
        "two bones given": {"transforms": s.transforms[:, :2]},
        "bones locked in part": {"transforms": s.transforms, "locked_bones": [0, 2]},
        "all given": skin | {"transforms": s.transforms, "rest": s.rest},
    }


def resumed(sequence: Any, *, stop: int = 25, **options: Any) -> Any:
    """Stopped after so many steps, its state written and read, and gone on with."""
    import ssdr

    count = 0

    def callback(_: Any) -> bool:
        nonlocal count
        count += 1
        return count >= stop

    first = ssdr.decompose(sequence, callback=callback, **options)
    with tempfile.TemporaryDirectory() as folder:
        path = first.state.save(Path(folder) / "state.npz")
        limit = {"max_iterations": 120} if options.get("effort") == "best" else {}
        return ssdr.decompose(sequence, resume=path, **options, **limit)


def streamed(call: Callable[[], Any]) -> Callable[[], Any]:
    """The same call as if the frames did not fit into memory."""
    import importlib

    homes = ("ssdr.drivers.scan", "ssdr.streaming")
    small = {"_IN_MEMORY": 1000, "_SUBSET": 60_000, "_FEWEST": 20, "_SETTLED": 400_000}

    def inner() -> Any:
        for home in homes:
            try:
                module = importlib.import_module(home)
            except ImportError:
                continue
            if hasattr(module, "_IN_MEMORY"):
                break
        else:
            raise SystemExit("no module of this revision says what fits into memory")
        before = {name: getattr(module, name) for name in small}
        for name, value in small.items():
            setattr(module, name, value)
        try:
            return call()
        finally:
            for name, value in before.items():
                setattr(module, name, value)

    return inner


# --- small motions ---------------------------------------------------------------------------


def bending_beam(frames: int = 24) -> np.ndarray:
    """A bar of 4 × 4 × 13 vertices that bends, twists and swings."""
    x = np.linspace(0, 4, 13)
    y = z = np.linspace(-0.3, 0.3, 4)
    p = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    out = []
    for t in np.linspace(0, 2 * np.pi, frames):
        bend, twist = 0.4 * np.sin(t) * p[:, 0], 0.3 * np.cos(2 * t) * p[:, 0]
        y1 = np.cos(twist) * p[:, 1] - np.sin(twist) * p[:, 2]
        z1 = np.sin(twist) * p[:, 1] + np.cos(twist) * p[:, 2]
        q = np.stack(
            [
                p[:, 0] * np.cos(bend) - y1 * np.sin(bend),
                p[:, 0] * np.sin(bend) + y1 * np.cos(bend),
                z1,
            ],
            axis=1,
        )
        out.append(q + np.array([0, 0.2 * np.sin(3 * t), 0]))
    return np.array(out)


def beam_faces() -> np.ndarray:
    """Triangles on one side of the bar: enough for edges to be smooth along."""
    at = np.arange(13 * 16).reshape(13, 16)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    return np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )


def flapping_sheet() -> np.ndarray:
    u, v = np.meshgrid(np.linspace(-1, 1, 14), np.linspace(-1, 1, 14), indexing="ij")
    p = np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], axis=1)
    out = []
    for t in np.linspace(0, 2 * np.pi, 20):
        angle = 0.8 * np.sin(t) * np.abs(p[:, 0])
        side = np.sign(p[:, 0])
        r = np.abs(p[:, 0])
        wave = 0.05 * np.sin(4 * p[:, 1] + t)
        out.append(np.stack([side * r * np.cos(angle), p[:, 1], r * np.sin(angle) + wave], axis=1))
    return np.array(out)


def random_chain(bones: int) -> np.ndarray:
    """Exact linear blend skinning of a chain of bones."""
    rng = np.random.default_rng(11)
    x = np.sort(rng.uniform(0, bones, 40 * bones))
    p = np.stack([x, *(0.3 * rng.standard_normal((2, len(x))))], axis=1)
    out = []
    for t in np.linspace(0, 2 * np.pi, 18):
        m, parts = np.eye(4), []
        for b in range(bones):
            a = 0.5 * np.sin(t + b)
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
            turn[:2, 3] = np.array([b, 0]) - turn[:2, :2] @ [b, 0]
            m = m @ turn
            parts.append(m[:3].copy())
        w = np.maximum(0, 1 - np.abs(x[:, None] - np.arange(bones) - 0.5))
        w /= w.sum(axis=1, keepdims=True)
        h = np.c_[p, np.ones(len(p))]
        out.append(np.einsum("vb,bij,vj->vi", w, np.array(parts), h))
    return np.array(out)


def pulsing_ball() -> np.ndarray:
    rng = np.random.default_rng(5)
    p = rng.standard_normal((220, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    t = np.linspace(0, 2 * np.pi, 16)[:, None, None]
    stretch = np.concatenate([1 + 0.3 * np.sin(t), 1 - 0.2 * np.sin(t), 1 + 0 * t], axis=2)
    return p * stretch + np.concatenate([0 * t, np.cos(t), 0 * t], axis=2)


if __name__ == "__main__":
    sys.exit(main())
