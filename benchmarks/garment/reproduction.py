"""Data sets, trainings and scores of the paper's tables, each of which is made once and kept."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.garment.intervals import intervals
from benchmarks.garment.published import BASELINES
from benchmarks.garment.regression import Variant, train_regression
from garmentnet.configs.config import Config, load_config, override
from garmentnet.data.clip import Clip
from garmentnet.data.parameters import SimulationParameters
from garmentnet.data.store import ClipStore
from garmentnet.data.subject import Subject
from garmentnet.evaluation.baselines import MeanShape
from garmentnet.evaluation.methods import BonesThemselves, Chaos, Method, Network
from garmentnet.evaluation.scores import evaluate
from garmentnet.io.files import Progress, silent
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint
from garmentnet.paper.bones import VirtualBones, virtual_bones
from garmentnet.paper.train import choose_clips, train, with_mirrored
from ssdr.io.atomic import write_bytes

# A few dances are enough to find the bones, so that these stay the same while a data set grows.
_FEW = "bones.motions=dance-20[01]*"
# Beginning of the names of the motions on which methods are tested.
_TESTED = "dance-"


class Reproduction:
    """Reproduction of the paper's tables, with data sets, trainings and results in two folders.

    Parameters
    ----------
    data : path
        Folder of the stores ``<preset>.clips``, in which missing clips are simulated.
    folder : path
        Folder for trainings, tables and ``hours.json``.
    simulate : callable, optional
        Makes the store of a preset, from its name and path.
    settings : sequence of str
        Changes of every configuration, such as ``train.epochs=2``.
    progress : callable, optional
        Called with a description and the fraction that is done.
    """

    def __init__(
        self,
        data: Path | str,
        folder: Path | str,
        *,
        simulate: Callable[[str, Path], Any] | None = None,
        settings: Sequence[str] = (),
        progress: Progress = silent,
    ) -> None:
        self.simulate = simulate or (lambda name, path: None)
        self.data, self.folder = Path(data), Path(folder)
        self.settings, self.progress = tuple(settings), progress
        self._stores: dict[str, ClipStore] = {}
        self.folder.mkdir(parents=True, exist_ok=True)

    def store(self, name: str) -> ClipStore:
        """The store of a preset; clips that it lacks are simulated first."""
        if name not in self._stores:
            path = self.data / f"{name}.clips"
            self.timed(f"{name}/simulation", lambda: self.simulate(name, path))
            self._stores[name] = ClipStore.open(path)
        return self._stores[name]

    def config(self, preset: str, *changes: str) -> Config:
        return override(load_config(preset), [_FEW, *changes, *self.settings])

    def bones(self, store: str, config: Config, subject: Subject | None = None) -> VirtualBones:
        clips, show = self.store(store), self.progress
        return virtual_bones(clips, config.bones, subject=subject, progress=show)

    def network(
        self, store: str, label: str, config: Config, start: Checkpoint | None = None
    ) -> Checkpoint:
        """A trained network; it is only read if its training is finished."""
        folder = self.folder / store / label
        if not (folder / "history.json").is_file():
            clips, done = self.store(store), self.epoch(label)
            self.timed(
                f"{store}/{label}", lambda: train(clips, config, folder, start=start, progress=done)
            )
        return load_checkpoint(folder / "checkpoint.safetensors")

    def method(self, store: str, name: str, config: Config) -> Callable[[], Method]:
        """Function that returns a network as a method, and trains it first if necessary."""
        return lambda: Network(name, self.network(store, name, config))

    def clips(self, store: str, config: Config) -> tuple[list[str], list[str], list[str]]:
        """Names of the clips for training, with mirrored ones, for validation and for testing."""
        clips = self.store(store)
        names, base = choose_clips(clips, config)
        held, _ = choose_clips(clips, config, "validation")
        test = [c.name for c in dances_for_testing(clips, base)]
        return with_mirrored(clips, config, names), held, test

    def scores(
        self,
        store: str,
        key: str,
        config: Config,
        methods: Iterable[Callable[[], Method]],
        test: Sequence[str] | None = None,
        subject: Subject | None = None,
    ) -> dict[str, Any]:
        """Scores of methods on the test dances or named clips, with ratios to the first method.

        Bones are those of `subject` or, without it, of the configuration.  The last rows are the
        mean shape, the bones themselves and, where clips have a repetition from a perturbed first
        frame, the chaos of the cloth in these.
        """
        file = self.folder / store / f"{key}.json"
        if not file.is_file():
            bones = self.bones(store, config, subject)
            test = self.clips(store, config)[2] if test is None else test
            clips = bones.store
            learned = choose_clips(clips, config, "train", base_parameters(clips))[0]
            plain = MeanShape(bones, learned), BonesThemselves()
            made, chaos = [*(make() for make in methods), *plain], Chaos(clips)
            rows = evaluate(bones, made, test, progress=self.progress)
            record = {"rows": rows, "ratios": intervals(rows, rows[0].name)}
            if twins := [n for n in test if n in chaos.twins]:
                record["rows"] += evaluate(bones, [chaos], twins, progress=self.progress)
            pooled = (dataclasses.replace(r, clips=()) for r in record["rows"])
            record["rows"] = [dataclasses.asdict(r) for r in pooled]
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(file, json.dumps(record, indent=1).encode())
        return dict(json.loads(file.read_text("utf-8")))

    def baselines(
        self,
        store: str,
        config: Config,
        variants: Sequence[Variant] = BASELINES,
        suffix: str = "",
    ) -> list[Callable[[], Method]]:
        """Functions that return the published baselines, and train them first if necessary."""
        learned, held, _ = self.clips(store, config)

        def made(variant: Variant) -> Callable[[], Method]:
            label = variant.name.lower().replace(", ", "-").replace(" ", "-") + suffix
            folder = self.folder / store / label

            def trained() -> Method:
                bones, done = self.bones(store, config), self.epoch(variant.name)
                return train_regression(
                    variant, bones, config, learned, held, folder, progress=done
                )

            return lambda: self.timed(f"{store}/{label}", trained)

        return [made(v) for v in variants]

    def epoch(self, label: str) -> Progress:
        """Progress of one training among several."""
        return lambda text, fraction: self.progress(f"{label}: {text}", fraction)

    def timed(self, name: str, work: Callable[[], Any]) -> Any:
        """Call `work`, add its time to ``hours.json``, and return its result."""
        began, cpu = time.perf_counter(), time.process_time()
        try:
            return work()
        finally:
            file = self.folder / "hours.json"
            hours = json.loads(file.read_text("utf-8")) if file.is_file() else {}
            wall, used = hours.get(name, (0.0, 0.0))
            wall += (time.perf_counter() - began) / 3600
            used += (time.process_time() - cpu) / 3600
            write_bytes(file, json.dumps(hours | {name: (wall, used)}, indent=1).encode())


def base_parameters(store: ClipStore) -> SimulationParameters | None:
    """The base parameters of a data set."""
    clips, key = store.clips(), "parameter_set"
    return next((c.parameters for c in clips if c.provenance.get(key) == "base"), None)


def dances_for_testing(
    store: ClipStore, parameters: SimulationParameters | None = None
) -> list[Clip]:
    """Clips of the dances on which methods are tested, at all parameters by default."""
    return [c for c in store.clips("test", parameters) if c.motion.startswith(_TESTED)]
