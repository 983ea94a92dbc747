"""Exceptions and warnings of bayeq, and checks of argument types with one-line messages that name the argument.

::

    BayeqError
    ├── InputError (ValueError)       the input or an argument is wrong; the command line exits with 2
    │   ├── FileFormatError           a file is missing, unreadable or not what its name says
    │   │   ├── WordsError            a column that holds words instead of numbers
    │   │   └── LengthsError          arrays of several lengths: no single record
    │   ├── RecordError               samples that cannot be used: NaN, unordered time, zero rows ...
    │   ├── UnknownNameError          no such channel, system, dictionary ...; near names are offered
    │   ├── ChainError                a kinematic chain that cannot be read or differentiated
    │   └── ExpressionError           a term that is malformed, or not allowed
    ├── MissingExtraError (ImportError)   an optional dependency is not installed; names the extra
    └── InterruptedRun                long work was stopped by the user; says what was kept

    BayeqWarning (UserWarning)
    ├── TermWarning                   candidate terms left out, and why
    ├── DataWarning                   the answer stands on little or doubtful data
    ├── AmbiguityWarning              other terms explain the data about as well
    ├── CorrelatedResidualsWarning    the residuals are not white: intervals are too narrow
    └── ConvergenceWarning            an iteration stopped before it converged
"""

from __future__ import annotations

import difflib
import errno
import operator
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from typing import Any

__all__ = [
    "AmbiguityWarning", "BayeqError", "BayeqWarning", "ChainError", "ConvergenceWarning",
    "CorrelatedResidualsWarning", "DataWarning", "ExpressionError", "FileFormatError", "InputError", "InterruptedRun",
    "LengthsError", "MissingExtraError", "RecordError", "TermWarning", "UnknownNameError", "WordsError", "WarningLog",
    "as_path", "one_line", "printable", "require_kind", "require_mapping", "require_number", "require_text",
    "require_texts", "whole_number",
]  # fmt: skip


#: System error numbers of a full disk, a file too large, and an exhausted disk quota.
FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)


class BayeqError(Exception):
    """Base of every exception that bayeq raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:  # by its message: subclasses take other arguments
        return _received, (type(self), self.args, self.__dict__)


def _received(kind: type[BayeqError], args: tuple[Any, ...], state: dict[str, Any]) -> BayeqError:
    """Rebuild an exception that another process has sent."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InputError(BayeqError, ValueError):
    """The input or an argument is wrong; the message says what, where and what to do."""


class FileFormatError(InputError):
    """A file is missing, cannot be read, or does not hold what its format promises."""


