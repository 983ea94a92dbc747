"""Pieces of the report, each from one part of the answer. Whatever comes from files or users is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation, round_to
from bayeq.equation.explain import VERDICTS, explanation
from bayeq.equation.size_path import percent
from bayeq.equation.text import NOTEWORTHY_PIP
from bayeq.expressions.mathml import mathml, number_mathml, symbol_mathml
from bayeq.figures.picture import unit_text
from bayeq.forecast.results import percentages
from bayeq.inference.engines import ENGINES

__all__ = ["data", "equation", "hashes", "items", "terms", "verdict", "words"]

LOOKS = {"none": "none", "found": ""}


def verdict(eq: Answer) -> str:
    """The verdict, and what it means."""
    kind = eq.verdict.kind
    return (
        f'<div class="verdict {LOOKS.get(kind, "doubt")}"><p><strong>Verdict: {escape(kind)}</strong></p>'
        f"<p>{escape(eq.verdict.reason)}</p><p>{escape(VERDICTS[kind].capitalize())}.</p></div>"
    )


def equation(one: Equation) -> str:
    """An equation in maths, a piece for each term so that it breaks between them, and as text."""
    chain = one.chain
    names = {name: symbol_mathml(chain.names[0], dots) for dots, name in enumerate(chain.names)}
    p = one.shown_posterior
    pieces = [f"<mrow>{names[one.target]}<mo>=</mo></mrow>"]
    numbers = [
        (float(p.coef[j]), float(p.sd[j]), mathml(one.terms[j], names, factor=True)) for j in np.flatnonzero(p.support)
    ]
    if one.intercept_matters:
        numbers.append((p.intercept, p.intercept_sd, ""))
    for k, (value, sd, term) in enumerate(numbers):
        text = round_to(value, sd)
        sign = "\N{MINUS SIGN}" if text.startswith("-") else "+" if k else ""
        form = 'form="prefix"' if not k else 'form="infix"'
        front = f"<mo {form}>{sign}</mo>" if sign else ""
        pieces.append(
            f"<mrow>{front}{number_mathml(text.removeprefix('-'))}<mspace width='0.17em'></mspace>{term}</mrow>"
        )
    if not numbers:
        pieces.append("<mn>0</mn>")
    set_in_maths = "".join(f"<math>{piece}</math> " for piece in pieces)
    called = [
        f"<math>{names[name]}</math> is {escape(name)}"
        for k, name in enumerate(chain.names)
        if k and name != "d" * k + chain.names[0]
    ]
    note = f'<p class="note">{", ".join(called)}</p>' if called else ""
    return f'<p class="equation">{set_in_maths}</p>{note}<pre>{escape(one.text)}</pre>'


def terms(one: Equation, score: str) -> str:
    """The table of terms: those of the equation, the likeliest others, and the intercept."""
    p, shown, ci = one.posterior, one.shown_posterior, one.printed_ci95
    share = np.full(len(one.terms), np.nan) if one.share is None else one.share
    rows: list[tuple[str, ...]] = []
    absent = []
    for j, term in enumerate(one.terms):
        pip = f"{p.pip[j]:.3f}"
        if shown.support[j]:
            low, high = (round_to(end, shown.sd[j]) for end in ci[j])
            value = round_to(shown.coef[j], shown.sd[j])
            part = percent(share[j]) if np.isfinite(share[j]) else ""
            spread = f"{shown.sd[j]:.2g}"
            rows.append((term.text, value, spread, f"{low} … {high}", pip, part, unit_text(one.coef_units[j] or "")))
        elif p.support[j] or p.pip[j] >= NOTEWORTHY_PIP:
            absent.append(len(rows))
            rows.append((term.text, "not shown" if p.support[j] else "not included", "", "", pip, "", ""))
    estimate, sd = one.intercept_estimate
    low, high = (round_to(end, sd) for end in one.printed_intercept_ci95)
    spread, unit = f"{sd:.2g}", one.units.get(one.target, "")
    rows.append(("intercept", round_to(estimate, sd), spread, f"{low} … {high}", "", "", unit_text(unit)))
    header = ("term", "coefficient", "sd", "95 % interval", score, "share", "unit")
    rest = len(one.terms) - len(rows) + 1
    more = f'<p class="note">{rest} more candidates are not included, each with less than {NOTEWORTHY_PIP:g}.</p>'
    return _table(header, rows, absent) + (more if rest else "")


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], absent: Sequence[int] = ()) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    lines = []
    for k, row in enumerate(rows):
        cells = "".join(
            f"<td>{escape(cell.replace('-', chr(0x2212)) if i in (1, 3) else cell)}</td>" for i, cell in enumerate(row)
        )
        lines.append(f"<tr{' class=absent' if k in absent else ''}>{cells}</tr>")
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def words(eq: Answer) -> str:
    """What is shown, explained with its own numbers."""
    _, _, *paragraphs = explanation(eq).split("\n\n")
    lines = (" ".join(paragraph.split()) for paragraph in paragraphs)
    return "".join(f"<p>{escape(line)}</p>" for line in lines if not line.startswith("warnings:"))


def items(texts: Sequence[str]) -> str:
    """A list; nothing of none."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>" if texts else ""


def hashes(digests: Mapping[str, str]) -> str:
    """What was read, and its SHA-256."""
    rows = "".join(f"<dt>{escape(name)}</dt><dd><code>{escape(digest)}</code></dd>" for name, digest in digests.items())
    return f"<h3>SHA-256</h3><dl>{rows}</dl>" if rows else ""


def data(eq: Answer) -> str:
    """Data and settings."""
    source, known = eq.data, eq.data.sensors
    rows = {
        "records": ", ".join(name for name in source.files if name) or "not named",
        "rows": f"{source.n}, {source.n_train} used, {source.n_held_out} held out"
        + (", then all used" if source.refitted else ""),
        "sampling": "time not known, rows counted" if source.rows_as_time else _rate(source.fs, source.seconds),
        "chains": ", ".join(str(chain) for chain in eq.chains),
        "inputs": ", ".join(eq.inputs),
        "dictionary": eq.dictionary,
        "method": ENGINES[eq.method].title,
        "smoothing": eq.smooth,
        "band": "" if source.band is None else f"{source.band[0]:g} to {source.band[1]:g} Hz",
        "estimated": ", ".join(source.estimated),
        "noise given": ", ".join(f"{name} {sd:.3g}" for name, sd in known.noise.items()),
        "calibration": ", ".join(f"{name} {100 * sd:.3g} %" for name, sd in known.gain_sd.items()),
        "tails": "" if known.tails == "gauss" else known.tails,
        "constraints": "; ".join(eq.constraints),
        "refined": "" if eq.refined is None else str(eq.refined),
        "left out": "; ".join(f"{term.name}: {term.reason}" for term in eq.dropped),
        "one step": "" if eq.scores is None else f"normalised RMS error {percentages(eq.scores.one_step)}",
        "free run": "" if eq.scores is None else f"normalised RMS error {percentages(eq.scores.free_run)}",
    }
    return f"<dl>{''.join(f'<dt>{escape(k)}</dt><dd>{escape(v)}</dd>' for k, v in rows.items() if v)}</dl>"


def _rate(fs: float | None, seconds: float | None) -> str:
    return "" if fs is None else f"{fs:.6g} Hz" + (f", {seconds:.4g} s in all" if seconds is not None else "")
