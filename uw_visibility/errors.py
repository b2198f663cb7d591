# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of bad input, and sanitising of text from outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

# Most characters of a message, enough for an error and what to do, and of a name in it.
LONGEST_MESSAGE = 1000
LONGEST_NAME = 200


def printable(text: object, length: int = LONGEST_NAME) -> str:
    """Return text from outside without control characters and cut to a length.

    Names of topics, frames, encodings, files and keys come from the author of a
    file or message. Escape sequences in them could control a terminal, line breaks
    could forge lines of a log, and their length is not limited.

    length: most characters; of longer text the middle is left out.
    Returns one line of printable characters.
    """
    whole = str(text)
    if len(whole) > length:
        # A path ends with the file, and a message with what to do.
        tail = length // 3
        whole = f"{whole[: length - tail - 1]}…{whole[-tail:]}"
    return "".join(
        c if c.isprintable() else " " if c.isspace() else "\N{REPLACEMENT CHARACTER}"
        for c in whole
    )


_FORMULA = ("=", "+", "-", "@")


def cell(value: object) -> object:
    """Return a value as a cell of a CSV file; ' precedes text that a spreadsheet would run.

    Names of recordings and frames come from outside, and ``=...`` in a cell is a formula.

    References
    ----------
    OWASP, CSV Injection, https://owasp.org/www-community/attacks/CSV_Injection
    """
    if not isinstance(value, str):
        return value
    # Python's writer does not quote a carriage return, which readers take for the end of a row.
    text = value.replace("\r", " ")
    if not text.lstrip().startswith(_FORMULA):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def uncell(text: str) -> str:
    """Return the text of a cell that `cell` wrote."""
    formula = text.startswith("'") and text[1:].lstrip().startswith(_FORMULA)
    return text[1:] if formula else text


class InputError(ValueError):
    """Bad input: the message names it and says what to do.

    The command prints the message and exits with code 2; the node counts and
    reports a dropped frame, or refuses the parameter.

    Parameters
    ----------
    message : str
        May contain text from outside, which `printable` sanitises.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message, LONGEST_MESSAGE))


def check_range(
    what: str, values: float | Sequence[float], low: float, high: float = math.inf,
    unit: str = "", *, above: bool = False,
) -> None:
    """Refuse a number, or one of several, that is not finite or not within a range in `unit`.

    above: whether `low` itself is excluded.
    """
    several = isinstance(values, Sequence)
    numbers = values if isinstance(values, Sequence) else (values,)
    if numbers and all(
        low <= n <= high and math.isfinite(n) and not (above and n == low) for n in numbers
    ):
        return
    given = ", ".join(f"{n:g}" for n in numbers) or "missing"
    unit = f" {unit}" if unit else ""
    wanted = f"{'more than' if above else 'at least'} {low:g}"
    wanted += "" if high == math.inf else f" and at most {high:g}"
    raise InputError(f"{what} {'are' if several else 'is'} {given}{unit}: give {wanted}{unit}")


@contextmanager
def needing(extra: str, what: str, otherwise: str = "") -> Iterator[None]:
    """Turn the error of a missing optional library into one that names its extra.

    extra: extra of this package that installs it; several are separated by commas.
    otherwise: text on an alternative, for the end of the message.
    Raises `InputError` if an import within fails.
    """
    try:
        yield
    except ImportError as error:
        if (error.name or "").startswith("uw_visibility"):
            raise
        raise InputError(
            f"{what} needs {(error.name or str(error)).partition('.')[0]}: install the extra "
            f"{extra}, pip install 'uw_visibility[{extra}]'{otherwise}"
        ) from error


@contextmanager
def refusing(what: str, *kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of the system, or of a store of files, into an `InputError` that names `what`.

    `kinds` are the errors that are turned, by default OSError; an `InputError` is unchanged.
    """
    turned = kinds or (OSError,)
    try:
        yield
    except InputError:
        raise
    except turned as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{what}: {reason}") from error


@contextmanager
def naming(what: object) -> Iterator[None]:
    """Begin the messages of errors with the name of the file or option."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
