"""The report as one HTML page."""

from __future__ import annotations

import base64
import hashlib
import shlex
import warnings
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version
from pathlib import Path

from bayeq.equation.answer import Answer
from bayeq.equation.report import sections
from bayeq.equation.report.interactive import require_bokeh
from bayeq.equation.report.look import STYLE
from bayeq.equation.report.pictures import pictures
from bayeq.errors import BayeqWarning, InputError
from bayeq.figures.style import require_matplotlib
from bayeq.inference.engines import ENGINES
from bayeq.records import Record
from bayeq.records.files import replacing

__all__ = ["file_hash", "repeat_command", "require_report", "samples_hash", "write_report"]

# The section that the pictures go into.
PICTURES = "pictures"

# Draws the live pictures one after the other, and shows them instead of the still ones once all are there.
START = """
window.addEventListener("DOMContentLoaded", async () => {
  const page = document.documentElement;
  page.classList.add("scripted");
  try {
    let drawn = 0;
    for (const script of document.querySelectorAll("script.plot")) {
      await Bokeh.embed.embed_item(JSON.parse(script.textContent), script.dataset.at);
      page.dataset.drawn = ++drawn;
    }
  } catch (error) {
    page.classList.remove("scripted");
    throw error;
  }
});
"""


def require_report() -> None:
    """Check that a report can be made, before anything is computed for it.

    Raises
    ------
    MissingExtraError
        matplotlib or Bokeh is not installed.
    """
    require_matplotlib()
    require_bokeh()


def write_report(
    path: Path, eq: Answer, records: Sequence[Record], files: Sequence[Path], command: str | None = None
) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
        Replaced whole, or not at all.
    eq : Equations
        The answer.
    records : sequence of Record
        Pictures are of the first; none for pictures of the equations alone.
    files : sequence of Path
        That the records were read from; hashes are those of the records where none are given.
    command : str, optional
        That gives the answer again; by default one is made of what the equations know.

    Raises
    ------
    InputError
        A file cannot be read, or the page not be written.
    MissingExtraError
        matplotlib or Bokeh is not installed.
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
    """The text of the page."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)  # they are in the page already
        made, reasons = pictures(eq, records[0] if records else None)
    body = _body(eq, digests, command or repeat_command(eq), complete=command is not None)
    figures = "".join(picture.html(k) for k, picture in enumerate(made))
    of = f" of {escape(records[0].name)}" if len(records) > 1 and records[0].name else ""
    body[PICTURES] = f'<h2>Pictures{of}</h2><div class="pictures">{figures}</div>{sections.items(reasons)}'
    title = f"Equation of motion: {', '.join(one.target for one in eq.equations)}"
    scripts = [_library(), START] if any(picture.live for picture in made) else []
    return _document(title, "".join(body.values()), scripts)


def _body(eq: Answer, digests: Mapping[str, str], command: str, complete: bool) -> dict[str, str]:
    """Sections in their order; that of the pictures is still empty."""
    score = ENGINES[eq.method].score
    equations = []
    for one in eq.equations:
        heading = f"<h3>{escape(one.target)}</h3>" if len(eq.equations) > 1 else ""
        own = f"<p>Verdict: {escape(str(one.verdict))}</p>" if heading else ""
        equations.append(heading + own + sections.equation(one) + sections.terms(one, score))
    said = sections.items(eq.warnings) if eq.warnings else "<p>There are none.</p>"
    caution = (
        "" if complete else '<p class="note">Options about reading the file, and limits and seeds, are not in it.</p>'
    )
    return {
        "verdict": sections.verdict(eq),
        "equations": f"<h2>Equation{'s' * (len(equations) > 1)}</h2>{''.join(equations)}",
        "warnings": f"<h2>Warnings</h2>{said}",
        PICTURES: "",
        "words": f"<h2>What this says</h2>{sections.words(eq)}",
        "data": f"<h2>Data and settings</h2>{sections.data(eq)}{sections.hashes(digests)}",
        "again": f"<h2>To repeat it</h2><pre>{escape(command)}</pre>{caution}",
    }


def _document(title: str, body: str, scripts: Sequence[str]) -> str:
    """The page: its policy lets these scripts run, by their hashes, and nothing be loaded."""
    allowed = " ".join(f"'sha256-{_digest(script)}'" for script in scripts) or "'none'"
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:;"
        " base-uri 'none'; form-action 'none'"
    )
    run = "".join(f"<script>{script}</script>" for script in scripts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="referrer" content="no-referrer"><link rel="icon" href="data:,">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body><main><h1>{escape(title)}</h1>\n{body}"
        f'</main><footer class="note"><p>Made by bayeq {escape(version("bayeq"))}.</p></footer>\n{run}</body></html>\n'
    )


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
        words += ["--chain", str(chain)]
    for name in eq.inputs:
        words += ["--input", name]
    words += ["--dictionary", eq.dictionary, "--method", eq.method, "--smooth", eq.smooth]
    for constraint in eq.constraints:
        words += ["--constraint", constraint]
    for name, sd in eq.data.sensors.noise.items():
        words += ["--noise", f"{name}={sd:.6g}"]
    for name, sd in eq.data.sensors.gain_sd.items():
        words += ["--gain-sd", f"{name}={sd:.6g}"]
    if eq.data.sensors.tails != "gauss":
        words += ["--tails", eq.data.sensors.tails]
    if eq.data.band is not None:
        words += ["--band", "{:g}:{:g}".format(*eq.data.band)]
    if eq.refined is not None:
        words.append("--refine")
    return shlex.join(words)
