"""The report as one HTML page: what `page.html` is filled with. Every text is escaped there but for maths."""

from __future__ import annotations

import base64
import hashlib
import shlex
import warnings
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bayeq.equation.answer import Answer
from bayeq.equation.brief import checks, failed, law_in_symbols, sentence, tabled_parameters, what_to_try
from bayeq.equation.equation import Equation
from bayeq.equation.explain import explanation
from bayeq.equation.oscillator import own_parameters
from bayeq.equation.report.pictures import pictures, require_bokeh
from bayeq.equation.rows import Row, rows_of
from bayeq.equation.text import MARK, unseen
from bayeq.equation.written import round_to
from bayeq.errors import BayeqWarning, InputError
from bayeq.expressions.parse import EARLIER
from bayeq.expressions.symbolic import mathml, number_mathml, step_mathml, symbol_mathml
from bayeq.figures.picture import unit_text
from bayeq.figures.style import require_matplotlib
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.records import Record
from bayeq.records.files import replacing
from bayeq.regression.constraints import CONSERVED

HERE = Path(__file__).parent
STYLE = (HERE / "page.css").read_text(encoding="utf-8")
# Draws the live pictures one after the other, and shows them instead of the still ones once all are there.
START = (HERE / "page.js").read_text(encoding="utf-8")


def require_report() -> None:
    """Check that a report can be made, before anything is computed for it; MissingExtraError without matplotlib or
    Bokeh.
    """
    require_matplotlib()
    require_bokeh()


def write_report(
    path: Path, eq: Answer, records: Sequence[Record], files: Sequence[Path], command: str | None = None
) -> None:
    """Write the page, which is replaced whole, or not at all.

    Pictures are of the first record; without records, of the equations alone. Hashes are those of the files that the
    records were read from, or of the records where none are given. The command gives the answer again; by default one
    is made of what the equations know.

    InputError if a file cannot be read, or the page not be written; MissingExtraError without matplotlib or Bokeh.
    """
    require_report()
    try:
        digests = {file.name: file_hash(file) for file in files}
        digests |= {f"samples of {one.name or 'the record'}": samples_hash(one) for one in records if not files}
        text = _page(eq, records, digests, command)
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{error.filename or path}: {error.strerror or error}") from error


