"""A command of bayeq in a process of its own: its lines as they come, what it printed, and a way to stop it."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayeq.posix import KILL, signal_group

__all__ = ["Child", "Outcome"]

# Longest line that is read [bytes].
LINE = 1 << 24

# A process that was asked to end is ended after this time [s].
GRACE = 3.0

_ERROR = "bayeq: error: "


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command ended: what it printed, why it failed (a line; empty if it did not), whether it was stopped."""

    out: str
    error: str = ""
    stopped: bool = False


class Child:
    """A command, the words after ``bayeq``, to be run once in a folder; `say` gets each line of its standard error."""

    def __init__(self, words: Sequence[str], folder: Path, say: Callable[[str], None]) -> None:
        self.words, self.folder, self.say = list(words), folder, say
        self.stopped = False
        self._process: asyncio.subprocess.Process | None = None

    async def run(self) -> Outcome:
        """Run it to its end."""
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
        printed = out.decode(errors="replace")
        if self.stopped:
            return Outcome(printed, stopped=True)
        return Outcome(printed, _reason(lines, code) if code else "")

    async def _lines(self, stream: asyncio.StreamReader) -> list[str]:
        lines = []
        async for raw in stream:
            line = raw.decode(errors="replace").strip()
            if line:
                lines.append(line)
                self.say(line)
        return lines

    async def stop(self) -> None:
        """Ask it to end, with all that it started; end it if it does not."""
        self.stopped = True
        if self._process is None:
            return
        self._signal(signal.SIGTERM)
        try:
            await asyncio.wait_for(self._process.wait(), GRACE)
        except TimeoutError:
            self.kill()

    def kill(self) -> None:
        """End it at once, with all that it started."""
        self.stopped = True
        self._signal(KILL)

    def _signal(self, number: signal.Signals) -> None:
        process = self._process
        if process is None or process.returncode is not None:
            return
        try:
            signal_group(process, number)
        except ProcessLookupError:
            return  # it has just ended


def _reason(lines: Sequence[str], code: int) -> str:
    """Why a command failed, from its last words."""
    for line in reversed(lines):
        if line.startswith(_ERROR):
            return line.removeprefix(_ERROR)
    if code == -KILL:
        return "the system ended the command, perhaps for want of memory: use fewer rows or fewer terms"
    last = f": {lines[-1][:300]}" if lines else ""
    return f"the command ended with code {code}{last}; run the command below in a terminal to see more"
