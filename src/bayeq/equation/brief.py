"""The answer in a few lines, as `bayeq discover` prints it: verdict, law, checks; `text.render` prints all."""

from __future__ import annotations

import os
import shlex
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.dictionary import evaluate_terms
from bayeq.equation import text
from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.physical import forces_of, own_parameters
from bayeq.equation.quantities import PhysicalParameters, Quantity
from bayeq.equation.verdict import CLIPPED
from bayeq.equation.written import moment
from bayeq.errors import in_digits, printable
from bayeq.expressions import parse
from bayeq.figures.terms import draw_terms
from bayeq.forecast.score import percent, percentages
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.markup import aligned, code, items, join, paragraph, table
from bayeq.numerics.settings import EQUATION
from bayeq.regression.design import COPY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH = 100

# Runners-up with odds above this against the equation are rivals; then probabilities of terms are printed.
RIVAL = 0.05

# Most terms too small to be seen that are listed, and a hint at the option that lists the others.
FEW, ADVICE = 2, " (--verbose)"

# If physical parameters are printed, an equation with more terms lists them in lines, not in a table.
MOST_ROWS = 6

# A longer answer of one equation has terms in lines instead of tables, and no empty line above the checks.
MOST_LINES = 16

# Parameters that follow from others and are not printed.
DERIVED = ("omega_n",)


def brief(eq: Answer, folder: str | os.PathLike[str] = "") -> str:
    """Verdict, law in physical parameters if there are any, equations, checks and source; or, without one, advice."""
    verdict = _wrapped(f"verdict: {eq.verdict.kind}: {sentence(eq)}")
    if eq.verdict.kind == "none":
        return "\n".join([*verdict, "", *_wrapped(what_to_try(eq, folder))])
    physical = own_parameters(eq)
    lines = [*verdict, *_answer(eq, physical, compact=False)]
    if len(lines) > MOST_LINES and len(eq.equations) == 1:
        lines = [*verdict, *_answer(eq, physical, compact=True)]
    return "\n".join(lines)


def _answer(eq: Answer, physical: PhysicalParameters | None, compact: bool) -> list[str]:
    """The law, its parameters and terms, the checks; terms are in tables, or in lines with `compact`."""
    lines, second = list[str](), [one for one in eq.equations if one.chain.order == 2]
    # the equation that the physical parameters belong to, if it is only one
    owner = second[0] if len(second) == 1 else eq.equations[0] if len(eq.equations) == 1 else None
    for one in eq.equations:
        own = physical if physical and one is owner else None
        tabled = not physical or _doubtful(one) or bool(one.shown_constants)
        lines += [
            *([""] if tabled or one is eq.equations[0] else []),
            *(_law(eq, own, one) if own else ()),
            # bold for a terminal; `click.echo` takes it out elsewhere
            *(f"\x1b[1m{line}\x1b[0m" for line in _wrapped(one.text, "    ")),
        ]
        if own or compact or (one.chain.stated and not tabled) or not (tabled or len(one.shown) <= MOST_ROWS):
            lines += _in_lines(one, ENGINES[eq.method].score, certain=not (own or one.chain.stated))
        else:
            lines += _table(one, ENGINES[eq.method].score, marked=bool(physical))
    if physical is not None and (physical.note or owner is None):
        lines += ["", *_rows(map(_cells, _told(physical)))]
        if physical and physical.unexplained and eq.equations[0].chain.order == 2:
            lines += _wrapped(f"    also in the equation: {', '.join(physical.unexplained)}", "      ")
        lines += _wrapped(f"    {physical.note}", "      ")
    if any(f" {text.MARK}" in line for line in lines):
        lines += _wrapped(f"    {text.MARK} {text.OVER_MODELS}", "      ")
    checked = _wrapped(checks(eq))
    for one in eq.equations:
        which = f"{one.target}: " if len(eq.equations) > 1 else ""
        small = [[_wrapped(which + said) for said in text.unseen(one, few, ADVICE)] for few in (FEW, 1)]
        others = (_wrapped(which + said) for said in (*failed(one), *offset(one)))
        checked += chain.from_iterable([*others, *min(small, key=lambda said: sum(map(len, said)))])
    checked += chain.from_iterable(map(_wrapped, (*copies(eq), *text.given_of(eq))))
    return [*lines, *([] if compact else [""]), *checked, *_wrapped(text.source_of(eq, short=True))]


