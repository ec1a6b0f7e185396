"""Jobs that run in small steps: the decomposition, the page, the installation."""

import json
import shutil
import tempfile
import traceback
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import rig
from .process import AddonError, follow, installation, progress
from .sample import check, frame_kept, marked, sample

Steps = Generator[tuple[float, str], None, None]

# Folder with the files of each object that was made in this session, for its page.
folders: dict[str, Path] = {}


class Job:
    """Work in small steps; cancelling it undoes its changes to the scene and the disk.

    Attributes
    ----------
    fraction : float
        Part of the work that is done.
    text : str
        What is being done; at the end, the result in a sentence.
    warnings : list of str
    """

    def __init__(self) -> None:
        self.fraction, self.text = 0.0, "starting"
        self.warnings: list[str] = []
        self._steps = self.steps()

    def steps(self) -> Steps:
        """Do the work, and yield the fraction that is done and a text at each step."""
        raise NotImplementedError

    def step(self) -> bool:
        """Do the next step and return True, or return False if nothing is left to do.

        Raises
        ------
        AddonError
            If the step fails; the message is for the user.
        """
        try:
            self.fraction, self.text = next(self._steps)
        except StopIteration:
            return False
        except OSError as error:
            raise AddonError(f"{error.filename or 'Disk'}: {error.strerror or error}") from error
        except AddonError:
            raise
        except Exception as error:
            traceback.print_exc()
            raise AddonError(f"Unexpected {type(error).__name__}: {error}") from error
        return True

    def cancel(self) -> None:
        """End the work at once."""
        self._steps.close()


def _mapped(
    run: Generator[Any, None, Any], said: Callable[[Any], tuple[float, str]]
) -> Generator[tuple[float, str], None, Any]:
    """Run a generator: yield ``said(x)`` for each x that it yields, and return what it returns."""
    try:
        while True:
            yield said(next(run))
    except StopIteration as end:
        return end.value
    finally:
        run.close()


def _read(done: float) -> tuple[float, str]:
    return 0.2 * done, "reading the frames"


def _solved(line: str) -> tuple[float, str]:
    done, text = progress(line)
    return 0.2 + 0.7 * done, text


class Decompose(Job):
    """Job that gives an object an armature, which replaces its animation."""

    def __init__(self, context: Any, source: Any, options: Any, python: Path) -> None:
        check(source)
        if options.joints == "ARMATURE":
            armature = options.armature  # a script may set any object
            if armature is None:
                raise AddonError("Choose the armature whose bones to keep")
            if armature.type != "ARMATURE":
                kind = armature.type.lower()
                raise AddonError(f"Choose an armature: {armature.name} is of type {kind}")
        self.context, self.source = context, source
        self.options, self.python = options, str(python)
        self.clips = marked(context.scene) if options.clips else []
        self.taken: Any = None
        self.target: Any = None
        super().__init__()

    def steps(self) -> Steps:
        folder = Path(tempfile.mkdtemp(prefix="ssdr_", dir=bpy.app.tempdir))
        try:
            yield from self._steps_in(folder)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            if self.taken is not None and not self.taken.mesh.users:
                bpy.data.meshes.remove(self.taken.mesh)
            raise
        folders[self.target.name] = folder

    def _steps_in(self, folder: Path) -> Steps:
        try:
            for _ in follow([self.python, "-m", "ssdr", "--version"], folder):
                yield 0.0, "looking for ssdr"
        except AddonError as problem:
            raise AddonError(f"{self.python} has no ssdr that works: {problem}") from problem
        taken = self.taken = yield from _mapped(
            sample(self.context, self.source, self.clips), _read
        )
        files = taken.save(folder, self.context.scene.unit_settings.scale_length)
        if self.options.joints == "ARMATURE":
            with frame_kept(self.context.scene):
                self.context.scene.frame_set(taken.first)
                rig.save_skeleton(self.options.armature, taken.place, folder / "skeleton.npz")
        command = self._command(folder, files)
        said = json.loads((yield from _mapped(follow(command, folder), _solved)))
        self.warnings += said["warnings"]
        model = rig.read(folder / "model.npz")
        errors = None
        if self.options.color_error:
            squares = np.zeros(len(model["rest"]))
            for k, points in enumerate(taken.vertices):
                squares += np.square(rig.skin(model, k) - points).sum(axis=1)
                yield 0.9 + 0.1 * k / len(taken.vertices), "measuring the error"
            errors = np.sqrt(squares / len(taken.vertices))
        beside = self.options.place == "BESIDE"
        self.target = rig.build(self.context, self.source, taken, model, errors, beside=beside)
        result = (
            f"{said['bones']} bones, RMSE {said['rmse_percent']:.3g} % of the diagonal, largest "
            f"error {said['max_error_percent']:.3g} %"
        )
        held = said.get("parsimony", {}).get("held", True)
        yield 1.0, result if held else f"{result}; the tolerance is out of reach"

    def _command(self, folder: Path, files: list[str]) -> list[str]:
        options = self.options
        words = ["decompose", "--bones", str(options.bones)]
        if options.joints == "ARMATURE":
            words = ["decompose", "--rig", str(folder / "skeleton.npz")]
        elif options.size == "TOLERANCE":
            words = ["smallest", "--tolerance", f"{options.tolerance:g}%"]
            words += ["--measure", options.measure.lower()]
        if options.joints in ("LOOSE", "RIGID"):
            words += ["--rig", options.joints.lower()]
        words += ["--influences", str(options.influences), "--effort", options.effort.lower()]
        words += [*files, "-o", str(folder / "model.npz"), "--json"]
        return [self.python, "-m", "ssdr", "-vv", *words]


class ShowPage(Job):
    """Job that writes a web page with an object's bones next to the original animation."""

    def __init__(self, source: Any, python: Path) -> None:
        folder = folders.get(source.name) if source else None
        if folder is None or not folder.is_dir():
            raise AddonError("Select an object that was given bones since Blender was started")
        self.folder, self.name, self.python = folder, source.name, str(python)
        self.page = folder / "page.html"
        super().__init__()

    def steps(self) -> Steps:
        files = [str(self.folder / name) for name in ("model.npz", "input.npz")]
        words = [self.python, "-m", "ssdr", "view", *files, "-o", str(self.page)]
        for _ in follow([*words, "--up", "z", "--title", self.name, "--json"], self.folder):
            yield 0.5, "writing the page"
        yield 1.0, f"The page: {self.page}"


class Install(Job):
    """Job that makes a Python environment with ssdr in it."""

    def __init__(self, environment: Path, source: str, online: bool) -> None:
        if online and not bpy.app.online_access:
            raise AddonError(
                "Blender has no leave to go online: allow it in Preferences > System, or name a "
                "folder of wheels"
            )
        self.environment, self.online = environment, online
        self.commands = installation(environment, source, online)
        super().__init__()

    def steps(self) -> Steps:
        with tempfile.TemporaryDirectory(prefix="ssdr_", dir=bpy.app.tempdir) as folder:
            try:
                for number, words in enumerate(self.commands):
                    for _ in follow(words, Path(folder)):
                        yield number / len(self.commands), "installing ssdr (a few minutes)"
            except BaseException as error:
                shutil.rmtree(self.environment, ignore_errors=True)
                if isinstance(error, AddonError) and not self.online:
                    raise AddonError(
                        f"{error} (put the wheels of all that ssdr needs beside its own, or let "
                        "pip fetch them)"
                    ) from error
                raise
        yield 1.0, "ssdr is installed"
