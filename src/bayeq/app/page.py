"""The steps of the page: file, channels, terms, discovery, result."""

from __future__ import annotations

from typing import Any

from nicegui import background_tasks, ui

from bayeq.app import parts
from bayeq.app.look import BLUE, RED, SHEET
from bayeq.app.session import LOOKING, Session
from bayeq.app.workspace import LARGEST, safe_name

__all__ = ["build", "refresh"]

# Makes a frame as high as what is in it, also when that grows.
FIT = """(event) => {
  const frame = event.target, page = frame.contentDocument;
  const fit = () => { frame.style.height = page.documentElement.offsetHeight + "px"; };
  fit();
  new ResizeObserver(fit).observe(page.documentElement);
}"""

# What stands in the box that files are dropped into; the framework compiles it.
DROP = """<div class="drop-words"><span>{words}</span>
  <q-btn no-caps unelevated color="primary" label="Choose a file" @click="props.pickFiles">
    <q-uploader-add-trigger></q-uploader-add-trigger>
  </q-btn>
</div>"""
FORMATS = "CSV, Excel, MATLAB, HDF5, Parquet, LabVIEW, universal files, WAV and others"

TERMS_HINT = "oscillator, polynomial:3, or terms in the names of the channels: x, v, x**3, v*abs(v), sign(v), u"


def build(session: Session) -> None:
    """The page, as it is now."""
    ui.add_css(SHEET)
    ui.colors(primary=BLUE, negative=RED)
    with ui.element("main"):
        ui.html("bayeq", tag="h1", sanitize=False)
        parts.text(
            "From a measured motion to the equation that governs it, with how sure that is. Everything is computed on"
            " this computer; no data leave it.",
            "lead",
        )
        parts.heading(1, "Measured file")
        file_step(session)
        choice_steps(session)
        result_step(session)


def refresh(*changed: str) -> None:
    """Show again what has changed: "file", "run", "result", "progress"."""
    shown = {
        "file": (file_step, choice_steps),
        "run": (file_step, run_status),
        "result": (result_step,),
        "progress": (run_status,),
    }
    for step in dict.fromkeys(step for part in changed for step in shown[part]):
        step.refresh()


@ui.refreshable
def file_step(session: Session) -> None:
    """Choose a file, and see what is in it."""

    async def dropped(event: Any) -> None:
        try:
            path = session.workspace.new_folder() / safe_name(event.file.name)
            await event.file.save(path)
        except OSError as error:
            refused(f"the file cannot be kept in the folder for temporary files: {error.strerror or error}")
        else:
            await session.open(path, path.name)

    def refused(words: str) -> None:
        session.file_error = words
        refresh("file")

    size = f"{LARGEST // 1_000_000} MB"
    if session.busy == LOOKING:
        parts.text("Another file can be opened when this is done or stopped.", "note")
    elif session.busy:
        with ui.element("div").classes("buttons").props("aria-live=polite"):
            parts.text(f"{session.busy.capitalize()} ...", "note")
            stop_button(session)
    else:
        upload = ui.upload(
            on_upload=dropped,
            on_rejected=lambda: refused(f"the file is larger than {size}: open it where it is, by bayeq app FILE"),
            max_file_size=LARGEST,
            auto_upload=True,
        )
        upload.props("flat").classes("drop")
        upload.add_slot("header", DROP.format(words=f"Drop a measured file here, up to {size}: {FORMATS}."))
        upload.on("failed", lambda: refused(f"the file did not arrive: is it larger than {size}, or was it moved?"))
    if session.file_error:
        parts.message(session.file_error, "error")
        parts.text(
            "A file that needs more to be read, such as names of its columns or paths of its arrays, is read on the"
            " command line: bayeq discover -h.",
            "note",
        )
        if session.opened is not None:
            parts.text(f"{session.opened.name} is still open.", "note")
    if session.opened is not None:
        parts.text(f"{session.opened.name}: {parts.summary(session.opened.info)}")
        parts.bullets(session.opened.info["findings"])


