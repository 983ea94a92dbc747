"""What a batch is asked: options of `discover`, checked once, and files; and what tells batches and files apart."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np

from bayeq.discovery.entry import discover, question_of
from bayeq.discovery.question import Question
from bayeq.errors import InputError, UnknownNameError, as_path
from bayeq.inference.prior import Prior
from bayeq.records.formats import suffixes
from bayeq.records.formats.excel import without_sheet
from bayeq.records.stream import files_in

#: From a file to what `discover` takes; its text says how files are read.
Read = Callable[[Path], Any]

# What `discover` takes beside the options of a question.
_BESIDE = {"records", "progress", "t", "stream", "client", "checkpoint"}

# A slab that shrinks no coefficient: all terms are in, and the data say the rest.
_WIDE = 1e8


def question(options: Mapping[str, Any]) -> Question:
    """The question that is put to each file; InputError for an option that `discover` does not have or refuses."""
    parameters = inspect.signature(discover).parameters
    known = {name: one.default for name, one in parameters.items() if name not in _BESIDE}
    for name in options:
        if name in ("client", "checkpoint", "progress"):
            raise InputError(f"batch takes no {name}: files are done side by side with jobs=, and kept in store=")
        if name not in parameters or name == "records":
            raise UnknownNameError("option", name, known, where="batch")
    given = {name: value for name, value in options.items() if name in known}
    return question_of(**{**known, **given}, progress=None)


def digest(options: Mapping[str, Any], read: Read) -> str:
    """A text that differs where options, the terms of a dictionary in a file, reading or the program do."""
    asked = question(options)
    content = {
        **{name: value for name, value in options.items() if name != "dictionary"},
        "terms": [term.text for term in asked.terms],
        "allowed": asked.allowed.tolist(),
        "read": repr(read),
        "version": version("bayeq"),
    }
    text = json.dumps(content, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: object) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    return repr(value)


def fixed_terms(options: Mapping[str, Any], common: Mapping[str, Any]) -> dict[str, Any]:
    """The options of `discover` for one file with the terms of the `common` equation, as it is saved, and no others.

    InputError for an equation without terms.
    """
    terms = {
        one["target"]: [_with_ranges(t["name"], one) for t in one["terms"] if t["shown"]] for one in common["equations"]
    }
    empty = [target for target, names in terms.items() if not names]
    if empty:
        raise InputError(
            f"the common equation of {', '.join(empty)} has no terms: there is nothing to compare over files; offer"
            " other terms (dictionary=), or leave common out"
        )
    prior = options.get("prior") or Prior()
    fixed = {**options, "dictionary": terms, "constraints": (), "conserve": ""}
    given = options.get("constraints", ())
    texts = [given] if isinstance(given, str) else given
    return {
        **fixed,
        "constraints": [text for text in texts if _holds(fixed, text)],
        "prior": replace(prior, slab_variance=_WIDE, prior_inclusion=1.0, inclusion_beta=None, signs=None, bounds=None),
        "method": "bma",
        "max_terms": None,
        "tolerance": 0.0,
    }


def _with_ranges(term: str, equation: Mapping[str, Any]) -> str:
    """A term with the ranges in which the constants inside it were sought."""
    for one in equation.get("constants", ()):
        term = term.replace(f"{{{one['name']}}}", f"{{{one['name']}: {one['low']!r}..{one['high']!r}}}")
    return term


def _holds(options: Mapping[str, Any], constraint: str) -> bool:
    """Whether a constraint, which has been checked, is on terms that are left."""
    try:
        question({**options, "constraints": constraint})
    except UnknownNameError:
        return False
    return True


# --- files -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Identity:
    """What a file was when it was read."""

    size: int  # in bytes
    mtime: int  # time of its last change [ns]
    sha256: str  # of its content

    @classmethod
    def of(cls, path: Path) -> Self:
        """That of a file as it is now; OSError if it cannot be read."""
        with without_sheet(path)[0].open("rb") as file:
            state = os.fstat(file.fileno())
            return cls(state.st_size, state.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())

    def holds(self, path: Path) -> bool:
        """Whether a file is unchanged: its size and time are, or else its content is."""
        try:
            state = without_sheet(path)[0].stat()
            if state.st_size != self.size:
                return False
            return state.st_mtime_ns == self.mtime or Identity.of(path).sha256 == self.sha256
        except OSError:
            return False


def files_of(sources: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """The files, and those of each folder whose suffix is that of a known format, in the order of their numbers.

    InputError for a folder without such files, no files at all, or one that is named twice.
    """
    paths = [as_path(source, "each of the files") for source in sources]
    for path in paths:
        try:
            os.fsencode(path)
            path.is_dir()
        except (OSError, ValueError):
            raise InputError(f"{str(path)[:60]!r}: is no name of a file") from None
    out = files_in(paths, suffixes(), "of a known format")
    if not out:
        raise InputError("no files are given: name files or folders")
    seen: set[str] = set()
    for path in out:
        place = os.path.realpath(path)
        if place in seen:
            raise InputError(f"{path}: named twice; leave one of them out")
        seen.add(place)
    return tuple(out)
