"""The steps of the page: file, channels, terms, discovery, result. Texts from files are set as text, never as HTML."""

from __future__ import annotations

import shlex
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from bayeq.app.choices import EQUATION, INPUT, RATE, READING, REPORT, ROLES
from bayeq.app.session import LARGEST, LOOKING, Session, safe_name
from bayeq.equation.report.page import STYLE
from bayeq.errors import InputError

# Makes a frame as high as what is in it, also when that grows.
FIT = """(event) => {
  const frame = event.target, page = frame.contentDocument;
  const fit = () => { frame.style.height = page.documentElement.offsetHeight + "px"; };
  fit();
  new ResizeObserver(fit).observe(page.documentElement);
}"""

# Content of the box that files are dropped into, a template of the framework.
DROP = """<div class="drop-words"><span>{words}</span>
  <q-btn no-caps {look} color="primary" label="{label}" @click="props.pickFiles">
    <q-uploader-add-trigger></q-uploader-add-trigger>
  </q-btn>
</div>"""
FORMATS = "CSV, Excel, MATLAB, HDF5, Parquet, LabVIEW, universal files, WAV and others"

SIZE = f"{LARGEST // 1_000_000} MB"

# Channels offered on the page, at most.
MOST_CHANNELS = 60

# Coordinates offered on the page, at most.
MOST_COORDINATES = 9

CONSTRAINTS_HINT = "what is known of coefficients, one in a line, by the names of terms: u == 1, v <= 0"
TERMS_HINT = (
    "oscillator, polynomial:3, or terms in the names of the channels: x, v, x**3, v*abs(v), sign(v), u;"
    " {v0} is an unknown constant inside a term, tanh(v/{v0})"
)


BLUE, RED = "#0072B2", "#B00020"


def build(session: Session) -> None:
    """Build the page from the state of the session."""
    ui.add_css(STYLE + Path(__file__).with_name("page.css").read_text(encoding="utf-8"))
    ui.colors(primary=BLUE, negative=RED)
    with ui.element("div"):  # the framework puts it into the main element
        ui.html("bayeq", tag="h1", sanitize=False)
        text(
            "From a measured motion to the equation that governs it, and how certain that equation is. Everything is"
            " computed on this computer; no data leave it.",
            "lead",
        )
        heading(1, "Measured file")
        file_step(session)
        choice_steps(session)
        result_step(session)


def refresh(*changed: str) -> None:
    """Redraw the parts of the page that have changed: "file", "command", "run", "result", "progress"."""
    shown = {
        "file": (file_step, choice_steps),
        "command": (command_step,),
        "run": (file_step, run_status),
        "result": (result_step,),
        "progress": (run_status,),
    }
    for step in dict.fromkeys(step for part in changed for step in shown[part]):
        step.refresh()


@ui.refreshable
def file_step(session: Session) -> None:
    """Choose a file, and see what is in it."""

    async def opened(path: Path) -> None:
        await session.open(path, path.name)

    async def added(path: Path) -> None:
        session.further.append(path)
        refresh("file")

    if session.busy == LOOKING:
        text("Another file can be opened when this is done or stopped.", "note")
    elif session.busy:
        with ui.element("div").classes("buttons").props("aria-live=polite"):
            text(f"{session.busy.capitalize()} ...", "note")
            stop_button(session)
    else:
        words = f"Drop a measured file here, up to {SIZE}: {FORMATS}."
        _upload(session, opened, words=words, label="Choose a file", look="unelevated")
    if session.file_error:
        message(session.file_error, "error")
        text(
            "A file that needs more to be read, such as paths of its arrays, is read on the command line:"
            " bayeq discover -h.",
            "note",
        )
        if session.opened is not None:
            text(f"{session.opened.name} is still open.", "note")
    if session.opened is not None:
        text(f"{session.opened.name}: {in_a_line(session.opened.info)}")
        bullets(session.opened.info["findings"])
        if session.busy:
            return
        with ui.expansion("How it is read, and further records", value=bool(session.further)).classes("more"):
            with ui.element("div").classes("fields"):
                for option, label in READING.items():
                    text_field(label, "", session.choices.reading, option)
                again = ui.button("Read again", on_click=lambda: background_tasks.create(session.read_again()))
                again.props("no-caps outline")
            for path in session.further:
                with ui.element("div").classes("buttons"):
                    text(path.name, tag="span")
                    ui.button("Leave out", on_click=partial(session.drop, path)).props("no-caps flat dense")
            words = "Add a record of the same channels: another run, of which the same equation is expected."
            _upload(session, added, words=words, label="Add a record", look="outline")


