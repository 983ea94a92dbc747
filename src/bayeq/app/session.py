"""What was opened, chosen and found; one for the page, however many windows show it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from bayeq.app.child import Child, Outcome
from bayeq.app.commands import EQUATION, REPORT, Choices, as_typed, discover_command, info_command
from bayeq.app.workspace import Workspace
from bayeq.errors import InputError

__all__ = ["Opened", "Result", "Session"]

_PROGRESS = "bayeq: progress: "


@dataclass(frozen=True, slots=True)
class Opened:
    """A file that is open.

    Attributes
    ----------
    name : str
        What the page calls it.
    path : Path
        Where it is.
    info : dict
        What ``bayeq info --json`` says of it.
    """

    name: str
    path: Path
    info: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Result:
    """What was found.

    Attributes
    ----------
    number : int
        Of the run, counted from 1.
    folder : Path
        That holds the equations and the report.
    name : str
        Of the file, without its ending.
    """

    number: int
    folder: Path
    name: str

    @property
    def equation(self) -> Path:
        """The equations, for `bayeq.load`."""
        return self.folder / EQUATION

    @property
    def report(self) -> Path:
        """The page."""
        return self.folder / REPORT


class Session:
    """The state of the page, and what can be done with it.

    Parameters
    ----------
    workspace : Workspace
        Where files and results are.

    Attributes
    ----------
    changed : callable
        Called with the parts of the page that are no longer right: "file", "run", "result".
    """

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.changed: Callable[..., None] = lambda *parts: None
        self.opened: Opened | None = None
        self.choices = Choices()
        self.result: Result | None = None
        self.busy = ""  # what is being done
        self.began = 0.0
        self.progress: list[str] = []
        self.file_error = self.run_error = self.note = ""
        self.command = ""
        self._child: Child | None = None
        self._runs = 0

    async def open(self, path: Path, name: str) -> None:
        """Look into a file; what was open before stays open if it cannot be read."""
        if self.busy:
            return
        # messages name the file as it is called here
        inside = self.workspace.path in path.parents
        outcome = await self._run("reading the file", info_command(path.name if inside else str(path)), path.parent)
        self.file_error = outcome.error or ("stopped" if outcome.stopped else "")
        if not self.file_error:
            previous, self.opened = self.opened, Opened(name, path, json.loads(outcome.out))
            self.choices = Choices.proposed(self.opened.info)
            self.result, self.run_error, self.note, self.command = None, "", "", ""
            if previous is not None:
                self._forget(previous.path, path)
        elif inside:
            self._forget(path)
        self.changed("file", "run", "result")

    async def discover(self) -> None:
        """Find the equations with what was chosen; an earlier result stays until there is another."""
        if self.busy or self.opened is None:
            return
        self.run_error = self.note = ""
        path = self.opened.path
        inside = self.workspace.path in path.parents
        try:
            words = discover_command(path.name if inside else str(path), self.choices)
        except InputError as error:
            self.run_error = str(error)
            self.changed("run")
            return
        self.command = as_typed(words)
        folder = self.workspace.new_folder()
        if inside:  # a name without folders, also in the report
            (folder / path.name).hardlink_to(path)
        outcome = await self._run("looking for the equation", words, folder)
        if outcome.error or outcome.stopped:
            self.run_error = outcome.error
            self.note = "Stopped. Nothing of this run is kept." if outcome.stopped else ""
            self.workspace.remove(folder)
        else:
            previous, self._runs = self.result, self._runs + 1
            self.result = Result(self._runs, folder, Path(self.opened.name).stem)
            if previous is not None:
                self.workspace.remove(previous.folder)
        self.changed("run", "result")

    async def stop(self) -> None:
        """Stop what is being done."""
        if self._child is not None:
            await self._child.stop()

    def close(self) -> None:
        """End what is being done, and remove all files."""
        if self._child is not None:
            self._child.kill()
        self.workspace.remove()

    def seconds(self) -> float:
        """For how long it is being done [s]."""
        return monotonic() - self.began if self.busy else 0.0

    async def _run(self, busy: str, words: Sequence[str], folder: Path) -> Outcome:
        self.busy, self.began, self.progress = busy, monotonic(), []
        self._child = Child(words, folder, self._say)
        self.changed("run")
        try:
            return await self._child.run()
        finally:
            self._child, self.busy = None, ""

    def _say(self, line: str) -> None:
        """A line of progress; warnings are in the report."""
        if not line.startswith(("bayeq: warning: ", "bayeq: error: ")):
            self.progress.append(line.removeprefix(_PROGRESS))
            self.changed("progress")

    def _forget(self, path: Path, kept: Path | None = None) -> None:
        """Remove a file that was dropped, unless it is the one that is kept."""
        if self.workspace.path in path.parents and (kept is None or kept.parent != path.parent):
            self.workspace.remove(path.parent)
