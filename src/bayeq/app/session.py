"""State of the page (file, choices, result) and its private folder; commands in separate processes do the work."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

from bayeq.app.choices import Choices, discover_command
from bayeq.errors import InputError
from bayeq.resumable import PROGRESS
from bayeq.resumable.posix import KILL, has_ended, is_of_this_user, signal_group

# Prefix of the folders; the process id follows.
_PREFIX = "bayeq-app-"

# File name of the example.
EXAMPLE = "example.csv"

#: Largest file that is taken from the browser [bytes]; larger ones are opened where they are.
LARGEST = 200_000_000

# Longest name of a file [characters], with its ending.
LONGEST_NAME = 80

#: Activities, as values of `Session.busy`.
READING, LOOKING = "reading the file", "looking for the equation"


@dataclass(frozen=True, slots=True)
class Opened:
    """A file that is open: what the page calls it, where it is, and what ``bayeq info --json`` says of it."""

    name: str
    path: Path
    info: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a run: its number, from 1, the folder with `EQUATION` and `REPORT`, and the name of the record."""

    number: int
    folder: Path
    name: str


class Workspace:
    """A folder at `path` that only this user can read."""

    def __init__(self) -> None:
        _remove_abandoned()
        # resolved: messages of commands that run in it use this path
        self.path = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-")).resolve()  # mkdtemp makes it private

    def new_folder(self) -> Path:
        """An empty folder in it, for a file or a result."""
        return Path(tempfile.mkdtemp(dir=self.path))

    def remove(self, folder: Path | None = None) -> None:
        """Remove a folder in it, or all of it; ValueError for a folder that is not in it."""
        folder = folder or self.path
        if folder != self.path and self.path not in folder.parents:
            raise ValueError(f"{folder} is not in {self.path}")
        shutil.rmtree(folder, ignore_errors=True)


def _remove_abandoned() -> None:
    """Remove folders of this user that a killed process left behind."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        pid = folder.name.removeprefix(_PREFIX).partition("-")[0]
        with suppress(OSError):  # the folder has just gone
            if pid.isdecimal() and is_of_this_user(folder) and has_ended(int(pid)):
                shutil.rmtree(folder, ignore_errors=True)


class Session:
    """The state of the page; `changed` is called with the parts of the page that have to be redrawn."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.changed: Callable[..., None] = lambda *parts: None
        self.opened: Opened | None = None
        self.further: list[Path] = []  # records of the same channels
        self.choices = Choices()
        self.result: Result | None = None
        self.busy = ""  # current activity, empty if idle
        self.began = 0.0
        self.progress: list[str] = []
        self.file_error = self.run_error = self.note = ""
        self.stopped = False
        self._child: Child | None = None
        self._runs = 0

    async def open(self, path: Path, name: str, reading: Sequence[str] = ()) -> None:
        """Open a file with reading options; the file that was open before stays open if this one cannot be read."""
        again = self.opened is not None and self.opened.path == path
        if self.busy:
            self.file_error = f"{name}: not opened, as something is being done: stop it first"
            self._forget(path)
            self.changed("file")
            return
        # run in its folder, so that messages name an uploaded file without folders
        inside = self.workspace.path in path.parents
        outcome = await self._run(READING, ["info", self._name(path), "--json", *reading], path.parent)
        self.file_error = outcome.error or ("Stopped: the file was not opened." if outcome.stopped else "")
        if not self.file_error:
            if self.opened is not None and not again:
                for former in (self.opened.path, *self.further):
                    self._forget(former)
                self.further = []
            if self.result is not None:
                self.workspace.remove(self.result.folder)
            self.opened = Opened(name, path, json.loads(outcome.out))
            self.choices = Choices.proposed(self.opened.info)
            self.choices.reading |= dict(zip(reading[::2], reading[1::2], strict=True))
            self.result, self.run_error, self.note = None, "", ""
        elif inside and not again:
            self._forget(path)
        self.changed("file", "run", "result")

    async def open_example(self) -> None:
        """Simulate a record of a known system, and open it."""
        if self.busy:
            return
        folder = self.workspace.new_folder()
        outcome = await self._run("making an example", ["simulate", "duffing", "--n", "2000", "-o", EXAMPLE], folder)
        if outcome.error or outcome.stopped:
            self.file_error = outcome.error
            self.workspace.remove(folder)
            self.changed("file", "run")
        else:
            await self.open(folder / EXAMPLE, EXAMPLE)

    async def read_again(self) -> None:
        """Open the open file again with the chosen reading options."""
        if self.opened is not None:
            await self.open(self.opened.path, self.opened.name, self.choices.words)

    def drop(self, path: Path) -> None:
        """Leave out a further record."""
        self.further.remove(path)
        self._forget(path)
        self.changed("file", "command")

    def words(self) -> list[str]:
        """The command that `discover` runs; InputError if the roles form no chain."""
        files = [] if self.opened is None else [self.opened.path, *self.further]
        return discover_command([self._name(path, files[:k]) for k, path in enumerate(files)], self.choices)

    def _name(self, path: Path, before: Sequence[Path] = ()) -> str:
        """Name of a file in a command: an uploaded one without its folder, numbered where one before has its name."""
        if self.workspace.path not in path.parents:
            return str(path)
        return f"record{len(before) + 1}_{path.name}" if path.name in {one.name for one in before} else path.name

    async def discover(self) -> None:
        """Find the equations with the current choices; an earlier result stays until there is a new one."""
        if self.busy or self.opened is None:
            return
        self.run_error, self.note, self.stopped = "", "", False
        try:
            words = self.words()
            folder = self.workspace.new_folder()
            files = [self.opened.path, *self.further]
            for k, path in enumerate(files):
                if self.workspace.path in path.parents:  # a name without folders, also in the report
                    (folder / self._name(path, files[:k])).hardlink_to(path)
        except InputError as error:
            self.run_error = str(error)
        except OSError as error:
            self.run_error = f"the folder for temporary files cannot be written to: {error.strerror or error}"
        if self.run_error:
            self.changed("run")
            return
        began = monotonic()
        outcome = await self._run(LOOKING, words, folder)
        if outcome.error or outcome.stopped:
            self.run_error, self.stopped = outcome.error, outcome.stopped
            self.note = "Stopped: nothing of this run is kept." if outcome.stopped else ""
            self.workspace.remove(folder)
            self.changed("run")
        else:
            previous, self._runs = self.result, self._runs + 1
            self.result = Result(self._runs, folder, Path(self.opened.name).stem)
            self.note = f"Done in {monotonic() - began:.0f} s: the result is below."
            if previous is not None:
                self.workspace.remove(previous.folder)
            self.changed("run", "result")

    async def stop(self) -> None:
        if self._child is not None:
            await self._child.stop()

    def close(self) -> None:
        """Kill the running command, and remove all files."""
        if self._child is not None:
            self._child.kill()
        self.workspace.remove()

    def seconds(self) -> float:
        """Duration of the current activity [s]; 0 if idle."""
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
        """Add a progress line; warnings and errors are shown elsewhere (report, outcome)."""
        if not line.startswith(("bayeq: warning: ", "bayeq: error: ")):
            self.progress.append(line.removeprefix(PROGRESS))
            self.changed("progress")

    def _forget(self, path: Path) -> None:
        """Remove an uploaded file with its folder; a file opened in place stays."""
        if self.workspace.path in path.parents:
            self.workspace.remove(path.parent)