def _upload(session: Session, use: Callable[[Path], Awaitable[None]], **said: str) -> None:
    """A box that files are dropped into; each file is saved in the workspace and passed to `use`."""

    def refused(words: str) -> None:
        session.file_error = words
        refresh("file")

    async def arrived(event: Any) -> None:
        try:
            path = session.workspace.new_folder() / safe_name(event.file.name)
            await event.file.save(path)
        except OSError as error:
            refused(f"the file cannot be kept in the folder for temporary files: {error.strerror or error}")
        else:
            await use(path)

    upload = ui.upload(
        on_upload=arrived,
        on_rejected=lambda: refused(f"the file is larger than {SIZE}: open it where it is, by bayeq app FILE"),
        max_file_size=LARGEST,
        auto_upload=True,
    )
    upload.props("flat").classes("drop")
    upload.add_slot("header", DROP.format(**said))
    upload.on("failed", lambda: refused(f"the file did not arrive: is it larger than {SIZE}, or was it moved?"))


@ui.refreshable
def choice_steps(session: Session) -> None:
    """Roles of channels, candidate terms and the Discover button; without a file, a button for an example."""
    if session.opened is None:
        text(
            "A file has a column for each channel, such as displacement, velocity, acceleration and force, and one for"
            " time. Next you say which is which, press Discover, and read the equation.",
            "note",
        )
        example = ui.button("Open an example", on_click=lambda: background_tasks.create(session.open_example()))
        example.props("no-caps outline").bind_enabled_from(session, "busy", lambda busy: not busy)
        return
    heading(2, "What each channel is")
    text(
        "Roles are proposed from names, units and the motion itself: change what is wrong. A unit replaces that of the"
        " file; an offset, a number or the word mean, is subtracted.",
        "note",
    )
    several = any(choice.coordinate > 1 or choice.role == RATE for choice in session.choices.roles.values())
    channels(session, several)
    heading(3, "What may be in the equation")
    with ui.element("div").classes("fields"):
        text_field("Candidate terms", TERMS_HINT, session.choices, "dictionary").classes("whole")
        text_field("Rows, A:B (optional)", "0:2000 are the first 2000", session.choices, "rows")
        text_field("Band, LO:HI in Hz (optional)", "frequencies to fit, as in 0.5:40", session.choices, "band")
        if session.opened.info["time"]["fs"] is None or session.choices.fs:
            text_field("Sampling rate in Hz", "as there is no time in the file", session.choices, "fs")
        known = ui.textarea("Constraints (optional)").classes("whole")
        known.props(f'outlined dense autogrow rows=1 spellcheck=false hint="{CONSTRAINTS_HINT}"')
        known.bind_value(session.choices, "constraints").on_value_change(command_step.refresh)
    heading(4, "Discover")
    command_step(session)
    with ui.element("div").classes("buttons"):
        start = ui.button("Discover", on_click=lambda: background_tasks.create(session.discover()))
        start.props("no-caps unelevated").bind_enabled_from(session, "busy", lambda busy: not busy)
        stop_button(session).bind_visibility_from(session, "busy", lambda busy: busy == LOOKING)
    run_status(session)


def stop_button(session: Session) -> Any:
    made = ui.button("Stop", on_click=lambda: background_tasks.create(session.stop()))
    return made.props("no-caps outline color=negative")


@ui.refreshable
def channels(session: Session, several: bool) -> None:
    """A row for each channel: name, range of values, role, unit, offset, and its coordinate if there are several."""
    choices = session.choices.roles

    def number(event: Any) -> None:
        if not event.value:
            for choice in choices.values():
                choice.coordinate = 1
        channels.refresh(session, event.value)

    assert session.opened is not None
    found = sorted(session.opened.info["channels"], key=lambda one: not choices[one["name"]].role)
    with ui.element("div").classes("channels several" if several else "channels"):
        for channel in found[:MOST_CHANNELS]:
            name, choice = channel["name"], choices[channel["name"]]
            unit = f" [{channel['unit']}]" if channel["unit"] else ""
            text(name + unit, "channel-name", "div")
            text(_about(channel), "channel-about", "div")
            role = ui.select(ROLES, label=f"Role of {name}").props("outlined dense options-dense").classes("role")
            role.bind_value(choice, "role").on_value_change(command_step.refresh)
            for what in ("unit", "offset"):
                made = text_field(what.capitalize(), "", choice, what)
                made.props["aria-label"] = f"{what.capitalize()} of {name}"  # not by props(): it would parse the name
            if several:
                numbers = list(range(1, max(MOST_COORDINATES, choice.coordinate) + 1))
                made = ui.select(numbers, label="Coordinate").props("outlined dense options-dense")
                made.props["aria-label"] = f"Coordinate of {name}"
                made.bind_value(choice, "coordinate").on_value_change(command_step.refresh)
                made.bind_visibility_from(choice, "role", lambda role: role not in ("", INPUT))
    if len(found) > MOST_CHANNELS:
        message(
            f"The file has {len(found)} channels; the first {MOST_CHANNELS} are offered here. For others, write the"
            " command below in a terminal.",
            "said",
        )
    ui.checkbox("Several coordinates, such as two masses", value=several, on_change=number)