def _page(eq: Answer, records: Sequence[Record], digests: Mapping[str, str], command: str | None) -> str:
    """The text of the page; its policy lets its own scripts run, by their hashes, and nothing be loaded."""
    from jinja2 import Environment, FileSystemLoader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)  # they are in the page already
        made, reasons = pictures(eq, records[0] if records else None)
    scripts = [_library(), START] if any(picture.live for picture in made) else []
    allowed = " ".join(f"'sha256-{_digest(script)}'" for script in scripts) or "'none'"
    environment = Environment(loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template("page.html").render(
        title=f"Equation of motion: {', '.join(one.target for one in eq.equations)}",
        policy=f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:;"
        " font-src data:; base-uri 'none'; form-action 'none'",
        style=STYLE,
        verdict=eq.verdict,
        reason=sentence(eq) if eq.verdict.kind != "none" else what_to_try(eq),
        several=len(eq.equations) > 1,
        physical=_physical(eq),
        equations=[_equation(one, eq) for one in eq.equations],
        header=("term", "coefficient", "sd", "95 % interval", ENGINES[eq.method].score, "share", "unit"),
        noteworthy=f"{NOTEWORTHY_PIP:g}",
        warnings=eq.warnings,
        of=f" of {records[0].name}" if len(records) > 1 and records[0].name else "",
        pictures=made,
        reasons=reasons,
        words=_words(eq) if eq.verdict.kind != "none" else [],
        data=_data(eq),
        digests=digests,
        command=command or repeat_command(eq),
        complete=command is not None,
        version=version("bayeq"),
        scripts=scripts,
    )


def _physical(eq: Answer) -> dict[str, Any] | None:
    """The law in physical parameters, and these with their meanings."""
    found = own_parameters(eq)
    if found is None:
        return None
    cells = tabled_parameters(found)
    rows = [(name, _typeset(mean), _typeset(ends), unit_text(unit), why) for name, mean, ends, unit, why in cells]
    return {"law": law_in_symbols(eq, found), "rows": rows, "also": ", ".join(found.unexplained)}


def _typeset(number: str) -> str:
    return number.replace(" .. ", " … ").replace("-", "\N{MINUS SIGN}")


def _equation(one: Equation, eq: Answer) -> dict[str, Any]:
    """An equation as maths and text, with its terms and checks."""
    if one.chain.discrete:
        names = {name: step_mathml(name) for name in (*eq.states, *eq.inputs, one.target)}
    else:
        names = {name: symbol_mathml(one.chain.names[0], dots) for dots, name in enumerate(one.chain.names)}
    rows = rows_of(one)
    return {
        "target": one.target,
        "verdict": str(one.verdict) if len({other.verdict.kind for other in eq.equations}) > 1 else "",
        "none": one.verdict.kind == "none",
        "checks": [*([checks(eq)] if one is eq.equations[0] else []), *failed(one), *unseen(one)],
        "starred": any(row.over_models for row in rows),
        "maths": _maths(one, names),
        "symbols": {
            name: names[name]
            for k, name in enumerate(one.chain.names)
            if k and name != "d" * k + one.chain.names[0] and not one.chain.discrete
        },
        "text": one.text,
        "rows": list(map(_cells, rows)),
        "rest": len(one.terms) - sum(bool(row.score) for row in rows),
    }


def _maths(one: Equation, names: Mapping[str, str]) -> str:
    """An equation as MathML, a piece for each term so that it breaks between them."""
    pieces = [f"<mrow>{names[one.target]}<mo>=</mo></mrow>"]
    for k, (value, sd, term) in enumerate(one.summands):
        text = round_to(value, sd)
        sign = "\N{MINUS SIGN}" if text.startswith("-") else "+" if k else ""
        form = 'form="prefix"' if not k else 'form="infix"'
        front = f"<mo {form}>{sign}</mo>" if sign else ""
        factor = "" if term is None else mathml(term, names, factor=True)
        number = number_mathml(text.removeprefix("-"))
        pieces.append(f"<mrow>{front}{number}<mspace width='0.17em'></mspace>{factor}</mrow>")
    if not one.summands:
        pieces.append("<mn>0</mn>")
    return "".join(f"<math>{piece}</math> " for piece in pieces)


def _cells(row: Row) -> tuple[str, ...]:
    """A row of the table of terms, its interval marked where that is over models."""
    interval = _typeset(row.interval) + f" {MARK}" * row.over_models
    coefficient = _typeset(row.coefficient) or row.absent
    return row.name, coefficient, row.sd, interval, row.score, row.share, unit_text(row.unit)


def _words(eq: Answer) -> list[str]:
    """What is shown, explained with its own numbers; marks and bounds are explained where they stand."""
    _, _, *paragraphs = explanation(eq).split("\n\n")
    lines = (" ".join(paragraph.split()) for paragraph in paragraphs)
    return [line for line in lines if not line.startswith(("warnings:", f"{MARK}:", "not determined by"))]


def _data(eq: Answer) -> dict[str, str]:
    """Data and settings; what is empty is not shown."""
    source, known = eq.data, eq.data.sensors
    return {
        "records": ", ".join(name for name in source.files if name) or "not named",
        "rows": f"{source.n}, {source.n_train} used, {source.n_held_out} held out{_checked(eq)}"
        + (", then all used" if source.refitted else ""),
        "sampling": _sampling(eq),
        "chains": ", ".join(str(chain) for chain in eq.chains),
        "inputs": ", ".join(eq.inputs),
        "dictionary": eq.dictionary,
        "method": ENGINES[eq.method].title,
        "smoothing": eq.smooth,
        "band": "" if source.band is None else f"{source.band[0]:g} to {source.band[1]:g} Hz",
        "estimated": ", ".join(source.estimated),
        "noise given": ", ".join(f"{name} {sd:.3g}" for name, sd in known.noise.items()),
        "calibration": ", ".join(f"{name} {100 * sd:.3g} %" for name, sd in known.gain_sd.items()),
        "lags": ", ".join(f"{name} {lag}" for name, lag in known.lags.items()),
        "tails": "" if known.tails == "gauss" else known.tails,
        "constraints": "; ".join(eq.constraints),
        "refined": "" if eq.refined is None else str(eq.refined),
        "left out": "; ".join(f"{term.name}: {term.reason}" for term in eq.dropped),
    }


def _checked(eq: Answer) -> str:
    """How many of the rows held out the checks are of, where they are not all: those with all channels, and no ends."""
    counts = {one.held_out.n for one in eq.equations if one.held_out is not None}
    return f", checked on {max(counts)} of these" if counts and max(counts) != eq.data.n_held_out else ""


def _sampling(eq: Answer) -> str:
    """How the records were sampled, as far as known."""
    if eq.roles.discrete:
        return "counted in samples"
    if eq.data.rows_as_time:
        return "time not known, rows counted"
    seconds = "" if eq.data.seconds is None else f", {eq.data.seconds:.4g} s in all"
    return "" if eq.data.fs is None else f"{eq.data.fs:.6g} Hz{seconds}"


def _library() -> str:
    """Bokeh's script, without what would end the element that it stands in."""
    from bokeh.resources import Resources

    scripts = Resources(mode="inline", components=["bokeh"]).js_raw
    library = [text for text in scripts if not text.startswith("Bokeh.set_log_level")]  # which writes to the console
    return "\n".join(library).replace("</script", "<\\/script")


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def samples_hash(record: Record) -> str:
    """SHA-256 of a record, hexadecimal: time, then each channel, its name and its numbers (8 bytes, little-endian)."""
    digest = hashlib.sha256()
    columns = {} if record.time is None else {"t": record.time}
    for name, values in (*columns.items(), *record.channels.items()):
        digest.update(name.encode("utf-8"))
        digest.update(values.astype("<f8").tobytes())
    return digest.hexdigest()


def repeat_command(eq: Answer) -> str:
    """A command that finds the equations again, from what they know of how they were found."""
    words = ["bayeq", "discover", *(name or "FILE" for name in eq.data.files)]
    for chain in eq.chains:
        text = str(chain.measured[-2]) if chain.discrete else str(chain)
        words += ["--target", chain.target] if chain.static else ["--chain", text]
    words += ["--discrete"] * eq.roles.discrete
    for name in eq.inputs:
        if not EARLIER.fullmatch(name):  # which terms ask for
            words += ["--input", name]
    words += ["--dictionary", eq.dictionary, "--method", eq.method, "--smooth", eq.smooth]
    for constraint in eq.constraints:
        conserved = constraint.endswith(CONSERVED)
        words += ["--conserve" if conserved else "--constraint", constraint.removesuffix(CONSERVED)]
    readings = eq.data.sensors.of_reading
    for name, share in readings.items():
        words += ["--noise", f"{name}={f'{100 * share:.6g}' if share else ''}% of reading"]
    for name, sd in eq.data.sensors.noise.items():
        if name not in readings and not EARLIER.fullmatch(name):
            words += ["--noise", f"{name}={sd:.6g}"]
    for name, sd in eq.data.sensors.gain_sd.items():
        words += ["--gain-sd", f"{name}={sd:.6g}"]
    for name, lag in eq.data.sensors.lags.items():
        words += ["--lag-sd", f"{name}={lag.prior_sd:.6g}"]
    if eq.data.sensors.tails != "gauss":
        words += ["--tails", eq.data.sensors.tails]
    if eq.data.band is not None:
        words += ["--band", "{:g}:{:g}".format(*eq.data.band)]
    if eq.refined is not None:
        words.append("--refine")
    return shlex.join(words)
