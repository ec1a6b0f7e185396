"""Output of a command: results on stdout (table or JSON), warnings and progress on stderr."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from rich.filesize import decimal

from ..mesh.clips import Clip

Rows = Iterable[tuple[str, str]]
Show = Callable[[str, float, str], None]


@dataclasses.dataclass(kw_only=True)
class Output:
    """Printer of the results and warnings of one command.

    Attributes
    ----------
    json, quiet : bool
        Whether the result is printed as JSON, and whether nothing is printed.
    program : str
    warnings : list of str
        All warnings so far, for the JSON object.
    printed : bool
        Whether a result has been printed.
    current : Output
        Output of the command that is running.
    """

    json: bool = False
    quiet: bool = False
    program: str = "ssdr"
    warnings: list[str] = dataclasses.field(default_factory=list)
    printed: bool = False
    current: ClassVar[Output]

    def waiting(self, text: str) -> contextlib.AbstractContextManager[Any]:
        """Context that shows `text` on a terminal while its block runs."""
        if not self._live:
            return contextlib.nullcontext()
        from rich.console import Console
        from rich.text import Text

        return Console(file=sys.stderr).status(Text(text))

    def progress_bar(self) -> contextlib.AbstractContextManager[Show]:
        """Context that shows a progress bar on a terminal while its block runs."""
        return progress_bar() if self._live else contextlib.nullcontext(lambda *_: None)

    @property
    def _live(self) -> bool:
        return sys.stderr.isatty() and not (self.json or self.quiet)

    def warn(self, message: Warning | str, *_: Any, **__: Any) -> None:
        """Print a warning on stderr and add it to `warnings`; replaces ``warnings.showwarning``."""
        text = " ".join(str(message).split())
        self.warnings.append(text)
        sys.stderr.write(f"{self.program}: warning: {text}\n")

    def result(self, document: Mapping[str, Any], rows: Rows | str) -> None:
        """Print the result: with ``--json`` the `document`, otherwise `rows` (a table or a text).

        Raises
        ------
        BrokenPipeError
            If the reader of stdout has gone and no file was written.
        OSError
            If stdout cannot be written.
        """
        if self.json:
            text = json.dumps({**_plain(document), "warnings": self.warnings}, allow_nan=False)
        else:
            text = rows if isinstance(rows, str) else _table(rows)
        self.printed = True
        try:
            if self.json or not self.quiet:
                self.write(text + "\n")
        except BrokenPipeError:
            if not {"output", "outputs"} & document.keys():
                raise

    def write(self, text: str) -> None:
        """Write a text to stdout; an OSError names "standard output" as the file."""
        try:
            sys.stdout.write(text)
            sys.stdout.flush()
        except OSError as error:
            raise OSError(error.errno, error.strerror, "standard output") from error


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """Show a progress bar on stderr while the block runs.

    Yields
    ------
    callable
        Function that updates the bar with the name of the phase, the fraction of the work that is
        done, and a text.
    """
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = *Progress.get_default_columns(), TextColumn("{task.fields[text]}")
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("preparing", total=1.0, text="")
        yield lambda phase, fraction, text: bar.update(
            task, description=phase, completed=fraction, text=text
        )


def in_words(document: Mapping[str, Any], texts: Mapping[str, str]) -> list[tuple[str, str]]:
    """Rows of a table: each name of `texts`, and its text filled with values of the document."""

    def words(value: Any) -> Any:
        if isinstance(value, bool):
            return "yes" if value else "no"
        return (", ".join(map(str, value)) or "none") if isinstance(value, list) else value

    said = {name: words(value) for name, value in document.items()}
    return [(name, text.format_map(said)) for name, text in texts.items()]


def saved_line(report: Any, diagonal: float = 0.0, least: float = 0.0) -> str:
    """Line of text on a written file or page, with errors also in percent of a diagonal > 0.

    Errors up to `least` are left out.
    """
    parts = [str(report.path), decimal(report.bytes)]
    for name, field in (("error of storage", "error"), ("between frames", "between_frames")):
        length = getattr(report, field, None)
        if length and length > least:
            share = f" ({100 * length / diagonal:.3g} %)" if diagonal else ""
            parts.append(f"{name} {length:.4g}{share}")
    return ", ".join([*parts, *report.notes])


def clips_document(clips: Sequence[Clip]) -> list[dict[str, Any]]:
    """Clips as dicts for JSON."""
    return [
        {**dataclasses.asdict(clip), "frames": clip.n_frames, "duration": clip.n_frames / clip.fps}
        for clip in clips
    ]


def clips_text(clips: Sequence[Clip]) -> str:
    """Names, frame counts and frame rates of clips in one line."""
    return ", ".join(f"{c.name or 'unnamed'} ({c.n_frames} at {c.fps:g} a second)" for c in clips)


def _table(rows: Rows) -> str:
    """Text with a line for each name and value; names without a value are left out."""
    shown = [(name, value) for name, value in rows if value]
    width = max(len(name) for name, _ in shown)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in shown)


def _plain(value: Any) -> Any:
    """Copy of a value in the types that JSON has; NaN and infinity become None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _plain(vars(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