@ui.refreshable
def run_status(session: Session) -> None:
    """Progress of the run, or its outcome."""
    with ui.element("div").props("aria-live=polite"):
        if session.busy == LOOKING:
            ui.linear_progress(show_value=False).props("indeterminate rounded")
            elapsed = ui.label().classes("note")

            def show() -> None:
                elapsed.set_text(f"{session.busy.capitalize()}: {session.seconds():.0f} s")

            show()
            ui.timer(1.0, show, immediate=False)
            bullets(session.progress[-4:])
        if session.run_error:
            message(session.run_error, "error")
        if session.note:
            message(session.note, "said")
        if session.result is not None and (session.run_error or session.stopped):
            text("The result below is that of the run before.", "note")


@ui.refreshable
def command_step(session: Session) -> None:
    """The command for the current choices."""
    try:
        words = shlex.join(["bayeq", *session.words()])
    except InputError as error:
        text(f"Not yet: {error}.", "note")
        return
    text("This is run, and does the same on the command line:", "note")
    command(words)


@ui.refreshable
def result_step(session: Session) -> None:
    """The report, and files to keep."""
    found = session.result
    if found is None:
        return
    heading(5, "Result")
    with ui.element("div").classes("buttons"):
        for words, file in (("Download report", REPORT), ("Download equation (JSON)", EQUATION)):
            link = ui.link(words, f"/{file}?run={found.number}").classes("button-like")
            link.props["download"] = f"{found.name}_{file}"
    text("Change what is above and press Discover to look again.", "note")
    frame = ui.element("iframe").classes("report").props('title="Report: verdict, equation, pictures and warnings"')
    frame.props["src"] = f"/{REPORT}?run={found.number}"
    frame.on("load", js_handler=FIT)


def command(words: str) -> None:
    """A command line, which wraps only between its options."""
    with ui.element("pre").classes("command"):
        for part in words.replace(" --", " \0--").split("\0"):
            text(part, tag="span")


def heading(number: int, title: str) -> None:
    ui.html(f"{number}. {title}", tag="h2", sanitize=False)


def text(words: str, kind: str = "", tag: str = "p") -> Any:
    """A paragraph."""
    element = ui.element(tag).classes(kind)
    with element:
        ui.label(words).style("display: inline")
    return element


def message(words: str, kind: str) -> None:
    """A line that should be seen: an error or a note."""
    with ui.element("div").classes(kind).props("role=alert" if kind == "error" else "role=status"):
        text(words)


def bullets(texts: Sequence[str]) -> None:
    """A list of texts; nothing for no texts."""
    if texts:
        with ui.element("ul"):
            for words in texts:
                text(words, tag="li")


def text_field(label: str, hint: str, target: Any, name: str) -> Any:
    """A labelled text field, bound to an attribute or a key `name` of `target`."""
    said = f'hint="{hint}"' if hint else ""
    made = ui.input(label).props(f"outlined dense spellcheck=false autocomplete=off {said}")
    return made.bind_value(target, name).on_value_change(command_step.refresh)


def in_a_line(info: Mapping[str, Any]) -> str:
    """Rows, sampling and number of channels of a file, in one line."""
    time, count = info["time"], len(info["channels"])
    channels = f"{count} channel{'s' * (count != 1)}"
    if time["fs"] is None:
        return f"{info['rows']} rows, {channels}; no time in the file"
    steps = "at" if time["uniform"] else "at uneven steps, mostly at"
    return f"{info['rows']} rows {steps} {time['fs']:.6g} Hz, {time['duration']:.6g} s; {channels}"


def _about(channel: Mapping[str, Any]) -> str:
    if channel["min"] is None:
        return "no numbers in it"
    if channel["constant"]:
        return f"constant, {channel['min']:.4g}: it says nothing of the motion"
    parts = [f"{channel['min']:.3g} to {channel['max']:.3g}"]
    if channel["missing"]:
        parts.append(f"{channel['missing']} samples missing")
    parts += [f"{kind}: {found['samples']} samples" for kind, found in channel["bad"].items()]
    if channel["why"]:
        parts.append(f"role proposed: {channel['why']}")
    return "; ".join(parts)