@ui.refreshable
def choice_steps(session: Session) -> None:
    """What each channel is, what may be in the equation, and the button that looks for it."""
    if session.opened is None:
        parts.text(
            "A file has a column for each channel, such as displacement, velocity, acceleration and force, and one for"
            " time. Next you say which is which, press Discover, and read the equation.",
            "note",
        )
        example = ui.button("Open an example", on_click=lambda: background_tasks.create(session.open_example()))
        example.props("no-caps outline").bind_enabled_from(session, "busy", lambda busy: not busy)
        return
    parts.heading(2, "What each channel is")
    parts.text("Roles are proposed from names, units and the motion itself. Change what is wrong.", "note")
    channels(session, parts.is_several(session.choices.roles))
    parts.heading(3, "What may be in the equation")
    with ui.element("div").classes("fields"):
        parts.field("Candidate terms", TERMS_HINT, session.choices, "dictionary").classes("whole")
        parts.field("Rows, A:B (optional)", "0:2000 are the first 2000", session.choices, "rows")
        parts.field("Band, LO:HI in Hz (optional)", "frequencies to fit, as in 0.5:40", session.choices, "band")
        if session.opened.info["time"]["fs"] is None or session.choices.fs:
            parts.field("Sampling rate in Hz", "as there is no time in the file", session.choices, "fs")
    parts.heading(4, "Discover")
    with ui.element("div").classes("buttons"):
        start = ui.button("Discover", on_click=lambda: background_tasks.create(session.discover()))
        start.props("no-caps unelevated").bind_enabled_from(session, "busy", lambda busy: not busy)
        stop_button(session).bind_visibility_from(session, "busy", lambda busy: busy == LOOKING)
    run_status(session)


def stop_button(session: Session) -> Any:
    """The button that stops what is being done."""
    made = ui.button("Stop", on_click=lambda: background_tasks.create(session.stop()))
    return made.props("no-caps outline color=negative")


@ui.refreshable
def channels(session: Session, several: bool) -> None:
    """Roles, with numbers of coordinates where there are several."""

    def number(event: Any) -> None:
        if not event.value:
            for choice in session.choices.roles.values():
                choice.coordinate = 1
        channels.refresh(session, event.value)

    assert session.opened is not None
    parts.channel_rows(session.opened.info, session.choices.roles, several)
    ui.checkbox("Several coordinates, such as two masses", value=several, on_change=number)


@ui.refreshable
def run_status(session: Session) -> None:
    """How far it is, or how it ended."""
    with ui.element("div").props("aria-live=polite"):
        if session.busy == LOOKING:
            ui.linear_progress(show_value=False).props("indeterminate rounded")
            elapsed = ui.label().classes("note")

            def show() -> None:
                elapsed.set_text(f"{session.busy.capitalize()}: {session.seconds():.0f} s")

            show()
            ui.timer(1.0, show, immediate=False)
            parts.bullets(session.progress[-4:])
        if session.run_error:
            parts.message(session.run_error, "error")
        if session.note:
            parts.message(session.note, "said")
        if session.result is not None and (session.run_error or session.stopped):
            parts.text("The result below is that of the run before.", "note")
    if session.command:
        parts.text("The same on the command line:", "note")
        parts.command(session.command)


@ui.refreshable
def result_step(session: Session) -> None:
    """The report, and files to keep."""
    found = session.result
    if found is None:
        return
    parts.heading(5, "Result")
    with ui.element("div").classes("buttons"):
        for words, file, ending in (
            ("Download report", "report.html", "report.html"),
            ("Download equation (JSON)", "equation.json", "equation.json"),
        ):
            link = ui.link(words, f"/{file}?run={found.number}").classes("button-like")
            link.props["download"] = f"{found.name}_{ending}"
    parts.text("Change roles, terms, rows or band above and press Discover to look again.", "note")
    frame = ui.element("iframe").classes("report").props('title="Report: verdict, equation, pictures and warnings"')
    frame.props["src"] = f"/report.html?run={found.number}"
    frame.on("load", js_handler=FIT)