def safe_name(name: str) -> str:
    """Make the name of an uploaded file safe: no folders, no special characters, limited length.

    Examples
    --------
    >>> safe_name("../../etc/run 1.csv"), safe_name("-rf <b>.mat"), safe_name("..")
    ('run 1.csv', 'rf _b_.mat', 'record')
    """
    base = name.replace("\\", "/").rsplit("/", 1)[-1]
    clean = re.sub(r"[^\w .()+-]", "_", base).lstrip(" .-").rstrip(" .")
    stem, ending = os.path.splitext(clean or "record")
    if ending.lower() == ".gz":
        stem, inner = os.path.splitext(stem)
        ending = inner + ending
    ending = ending[:LONGEST_NAME]
    # file systems limit bytes, and a character may take four
    kept = stem.encode()[: max(LONGEST_NAME - len(ending), 1)].decode(errors="ignore")
    return (kept + ending).rstrip(" .") or "record"


# --- commands in processes of their own ------------------------------------------------------------------------------

# Longest line that is read [bytes].
LINE = 1 << 24

# A process that does not end at SIGTERM is killed after this time [s].
GRACE = 3.0

_ERROR = "bayeq: error: "


class Outcome(NamedTuple):
    """How a command ended: its output, the error message (a line; empty if none), whether it was stopped."""

    out: str
    error: str = ""
    stopped: bool = False


class Child:
    """A bayeq command with arguments `words`, run once in a folder; `say` gets each line of its standard error."""

    def __init__(self, words: Sequence[str], folder: Path, say: Callable[[str], None]) -> None:
        self.words, self.folder, self.say = list(words), folder, say
        self.stopped = False
        self._process: asyncio.subprocess.Process | None = None

    async def run(self) -> Outcome:
        # -P, and no empty entry in PYTHONPATH: a file in the folder that is called numpy.py is not imported
        paths = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, paths))}
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-m", "bayeq", *self.words),
            cwd=self.folder,
            env=environment,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LINE,
            start_new_session=True,
        )
        self._process = process
        if self.stopped:  # while it was started
            self.kill()
        assert process.stdout is not None
        assert process.stderr is not None
        out, lines = await asyncio.gather(process.stdout.read(), self._lines(process.stderr))
        code = await process.wait()
        return Outcome(
            out.decode(errors="replace"), _reason(lines, code) if code and not self.stopped else "", self.stopped
        )

    async def _lines(self, stream: asyncio.StreamReader) -> list[str]:
        lines = []
        async for raw in stream:
            line = raw.decode(errors="replace").strip()
            if line:
                lines.append(line)
                self.say(line)
        return lines

    async def stop(self) -> None:
        """Send SIGTERM to the command and its child processes; kill them if it does not end."""
        self.stopped = True
        if self._process is None:
            return
        self._signal(signal.SIGTERM)
        try:
            await asyncio.wait_for(self._process.wait(), GRACE)
        except TimeoutError:
            self.kill()

    def kill(self) -> None:
        """Kill the command and its child processes."""
        self.stopped = True
        self._signal(KILL)

    def _signal(self, number: signal.Signals) -> None:
        process = self._process
        if process is not None and process.returncode is None:
            with suppress(ProcessLookupError):  # it has just ended
                signal_group(process, number)


def _reason(lines: Sequence[str], code: int) -> str:
    """Error message of a failed command: its last error line, or its exit code with its last line."""
    for line in reversed(lines):
        if line.startswith(_ERROR):
            return line.removeprefix(_ERROR)
    if code == -KILL:
        return "the system ended the command, perhaps for want of memory: use fewer rows or fewer terms"
    last = f": {lines[-1][:300]}" if lines else ""
    return f"the command ended with code {code}{last}; run the command below in a terminal to see more"