def _law(eq: Answer, physical: PhysicalParameters, owner: Equation) -> list[str]:
    """The law in symbols, if all its terms have one; its parameters; intervals of terms without a parameter."""
    in_symbols, symbols = law_in_symbols(eq, physical), {q.symbol for q in physical}
    constants = [
        (row.name, row.coefficient, f"({row.interval})", printable(row.unit), "inside a term")
        for row in text.rows_of(owner)[:-1]
        if row.coefficient and not row.score
    ]
    lines = [
        *([] if in_symbols is None else _wrapped(in_symbols, "    ")),
        *_rows([*map(_cells, _told(physical)), *constants]),
    ]
    also = _intervals(owner, physical.unexplained, "x0" in symbols)
    return lines + _wrapped(f"    also in the equation: {also}", "      ") if also else lines


def _in_lines(equation: Equation, score: str, certain: bool) -> list[str]:
    """Terms in doubt with their probabilities; with `certain` also the intervals of all terms shown."""
    rows = text.rows_of(equation)[:-1]
    doubtful = [row for row in rows if row.pip < text.CERTAIN and (row.coefficient or row.pip > RIVAL)]
    listed = ", ".join(
        f"{row.name} ({score} {row.score}{'' if row.coefficient else ', not in it'})" for row in doubtful
    )
    lines = [f"    in doubt: {listed}"] if doubtful else []
    if certain:
        lines.insert(0, f"    95 % intervals: {_intervals(equation, [row.name for row in rows if row.coefficient])}")
    return list(chain.from_iterable(_wrapped(line, "      ") for line in lines))


def _intervals(equation: Equation, names: Sequence[str], without_constant: bool = False) -> str:
    """Terms, and unless `without_constant` the constant if it matters, with the intervals of their coefficients."""
    *rows, constant = text.rows_of(equation)
    known = {**{row.name: row for row in rows}, "constant": constant}
    listed = [*names, *(["constant"] if equation.intercept_matters and not without_constant else [])]
    return ", ".join(f"{name} ({known[name].marked})" if name in known else name for name in listed)