class WordsError(FileFormatError):
    """A column of a file holds words instead of numbers.

    Parameters
    ----------
    message : str
        What is wrong, and where.
    column : str
        Name of the column.
    others : sequence of str
        Names of the columns that can be read without it.
    """

    def __init__(self, message: str, column: str = "", others: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.column, self.others = column, tuple(others)


class LengthsError(FileFormatError):
    """Arrays of a file differ in length (`sizes`, by channel name), so that they form no single record."""

    sizes: Mapping[str, int] = {}


class RecordError(InputError):
    """Samples that cannot be used: NaN or infinite, unordered time, no rows, unequal lengths."""


class ChainError(InputError):
    """A kinematic chain that cannot be read, or whose derivatives cannot be estimated from the data."""


class ExpressionError(InputError):
    """A term that is malformed, or uses something other than the allowed arithmetic and functions."""


class UnknownNameError(InputError):
    """A name that is not there; the message offers the nearest ones that are.

    Parameters
    ----------
    kind : str
        What the name should have been: "channel", "system" ...
    name : str
        The unknown name.
    known : iterable of str
        The names that exist.
    where : str, optional
        Where it was looked for (a file, an argument), put in front of the message.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "") -> None:
        self.name = name
        asked = str(name)
        known = [_printable(str(k)) for k in known]
        folded = {k.casefold(): k for k in known}
        near = [folded[m] for m in difflib.get_close_matches(asked.casefold(), list(folded), n=3, cutoff=0.5)]
        message = f"no {kind} named {asked[:60]!r}"
        several = re.split(r"[,_\s]+", asked)
        if len(several) > 1 and set(several) <= set(known):
            message += f": these are {len(several)}, give each by itself"
        elif near:
            message += f"; did you mean {' or '.join(repr(m) for m in near)}?"
            if len(known) > len(near):
                message += f" (there are: {', '.join(known[:12])}{', ...' if len(known) > 12 else ''})"
        elif known:
            message += f"; there are: {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"
        super().__init__(f"{where}: {message}" if where else message)


class MissingExtraError(BayeqError, ImportError):
    """An optional dependency is not installed.

    Parameters
    ----------
    package : str
        The package that could not be imported.
    extra : str
        The extra of bayeq that brings it.
    purpose : str
        What it is needed for.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs {package}: install it with `pip install 'bayeq[{extra}]'`")


@contextmanager
def needing(package: str, extra: str, purpose: str) -> Iterator[None]:
    """Import a package of an extra within this context; MissingExtraError if it is not installed."""
    try:
        yield
    except ImportError:
        raise MissingExtraError(package, extra, purpose) from None


class InterruptedRun(BayeqError):
    """Long work was stopped by the user; the message says what was kept and how to go on."""


class BayeqWarning(UserWarning):
    """Base of every warning that bayeq gives."""


class TermWarning(BayeqWarning):
    """Candidate terms were left out of the dictionary; the message names them and says why."""


class DataWarning(BayeqWarning):
    """The answer stands on little or doubtful data."""


class AmbiguityWarning(BayeqWarning):
    """Columns that cannot be told apart: other terms explain the data about as well."""


class CorrelatedResidualsWarning(BayeqWarning):
    """The residuals are correlated in time: standard deviations and intervals are too narrow."""


class ConvergenceWarning(BayeqWarning):
    """An iteration stopped at its limit before it converged."""


class WarningLog:
    """Warnings collected during the work: issued at the end, and kept in the answer."""

    def __init__(self) -> None:
        self.collected: list[tuple[str, type[BayeqWarning]]] = []

    def warn(self, message: str, category: type[BayeqWarning]) -> None:
        """Record a warning.

        Parameters
        ----------
        message : str
            What is wrong, and what to do.
        category : type of BayeqWarning
            Its type.
        """
        self.collected.append((message, category))

    def extend(self, messages: Iterable[str], category: type[BayeqWarning]) -> None:
        """Record several warnings of one category.

        Parameters
        ----------
        messages : iterable of str
            The text of each warning.
        category : type of BayeqWarning
            The type of all of them.
        """
        self.collected.extend((message, category) for message in messages)

    @property
    def messages(self) -> tuple[str, ...]:
        """The text of all warnings, in order."""
        return tuple(message for message, _ in self.collected)

    def emit(self, stacklevel: int) -> None:
        """Issue the warnings, as `warnings.warn` does from the caller.

        Parameters
        ----------
        stacklevel : int
            As for `warnings.warn`: which caller's line is named.
        """
        for message, category in self.collected:
            warnings.warn(message, category, stacklevel=stacklevel)


def some_of(texts: Sequence[str], width: int = 60, between: str = ", ") -> str:
    """As many texts as fit into a width, at least one, and how many more there are.

    >>> some_of(["x", "v", "x**3"], width=5)
    'x, v and 1 more'
    """
    shown = [text for k, text in enumerate(texts) if not k or len(between.join(texts[: k + 1])) <= width]
    rest = len(texts) - len(shown)
    return between.join(shown) + (f" and {rest} more" if rest else "")


def in_digits(value: float, digits: int = 2) -> str:
    """A number in `digits` significant digits; below 100,000, all digits before the decimal point are kept.

    >>> in_digits(0.01234), in_digits(99.7), in_digits(1250.4, 3), in_digits(2e7)
    ('0.012', '100', '1250', '2e+07')
    """
    return f"{value:.0f}" if 10.0**digits - 0.5 <= abs(value) < 1e5 else f"{value:.{digits}g}"


# Characters shown of an argument of the wrong type, at most.
MOST_SHOWN = 40


def require_kind(value: Any, kinds: type | tuple[type, ...], what: str, words: str) -> None:
    """Raise an InputError that `what` must be `words`, unless `value` is of one of the types `kinds`.

    >>> require_kind(1, str, "method", "text")
    Traceback (most recent call last):
    bayeq.errors.InputError: method must be text, not 1 (int)
    """
    if not isinstance(value, kinds):
        raise InputError(f"{what} must be {words}, not {_shown(value)}")


def printable(text: str) -> str:
    """Text with unprintable characters escaped: names of files may hold control sequences of a terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(message: object) -> str:
    """A message without line breaks."""
    return " ".join(str(message).split())


def whole_number(what: str, value: Any, least: int, most: int | None = None) -> int:
    """`value` as an int; an InputError about `what` unless it is a whole number from `least` to `most`.

    >>> whole_number("rows", 3, 2)
    3
    """
    try:
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{what} must be a whole number, not {value!r}") from None
    if number < least:
        raise InputError(f"{what} must be at least {least}, not {number}")
    if most is not None and number > most:
        raise InputError(f"{what} must be at most {most}, not {number}")
    return number


def require_text(value: Any, what: str, optional: bool = False) -> None:
    """Raise an InputError unless a value is text, or None if `optional`."""
    if not (optional and value is None):
        require_kind(value, str, what, "text")


def require_number(value: Any, what: str) -> None:
    """Raise an InputError unless a value is a real number."""
    require_kind(value, Real, what, "a number")


def require_texts(value: Any, what: str) -> None:
    """Raise an InputError unless a value is text, or an iterable of texts."""
    if isinstance(value, str):
        return
    require_kind(value, Iterable, what, "text or a list of texts")
    for one in value:
        require_kind(one, str, f"each of {what}", "text")


def require_mapping(value: Any, what: str) -> None:
    """Raise an InputError unless a value is a mapping with text as keys."""
    require_kind(value, Mapping, what, "a mapping such as {'x': ...}")
    for key in value:
        require_kind(key, str, f"a key of {what}", "text")


def as_path(value: Any, what: str = "the file") -> Path:
    """Convert text or an `os.PathLike` of text to a `Path`; InputError for anything else."""
    require_kind(value, (str, os.PathLike), what, "a path")
    try:
        return Path(value)
    except TypeError:  # a PathLike of bytes
        raise InputError(f"{what} must be a path of text, not {_shown(value)}") from None


def _shown(value: Any) -> str:
    text = _printable(repr(value))
    short = text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
    return f"{short} ({type(value).__name__})"


def _printable(text: str) -> str:
    """Text of a file or a user with unprintable characters, line breaks among them, replaced by spaces."""
    return "".join(c if c.isprintable() else " " for c in text)
