"""What can go wrong, as types.

::

    BayeqError
    ├── InputError (ValueError)       the input or an argument is wrong; the command line exits with 2
    │   ├── FileFormatError           a file is missing, unreadable or not what its name says
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
import warnings
from collections.abc import Iterable
from typing import Any

__all__ = [
    "AmbiguityWarning",
    "BayeqError",
    "BayeqWarning",
    "ChainError",
    "ConvergenceWarning",
    "CorrelatedResidualsWarning",
    "DataWarning",
    "ExpressionError",
    "FileFormatError",
    "InputError",
    "InterruptedRun",
    "MissingExtraError",
    "RecordError",
    "TermWarning",
    "UnknownNameError",
    "WarningLog",
]


class BayeqError(Exception):
    """Base of every exception that bayeq raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:  # by its message: arguments of subclasses are others
        return _received, (type(self), self.args, self.__dict__)


def _received(kind: type[BayeqError], args: tuple[Any, ...], state: dict[str, Any]) -> BayeqError:
    """An error that another process sent."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InputError(BayeqError, ValueError):
    """The input or an argument is wrong; the message says what, where and what to do."""


class FileFormatError(InputError):
    """A file is missing, cannot be read, or does not hold what its format promises."""


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
        What was asked for.
    known : iterable of str
        What there is.
    where : str, optional
        Where it was looked for (a file, an argument), put in front of the message.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "") -> None:
        self.name = name
        known = [str(k) for k in known]
        folded = {k.casefold(): k for k in known}
        near = [folded[m] for m in difflib.get_close_matches(name.casefold(), list(folded), n=3, cutoff=0.5)]
        message = f"no {kind} named {name!r}"
        if near:
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
    """Warnings collected on the way: issued at the end, and kept in the answer."""

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
        """Record several of one category.

        Parameters
        ----------
        messages : iterable of str
            One for each warning.
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
            As for `warnings.warn`: whose line is named.
        """
        for message, category in self.collected:
            warnings.warn(message, category, stacklevel=stacklevel)