def _wrapped(words: str, indent: str = "  ") -> list[str]:
    together = printable(words).replace(" %", "\u00a0%")  # a number and its unit stay on a line
    lines = textwrap.wrap(together, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return [line.replace("\u00a0", " ") for line in lines]


def sentence(eq: Answer) -> str:
    """The verdict's reason as a sentence, to be printed after its kind."""
    verdict = eq.verdict
    if verdict.kind != "found":
        said = verdict.reason if verdict.kind == "none" else str(verdict).partition(": ")[2]
        return printable(said.removeprefix("no equation found: "))
    ranges = []
    for name in dict.fromkeys([*eq.states, *eq.inputs]):
        if name in eq.data.measured.ranges and name not in eq.numbers:
            low, high = eq.data.measured.ranges[name]
            unit = eq.equations[0].units.get(name, "")
            ends = [in_digits(low), in_digits(high)]
            ranges.append(f"{name} {' .. '.join(ends)}{' ' if unit else ''}{unit}")
    within = f" for {', '.join(ranges)}" if ranges else ""
    return printable(f"no test speaks against {'it' if len(eq.equations) == 1 else 'them'}{within}")


def what_to_try(eq: Answer, folder: str | os.PathLike[str] = "") -> str:
    """Where no equation was found: the likely cause and a command."""
    if eq.verdict.advice:
        return printable(f"Likely {eq.verdict.advice}.")
    warned = next((said for said in eq.warnings if "--" in said), None)
    if warned is not None:  # of the record, as it was read
        return printable(f"A warning may say why: {warned}.")
    names = [name for name in eq.data.files if name]
    file = printable(shlex.quote(os.path.join(folder, names[0]))) if names else "FILE"
    return (
        "Likely a channel has another role, unit or sign than was said, or the candidates lack what moves it."
        f" Try: bayeq info {file}"
    )


def tabled_parameters(found: PhysicalParameters) -> list[tuple[str, str, str, str, str]]:
    """Symbol, value, interval, unit and meaning of physical parameters, without those that follow from others."""
    return [(q.symbol, q.cells[0], *q.cells[2:], q.meaning) for q in found if q.symbol not in DERIVED]


def law_in_symbols(eq: Answer, found: PhysicalParameters) -> str | None:
    """``m*a + c*v + k*x = u`` for a single equation; None if a term or the constant has no symbol."""
    symbols, equation = {q.symbol for q in found}, eq.equations[0]
    if not found or len(eq.equations) > 1 or equation.chain.order != 2 or found.unexplained:
        return None
    if equation.intercept_matters and "x0" not in symbols:
        return None
    per, x = "" if "m" in symbols else "/m", equation.chain.states[0]
    about = f"({x} - x0)" if "x0" in symbols else x
    parts = [f"m*{equation.target}" if not per else equation.target]
    parts += [
        f"{f'({force.symbol}{per})' if per else force.symbol}*{text.with_names(force.term, {x: about})}"
        for force in forces_of(equation.chain)
        if force.symbol + per in symbols
    ]
    driven = [name for name in equation.shown if name in eq.inputs]
    return f"{' + '.join(parts)} = {driven[0] if driven and not per else '0'}" if not (driven and per) else None


def _told(found: PhysicalParameters) -> list[Quantity]:
    """Parameters that are printed: no position of rest at zero, no derived parameters, no mode shapes."""
    return [q for q in found if (q.mean or q.sd) and q.symbol not in DERIVED and not q.symbol.startswith("phi_")]


def _cells(quantity: Quantity) -> tuple[str, ...]:
    """A row of parameters: symbol, value, interval, unit and meaning."""
    value, _, interval, unit = quantity.cells
    return quantity.symbol, value, f"({interval})", printable(unit), _meaning(quantity)


def _rows(rows: Iterable[tuple[str, ...]]) -> list[str]:
    return [f"    {line}" for line in aligned(list(rows), left=(0, 2, 3, 4))]


def _meaning(quantity: Quantity) -> str:
    """Meaning of a parameter; without the names that its symbol holds, as of ``tau[x]``."""
    what, _, of = quantity.meaning.partition(" of ")
    if "[" not in quantity.symbol:
        return quantity.meaning
    _, without, names = of.partition(" without ")
    return f"{what}{without}{names}"


def _doubtful(equation: Equation) -> bool:
    """Whether to print probabilities: a term shown is not certain, there is a rival, or a term was left out."""
    pip = equation.posterior.pip[equation.shown_posterior.support]
    rivals = [r for r in equation.runners_up if r.log_odds > np.log(RIVAL)]
    return bool((pip < text.CERTAIN).any() or rivals or equation.left_out)


def _table(equation: Equation, score: str, marked: bool) -> list[str]:
    """Table of terms with coefficients and intervals; with `marked`, intervals over models have their mark."""
    with_pip, (*rows, constant) = _doubtful(equation), text.rows_of(equation)
    short = text.short_names([term.text for term in equation.terms], text.LONGEST_NAME)
    table = [("term", "coefficient", "95 % interval", "unit", score)]
    for row in rows:
        if row.coefficient or (with_pip and row.pip >= NOTEWORTHY_PIP):
            interval = row.marked if marked else row.interval
            name, number = text.with_names(row.name, short), row.coefficient or "not in it"
            table.append((name, number, interval, row.unit, row.score))
    if equation.intercept_matters:
        ends = constant.marked if marked else constant.interval
        table.append(("constant", constant.coefficient, ends, constant.unit, ""))
    kept = [0, 1, 2, *([3] if any(row[3] for row in table[1:]) else []), *([4] if with_pip else [])]
    return [f"    {line}" for line in aligned([[printable(row[k]) for k in kept] for row in table], left=(0, 3))]


def checks(eq: Answer) -> str:
    """How well the equations predict rows that were not used."""
    seen = [one for one in eq.equations if not one.chain.hidden]
    fits, where = [one.held_out for one in seen], "rows that were not used"
    if fits[0] is None:
        fits, where = [one.train for one in seen], "of the rows used (none were held out)"
    pairs = [(one, fit) for one, fit in zip(seen, fits, strict=True) if fit is not None]
    scores, still = eq.scores, () if eq.scores is None or fits[0] is None else eq.scores.still
    # the error of an estimated target is mostly that of the estimate, which is not printed
    measured = [(one.target, fit) for one, fit in pairs if one.chain.measured[-1] or one.chain.discrete]
    parts = [f"{target} within {percent(fit.nrmse)}" for target, fit in measured if target not in still]
    if scores is not None and scores.blew_up_at is not None:
        parts.append(f"a free run over them blew up at {moment(scores.blew_up_at, eq.roles.discrete)}")
    elif scores is not None and set(scores.free_run) - set(still):
        shown = {name: error for name, error in scores.free_run.items() if name not in still}
        lost = max(shown.values()) >= EQUATION.as_the_mean
        parts.append(f"free run {'out of step, as small errors grow:' if lost else 'within'} {percentages(shown)}")
    if still:
        parts.append(f"{', '.join(still)} hardly move{'s' * (len(still) == 1)} there, which tests little")
    if not parts:
        parts = [f"{one.target} within {percent(fit.nrmse)}" for one, fit in pairs]
    if all(not list(failed(one)) and one.verdict.kind == "found" for one in eq.equations):
        parts.append("what is left looks like noise")
    return printable(f"checked on {pairs[0][1].n} {where}: {', '.join(parts)}")


def offset(equation: Equation) -> Iterator[str]:
    """A hint if a law with a nonlinear spring is odd in the motion but for its constant: of the input, perhaps."""
    names, shown = equation.chain.names, [term for term in equation.terms if term.text in equation.shown]
    driven = [term.text for term in shown if not term.names <= set(names)]
    own = [term for term in shown if term.text not in driven]
    bent = any(term.names == {names[0]} and term.text != names[0] for term in own)
    if equation.chain.order != 2 or not equation.intercept_matters or not bent or len(driven) != 1:
        return
    motion = dict(zip(names, np.array([[0.7, -1.3, 2.1], [-0.4, 1.1, 0.6], [0.3, 0.9, -0.8]]), strict=True))
    back = {name: -column for name, column in motion.items()}
    if driven[0].isidentifier() and np.allclose(evaluate_terms(own, motion), -evaluate_terms(own, back)):
        size = -equation.shown_model.intercept / equation.shown_coef[driven[0]]
        remedy = f"--remove-offset {driven[0]}={size:.4g}"
        yield f"but for the constant the law is odd: {driven[0]} may have an offset: {remedy}"


def failed(equation: Equation) -> Iterator[str]:
    """Diagnostics that fail, and what to do."""
    found = equation.residuals
    # residuals of a static law hold the noise of its inputs, which varies with the slope: their tails are heavy anyway
    clipped = CLIPPED in str(equation.verdict)
    if found.normality < text.DOUBTFUL and found.kurtosis > 0.0 and not (equation.chain.static or clipped):
        yield "what is left has heavy tails: try --tails student"
    driver = text.followed(equation)
    if driver is not None:
        late = "" if equation.chain.discrete else f", or it is late: --lag-sd {driver.name}=SECONDS learns that"
        yield printable(f"what is left follows {driver.name}: a term with it may be missing{late}")
    yield from map(printable, (*text.forms_of(equation), *equation.at_ends))
    for left in equation.left_out:
        yield printable(f"likely, but left out ({left.reason}): {left.name}, probability {left.pip:.3f}")


def copies(eq: Answer) -> list[str]:
    """A line on the first candidate equal to a term shown on the record but not elsewhere, and the number of others."""
    shown, found = {name for one in eq.equations for name in one.shown}, list[str]()
    for left in eq.dropped:
        own = next((name for name in shown if left.reason == COPY.format(name)), None)
        if own is None:
            continue
        terms = [parse(left.name), parse(own)]
        names = sorted(terms[0].names | terms[1].names)
        columns = {name: np.cos((1.3 + k) * np.arange(1.0, 20.0)) for k, name in enumerate(names)}
        with np.errstate(all="ignore"):
            values = evaluate_terms(terms, columns)
            first, second = (values - values.mean(axis=0)).T
        if not abs(first @ second) > (1.0 - 1e-9) * np.linalg.norm(first) * np.linalg.norm(second):
            found.append(f"{left.name} is the same as {own} on this record: either may be right beyond it")
    return [f"{found[0]}; {len(found) - 1} more such terms{ADVICE}"] if len(found) > 1 else found


# Candidates that are not in the equation are listed up to this many.
MOST_OTHERS = 10

HEADER = ("term", "coefficient", "sd", "95 % interval")
PARAMETERS = ("parameter", "value", "95 % interval", "unit", "meaning")


def plot_terms(eq: Answer, ax: Any = None) -> list[Axes]:
    """Inclusion probabilities, coefficients and intervals, an equation in each of the axes."""
    bars = {
        equation.target: [
            (row.name, row.pip, f"{row.coefficient}  ({row.interval})" if row.coefficient else "")
            for row in _listed(equation)
        ]
        for equation in eq.equations
    }
    return draw_terms(bars, ENGINES[eq.method].score, ax)


def _listed(equation: Equation) -> list[text.Row]:
    """Terms of the equation, then the likeliest others."""
    *rows, _ = text.rows_of(equation)
    others = sorted((row for row in rows if row.absent and row.pip >= NOTEWORTHY_PIP), key=lambda row: -row.pip)
    return [*(row for row in rows if row.coefficient and row.score), *others[:MOST_OTHERS]]


def as_html(eq: Answer) -> str:
    """HTML for a notebook: the verdict, each equation and its terms, physical parameters, checks and warnings."""
    parts = [paragraph(f"verdict: {eq.verdict.kind}: {sentence(eq)}", strong=True)]
    header = (*HEADER, ENGINES[eq.method].score, "unit")
    for equation in eq.equations:
        terms = [
            (row.name, row.coefficient or "not in it", row.sd, row.marked, row.score, row.unit)
            for row in _listed(equation)
        ]
        if equation.intercept_matters:
            constant = text.rows_of(equation)[-1]
            terms.append(("1", constant.coefficient, constant.sd, constant.marked, "", constant.unit))
        width = len(header) if any(row[-1] for row in terms) else len(header) - 1
        parts += [code(equation.text), table(header[:width], [row[:width] for row in terms])]
    physical = own_parameters(eq)
    if physical is not None:
        law = law_in_symbols(eq, physical)
        parts += [*([] if law is None else [code(law)]), table(PARAMETERS, tabled_parameters(physical), (0, 4))]
        parts += [paragraph(physical.note)] if physical.note else []
    if any(one.printed_over_models.any() for one in eq.equations):
        parts.append(paragraph(f"{text.MARK} {text.OVER_MODELS}"))
    return join(*parts, paragraph(checks(eq)), items([f"warning: {message}" for message in eq.warnings]))
