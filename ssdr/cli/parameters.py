"""Arguments and options of a command, made from the signatures and docstrings of functions.

A command is a function. Its own parameters come first, those without a default that are not
keyword-only as arguments. Where it takes ``**options``, the keyword arguments of the functions
that it is said to pass them to (:func:`passes`) are its options, too, and are given to it only if
the user chose another value than the default.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import re
import types
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ..common.errors import InputError
from .output import Output

_SHORT = {
    "output": "-o",
    "bones": "-b",
    "influences": "-k",
    "effort": "-e",
    "reference": "-r",
    "styles": "-s",
    "quiet": "-q",
}
# Above all others in the help; these stand under "More".
_FIRST = (
    *("output", "tolerance", "measure", "bones", "influences", "effort", "bone_model", "rig"),
    *("start", "reference", "frames", "frame", "styles", "bake", "clip"),
    *("json", "quiet"),
)
_FLAGS = {"rng": "--seed"}
_ALL = {
    "json": "Print one JSON object and nothing else.",
    "quiet": "No progress and no table.",
}
_METAVARS = {Path: "FILE", list[Path]: "FILE", list[str]: "NAME", int: "N", float: "X", bool: " "}
# Arguments that only Python can give, or nobody from a shell.
_PYTHONS = (
    *("callback", "vertex_importance", "frame_importance"),
    *("mmap", "clip_names"),
)
_KINDS = (bool, Path, str, int, float)  # of several that a parameter takes, the first of these


def passes(
    *functions: Callable[..., Any], without: Sequence[str] = (), words: Any = ()
) -> Callable[..., Any]:
    """Decorator that says to which functions a command passes its ``**options``.

    Where their docstrings point to that of another function, `words` has it.
    """

    def mark(function: Any) -> Any:
        function.passes = functions, {*without, *_PYTHONS}, words
        return function

    return mark


def command(function: Any) -> Callable[..., None]:
    """The command of typer that calls a function."""
    functions, without, words = getattr(function, "passes", ((), set(), ()))
    found: dict[str, inspect.Parameter] = {}
    for source in (function, *functions):
        hints = typing.get_type_hints(source)
        for p in inspect.signature(source).parameters.values():
            own = source is function and p.kind is not p.VAR_KEYWORD
            passed = p.kind is p.KEYWORD_ONLY and p.name not in without
            if (own or passed) and p.name not in found:
                text = _help((source, *functions, *words), p.name)
                found[p.name] = _parameter(p, hints[p.name], text)
    kept = found.keys() & inspect.signature(function).parameters.keys()
    for name, text in _ALL.items():
        p = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False)
        found[name] = _parameter(p, bool, text)

    @functools.wraps(function)
    def call(**given: Any) -> None:
        output = Output.current
        output.json, output.quiet = given.pop("json"), given.pop("quiet")
        try:
            function(**{k: v for k, v in given.items() if k in kept or v != found[k].default})
        except InputError as error:
            name = re.split(r"[.\[]", error.argument)[0]
            if name not in found or _is_argument(found[name]):
                raise
            raise InputError(_flag(name), error.expected, error.got) from error

    def place(name: str) -> tuple[bool, int]:
        """Sorting key: arguments, then the first options, then others as they were found."""
        ranks = {name: rank for rank, name in enumerate(_FIRST)}
        return (True, ranks.get(name, len(ranks))) if not _is_argument(found[name]) else (False, 0)

    order = sorted(found, key=place)
    call.__doc__ = (inspect.getdoc(function) or "").partition("\n\nParameters\n")[0]
    call.__annotations__ = {name: found[name].annotation for name in order}
    call.__signature__ = inspect.Signature([found[name] for name in order])  # type: ignore[attr-defined]
    return call


def _parameter(p: inspect.Parameter, hint: Any, text: str) -> inspect.Parameter:
    """Parameter of a command of typer, with its type, its flags and its help."""
    kind, optional = _kind(hint)
    if p.kind is p.POSITIONAL_OR_KEYWORD:
        info = typer.Argument(help=text, metavar=p.name.upper())
    else:
        flags = [_flag(p.name)]
        flags += [_SHORT[p.name]] if p.name in _SHORT else []
        if kind is bool and (p.default is not False):
            flags[0] += "/--no-" + flags[0][2:]
        # the frames of a picture come first, those to read of a file do not
        first = p.name in _FIRST and not (p.name == "frames" and p.default is None)
        panel = None if first else "More"
        metavar = p.name.upper() if kind is str else _METAVARS.get(kind)
        info = typer.Option(*flags, help=text, rich_help_panel=panel, metavar=metavar)
        if kind is _flag_number_or_text:
            kind, info.parser, info.metavar = str, kind, "TEXT"
    annotation: Any = Annotated[kind | None if optional else kind, info]
    return p.replace(kind=p.KEYWORD_ONLY, annotation=annotation)


def _flag(name: str) -> str:
    return _FLAGS.get(name, "--" + name.replace("_", "-"))


def _is_argument(p: inspect.Parameter) -> bool:
    return isinstance(p.annotation.__metadata__[0], typer.models.ArgumentInfo)


def _kind(hint: Any) -> tuple[Any, bool]:
    """Type that the command line knows of a hint, and whether None is allowed as well.

    What is neither a text nor a number, such as a model, is given as a file.
    """
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    kinds = list(typing.get_args(hint)) if union else [hint]
    optional = type(None) in kinds
    for kind in kinds:
        if typing.get_origin(kind) is Literal:
            return kind, optional
        origin = typing.get_origin(kind)
        if isinstance(origin, type) and issubclass(origin, Sequence) and origin is not tuple:
            several = typing.get_args(kind)[0]
            return list[Path] if several is Path else list[str], optional
    if str in kinds and float in kinds:
        return _flag_number_or_text, optional
    paths = any(typing.get_origin(kind) is os.PathLike for kind in kinds)
    return Path if paths else next((k for k in _KINDS if k in kinds), Path), optional


def _flag_number_or_text(given: Any) -> bool | float | str:
    """What a word stands for where several kinds are possible: true, false, a number or a text."""
    word = str(given)  # the default is not a text
    with contextlib.suppress(ValueError):
        return float(word)
    return {"true": True, "false": False}.get(word.lower(), word)


def _help(functions: Sequence[Callable[..., Any]], name: str) -> str:
    """First sentence on a parameter in the first docstring that does not point to another."""
    for function in functions:
        doc = (inspect.getdoc(function) or "") + "\n"
        match = re.search(rf"^(?:\w+, )*{name}(?:, \w+)* :[^\n]*\n((?:    .*\n)+)", doc, re.M)
        text = re.sub(r":\w+:", "", " ".join(match[1].split()) if match else "")
        if text and not re.match(r"(Both |All )?[Aa]s in", text):
            return re.split(r"(?<=[.])\s", text)[0].replace("``", "`")
    return ""
