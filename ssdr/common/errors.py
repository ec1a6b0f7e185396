"""Errors and warnings of this package, and checks of single numbers, flags and choices.

All errors derive from :class:`SsdrError`, so that one ``except`` catches them;
those about an argument or a file are ``ValueError`` as well.
"""

from __future__ import annotations

import math
from typing import Any, TypeGuard, get_args

import numpy as np

__all__ = [
    "Cancelled",
    "FormatError",
    "InputError",
    "MissingDependencyError",
    "SsdrError",
    "SsdrWarning",
]


class SsdrError(Exception):
    """Base class of every error raised by :mod:`ssdr`.

    Examples
    --------
    >>> try:
    ...     ssdr.load("horse.xyz")
    ... except ssdr.SsdrError as error:
    ...     print(type(error).__name__)
    FormatError
    """

    __module__ = "ssdr"


class InputError(SsdrError, ValueError):
    """An argument is not what the function needs.

    The message reads ``argument: expected ..., got ...``.

    Examples
    --------
    >>> try:
    ...     ssdr.set_threads(0)
    ... except ssdr.InputError as error:
    ...     print(error)
    count: expected a positive integer or None, got 0
    """

    __module__ = "ssdr"

    def __init__(self, argument: str, expected: str, got: object) -> None:
        self.argument = argument
        self.expected = expected
        self.got = got
        super().__init__(f"{argument}: expected {expected}, got {got}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, object]]:
        # Exception pickles its message alone; errors must survive a process pool.
        return type(self), (self.argument, self.expected, self.got)


class FormatError(SsdrError, ValueError):
    """A file is truncated, hostile or mislabelled, or its content is not allowed.

    Examples
    --------
    >>> try:
    ...     ssdr.load("horse.xyz")
    ... except ssdr.FormatError:
    ...     print("not a file that can be read")
    not a file that can be read
    """

    __module__ = "ssdr"


class MissingDependencyError(SsdrError, ImportError):
    """An optional package is needed; the message says how to install it.

    Examples
    --------
    >>> issubclass(ssdr.MissingDependencyError, ssdr.SsdrError)
    True
    """

    __module__ = "ssdr"


class Cancelled(SsdrError):
    """A callback asked to stop before there was a result.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> try:
    ...     ssdr.smallest(dancer, tolerance="1%", callback=lambda progress: True)
    ... except ssdr.Cancelled:
    ...     print("stopped")
    stopped
    """

    __module__ = "ssdr"


class SsdrWarning(UserWarning):
    """A result is not what the caller may expect.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", ssdr.SsdrWarning)
    ...     result = ssdr.decompose(np.ones((2, 4, 3)), bones=2, effort="fast")
    >>> result.warnings
    ('nothing moves but the mesh as a whole: all bones could each go at no loss',)
    """

    __module__ = "ssdr"


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is an integer; True and False do not count as integers."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def is_real(value: object, *, finite: bool = True) -> TypeGuard[float]:
    """Whether a value is a real number, by default a finite one (not True or False)."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    try:
        return not finite or math.isfinite(value)
    except OverflowError:  # an integer that no float holds
        return False


def check_flag(value: object, argument: str) -> bool:
    """Check that a value is True or False, and return it as a bool."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(argument, "True or False", repr(value))
    return bool(value)


def check_choice(value: object, argument: str, choices: Any) -> None:
    """Raise an InputError unless the value is one of the strings of the ``Literal`` `choices`."""
    if not isinstance(value, str) or value not in get_args(choices):
        raise InputError(argument, f"one of {get_args(choices)}", repr(value))


def error_text(error: BaseException) -> str:
    """Message of an error.  That of an OSError names the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error) or type(error).__name__
