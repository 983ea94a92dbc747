"""`Batch`: the outcome of each file, the coefficients over files, and a summary of their spread."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from bayeq.discovery.entry import SOURCES, discover, question_of
from bayeq.discovery.question import Question
from bayeq.equation.answer import CONSTANT
from bayeq.equation.equations import Equations
from bayeq.equation.load import restored
from bayeq.errors import InputError, UnknownNameError, as_path
from bayeq.inference.prior import Prior
from bayeq.records.formats import suffixes
from bayeq.records.formats.excel import without_sheet
from bayeq.records.stream import files_in
from bayeq.regression.constraints import CONSERVED

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Function from a file to the `records` of `discover`; its `repr` says how files are read.
Read = Callable[[Path], Any]

# Arguments of `discover` that are not part of a `Question`.
_BESIDE = {*SOURCES, "progress"}

# Slab variance that shrinks no coefficient, used when all terms are included.
_WIDE = 1e8


def question(options: Mapping[str, Any]) -> Question:
    """The `Question` for each file; InputError for an option that `discover` does not have or refuses."""
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
    """Hash of the options, the terms (a dictionary may be a file), the reading and the version of bayeq."""
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
    """The options of `discover` for one file, with the terms of the `common` equation alone; InputError without any."""
    sought = question(options).roles.sought
    terms = {
        one["target"]: [_with_ranges(t["name"], one) for t in one["terms"] if t["shown"]]
        for one in common["equations"]
        if one["target"] in sought
    }
    stated = len(terms) < len(common["equations"])
    conserved = any(text.endswith(CONSERVED) for text in common["diagnostics"].get("constraints", ()))
    empty = [target for target, names in terms.items() if not names]
    if empty:
        raise InputError(
            f"the common equation of {', '.join(empty)} has no terms: there is nothing to compare over files; offer"
            " other terms (dictionary=), or leave common out"
        )
    prior = options.get("prior") or Prior()
    fixed = {
        **options,
        "dictionary": terms,
        "law": options.get("law", ()) if stated else (),  # the files may not need the hidden state
        "conserve": options.get("conserve", "") if conserved else "",
        "constraints": (),
    }
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
    """A term with the search ranges of its unknown constants written into it, ``{v0: 0.1..2.0}``."""
    for one in equation.get("constants", ()):
        term = term.replace(f"{{{one['name']}}}", f"{{{one['name']}: {one['low']!r}..{one['high']!r}}}")
    return term


def _holds(options: Mapping[str, Any], constraint: str) -> bool:
    """Whether a constraint, valid for the full dictionary, is on terms of these options."""
    try:
        question({**options, "constraints": constraint})
    except UnknownNameError:
        return False
    return True


# --- files -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Identity:
    """State of a file when it was read: size, time of change and hash."""

    size: int  # in bytes
    mtime: int  # time of its last change [ns]
    sha256: str  # of its content

    @classmethod
    def of(cls, path: Path) -> Self:
        """The identity of a file now; OSError if it cannot be read."""
        with without_sheet(path)[0].open("rb") as file:
            state = os.fstat(file.fileno())
            return cls(state.st_size, state.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())

    def holds(self, path: Path) -> bool:
        """Whether a file is unchanged: same size, and same time of change or else same hash."""
        try:
            state = without_sheet(path)[0].stat()
            if state.st_size != self.size:
                return False
            return state.st_mtime_ns == self.mtime or Identity.of(path).sha256 == self.sha256
        except OSError:
            return False


def files_of(sources: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """Files, with folders replaced by their files in numerical order; InputError for none, or one named twice."""
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


COLUMNS = (
    "order", "file", "target", "term", "coef", "sd", "ci_low", "ci_high", "pip", "included", "shown", "verdict", "unit",
)  # fmt: skip

DIFFERENT = (
    "The terms are not those of all files: the coefficient of one changes where another comes or goes; --common\n"
    "  (common=True) compares the coefficients of one equation."
)

UNITS = "The units of {} differ over files: state them with --units (read={{'units': ...}}) before comparing numbers."


@dataclass(frozen=True, slots=True)
class BatchFile:
    """One file of a batch.

    Attributes
    ----------
    path : str
        Path as given.
    status : "ok", "refused" or "failed"
        ``refused``: the file, or what is in it, cannot be used; ``failed``: anything else went wrong.
    message : str
        The reason in one line; empty if the status is ``ok``.
    content : mapping or None
        The content of a saved file: the equations as `Equations.to_dict` gives them, and further data.
    """

    path: str
    status: str
    message: str
    content: Mapping[str, Any] | None

    @property
    def equations(self) -> Equations:
        """The equations of the file, as `bayeq.load` gives them.

        Raises
        ------
        InputError
            The file has no equations.
        """
        if self.content is None:
            raise InputError(f"{self.path}: has no equations: {self.message}")
        return restored(self.content, self.path)


class Batch:
    """Result of `batch`: a sequence of `BatchFile`, in the order of the files.

    Attributes
    ----------
    files : tuple of BatchFile
        Outcome of each file.
    done : int
        How many files were done in this run; the others were in the store.
    """

    def __init__(self, files: tuple[BatchFile, ...], common: Mapping[str, Any] | None, done: int) -> None:
        self.files, self._common, self.done = files, common, done

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[BatchFile]:
        return iter(self.files)

    def __getitem__(self, position: int) -> BatchFile:
        return self.files[position]

    @property
    def refused(self) -> tuple[BatchFile, ...]:
        """The files without equations; `BatchFile.message` says why."""
        return tuple(one for one in self.files if one.content is None)

    @property
    def common(self) -> Equations | None:
        """The equations that all files have in common, if they were asked for."""
        return None if self._common is None else restored(self._common, "the common equation")

    def table(self) -> pd.DataFrame:
        """Coefficients over files, a row for each file, target and term.

        Returns
        -------
        DataFrame
            ``order`` of the file, from 0; ``file``; ``target``; ``term``: all of the common equation, or without one
            all shown for at least one file (``1`` is the constant, where it is written out); ``coef``, ``sd``,
            ``ci_low``, ``ci_high`` of the equation as it is printed, 0 where the term is not in it; ``pip``;
            ``included``, ``shown``; ``verdict`` on the equation; ``unit`` of the coefficient. With a common equation
            also ``common_coef``, ``common_ci_low``, ``common_ci_high``. Files without equations have no row.
        """
        import pandas as pd

        rows = self.rows()
        columns = [*COLUMNS, "common_coef", "common_ci_low", "common_ci_high"] if self._common else [*COLUMNS]
        return pd.DataFrame(rows, columns=columns)

    def rows(self) -> list[dict[str, Any]]:
        """The rows of `table`, as plain data."""
        found = [(k, one.path, _terms(eq)) for k, one in enumerate(self.files) for eq in _equations(one.content)]
        shared = [term for equation in _equations(self._common) for term in _terms(equation)]
        shown = [_pair(term) for term in shared or chain(*(terms for *_, terms in found)) if term["shown"]]
        # in order of first appearance, the constant last
        listed = sorted(dict.fromkeys(shown), key=lambda pair: pair[1] == CONSTANT)
        beside = {
            _pair(term): {f"common_{name}": term[name] for name in ("coef", "ci_low", "ci_high")} for term in shared
        }
        out = []
        for k, path, terms in found:
            own = {_pair(term): term for term in terms}
            for pair in filter(own.__contains__, listed):
                own[pair]["shown"] |= self._common is not None  # also the constant, which the prior does not force in
                out.append({"order": k, "file": path, **own[pair], **beside.get(pair, {})})
        return out

    def plot(self) -> Figure:
        """Coefficients over files with their 95 % intervals, a panel for each term.

        Raises
        ------
        InputError
            No file has an equation.
        MissingExtraError
            matplotlib is not installed.
        """
        from bayeq.figures.terms import draw_drift

        return draw_drift(self.table())

    def __str__(self) -> str:
        """Verdicts, and a line for each term of each target.

        The number of files whose equation has the term; its coefficient in the first and last of these, and the median;
        half the 95 % interval (median); and the spread: the standard deviation of the coefficient over files divided by
        the root mean square of its sd, about 1 if it is the same in all files.
        """
        count = len(self.files)
        lines = [f"{count} file{'s' * (count != 1)}, {count - len(self.refused)} with equations"]
        rows = self.rows()
        for target in dict.fromkeys(row["target"] for row in rows):
            own = [row for row in rows if row["target"] == target]
            verdicts = Counter(row["verdict"] for row in {row["order"]: row for row in own}.values())
            said = ", ".join(f"{kind} {count}" for kind, count in verdicts.most_common())
            lines += ["", f"{target}: {said}", ""]
            head = f"  {'term':<16} {'files':>5} {'first':>11} {'last':>11} {'median':>11} {'+-':>9} {'spread':>7}"
            lines += [head, *(_line(own, term) for term in dict.fromkeys(row["term"] for row in own))]
            if not all(row["shown"] for row in own if row["term"] != CONSTANT):
                lines += ["", f"  {DIFFERENT}"]
            units = Counter(term for term, _ in {(row["term"], row["unit"]) for row in own})
            mixed = sorted(term for term, count in units.items() if count > 1)
            if mixed:
                lines += ["", f"  {UNITS.format(', '.join(mixed))}"]
        return "\n".join(lines)


def _pair(term: Mapping[str, Any]) -> tuple[str, str]:
    return term["target"], term["term"]


def _equations(content: Mapping[str, Any] | None) -> list[Mapping[str, Any]]:
    return [] if content is None else list(content["equations"])


def _terms(equation: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Table rows of an equation: its terms, the unknown constants inside shown terms, and the intercept."""

    def row(name: str, *numbers: Any, unit: Any = None) -> dict[str, Any]:
        coef, sd, ci95, pip, included, shown = numbers
        cells = (equation["target"], name, coef, sd, *sorted(ci95), pip, included, shown, equation["verdict"]["kind"])
        return dict(zip(COLUMNS[2:], (*cells, unit), strict=True))

    visible = {term["name"] for term in equation["terms"] if term["shown"]}
    names = ("name", "shown_coef", "shown_sd", "printed_ci95", "pip", "included", "shown")
    terms = [row(*(term[name] for name in names), unit=term["unit"]) for term in equation["terms"]]
    for one in equation.get("constants", ()):
        if one["sd"] is not None and visible & set(one["terms"]):
            numbers = (one["value"], one["value_sd"], one["ci95"], None, True, True)
            terms.append(row(f"{{{one['name']}}}", *numbers, unit=one["unit"]))
    interval, pip = equation["intercept_printed_ci95"], equation["intercept_pip"]
    matters = pip > 0.5 if pip is not None else min(interval) > 0.0 or max(interval) < 0.0
    intercept = (equation["intercept"], equation["intercept_sd"], interval, pip, matters, matters)
    return [*terms, row(CONSTANT, *intercept)]


def _line(rows: Sequence[dict[str, Any]], term: str) -> str:
    """Line of a term, over the files whose equation has it."""
    own = [row for row in rows if row["term"] == term and row["shown"]]
    coef, sd = np.array([row["coef"] for row in own]), np.array([row["sd"] for row in own])
    half = np.median([(row["ci_high"] - row["ci_low"]) / 2.0 for row in own])
    rms = np.sqrt(np.mean(sd**2))
    spread = f"{np.std(coef, ddof=1) / rms:7.1f}" if len(own) > 1 and rms > 0.0 else f"{'-':>7}"
    numbers = f"{coef[0]:11.5g} {coef[-1]:11.5g} {np.median(coef):11.5g} {half:9.2g}"
    return f"  {term:<16} {len(own):5} {numbers} {spread}"
