"""Ctrl-C at any moment: one line, exit code 130."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time

import pytest
from studies.kills import JOBS, prepare, undisturbed

from tests.reliability.commands import QUICK, bayeq, environment, heeding, remarks, start

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

COMMANDS = {
    "discover": ["discover", "run.csv", *QUICK],
    "report": ["discover", "run.csv", *QUICK, "--report", "page.html"],
    "study": ["study", "table2", "--realisations", "400", "--systems", "linear", "--algorithms", "vb"],
}


@pytest.mark.statistical(short=2, full=40)
@pytest.mark.parametrize(
    "name", ["discover", *(pytest.param(name, marks=pytest.mark.slow) for name in ("study", "report"))]
)
def test_an_interrupt_at_any_moment_is_one_line(name, folder, number):
    command = COMMANDS[name]
    began = time.monotonic()
    if name != "study":  # which runs for longer
        assert bayeq(*command, cwd=folder)[0] == 0
    span = min(time.monotonic() - began, 4.0) if name != "study" else 3.0
    early = 0
    for k in range(number):
        process = start(*command, cwd=folder)
        time.sleep(span * (k + random.random()) / number)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
        said = remarks(err)
        if any("KeyboardInterrupt" in line for line in said):  # Python itself is still starting
            early, span = early + 1, 1.5 * span  # the machine may be busier than before
            assert early <= max(1, number // 3)
            assert "cli/app.py" not in err
            continue
        # -2: within the end of the process, or its very beginning
        assert process.returncode in (130, -signal.SIGINT, 0), err
        assert len(said) == (process.returncode == 130), err
        assert all(line.startswith("bayeq: interrupted") for line in said)
        assert process.returncode == 130 or out or process.returncode == -signal.SIGINT
    assert [path.name for path in folder.iterdir() if ".part" in path.name] == []


@pytest.mark.statistical(short=2, full=40)
@pytest.mark.slow  # the signal: above; what is kept, and that the same command goes on: test_streaming, test_kills
@pytest.mark.parametrize("name", ["discover --checkpoint", "study", "batch"])
def test_an_interrupted_command_goes_on_and_ends_as_if_undisturbed(name, tmp_path, number):
    sweep(name, tmp_path, number)


# How far a study or a batch is.
RATE = re.compile(r"\d+ of \d+ (realisations|files), ")


def sweep(name, place, number):
    """Interrupt a command that keeps what it has done, start it again and so on; each time that it ends, from the
    beginning."""
    job, (seconds, files, rows) = JOBS[name], undisturbed(name)
    ended = 0
    for k in range(number):
        folder = place / f"{name.split()[0]}{ended}"
        fresh = not folder.exists()
        if fresh:
            folder.mkdir()
            prepare(folder)
        process = job.start(folder, heeding())
        time.sleep(seconds * (k + random.random()) / number)
        if random.random() < 0.5:  # a terminal sends it to workers as well
            os.killpg(process.pid, signal.SIGINT)
        else:
            process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=60)[1].decode()
        said = [line for line in remarks(err) if not RATE.match(line)]
        if any("KeyboardInterrupt" in line for line in said):  # Python itself is still starting
            assert k <= number // 3
            assert "cli/app.py" not in err
            continue
        assert process.returncode in (130, -signal.SIGINT, 0), err
        assert [line.startswith("bayeq: interrupted") for line in said].count(True) == (process.returncode == 130), err
        assert len(said) <= 1, err
        assert all(content == files[name] for name, content in job.files(folder).items())
        assert job.rows(folder) <= rows
        if process.returncode == 130:
            assert said[0].startswith("bayeq: interrupted")
            kept = list(folder.glob("sums/*.npz"))
            assert kept or "sums over" not in err
            assert not (fresh and kept) or "; the same command continues" in err
        assert not list(folder.rglob("*.part*"))
        if process.returncode == 0:
            assert (job.files(folder), job.rows(folder)) == (files, rows)
            ended += 1
    job.finish(folder)
    assert (job.files(folder), job.rows(folder)) == (files, rows)


WORKERS = """
import signal
from pathlib import Path
from bayeq.resumable.store import compute

def heeded(task):
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return not blocked, signal.getsignal(signal.SIGINT) is not signal.SIG_IGN

print(set(compute(heeded, range(4), 2, Path("store"))))
print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""


def test_workers_leave_interrupts_to_their_parent_from_their_birth(tmp_path):
    """A terminal sends Ctrl-C to all processes; one that comes while a kernel is loaded would crash the worker."""
    done = subprocess.run(
        [sys.executable, "-c", WORKERS],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True, preexec_fn=heeding(),
    )  # fmt: skip
    assert done.stdout.split("\n") == ["{(False, False)}", "False", ""]


SLOW_IMPORT = "import time\nfor _ in range(40): time.sleep(0.01)\nDONE = True\n"
KERNEL = "from numba import njit\n@njit(cache=True)\ndef add(x): return x + 1\n"
AT = """
import os, signal, sys
from bayeq.cli import app, process

def main():
    {body}
    return 0

app.main = main
sys.exit(process.run())
"""


@pytest.mark.parametrize(
    "body",
    [
        "raise_in = os.kill(os.getpid(), signal.SIGINT); import time; time.sleep(50)",
        # a library that takes an interrupted import for one that is missing
        """try:
        import threading
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        import slow
    except BaseException:
        raise SystemError("the import failed")
    import time; assert slow.DONE; time.sleep(50)""",
        # where Python can raise nothing
        """class Closed:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000): pass
    Closed(); import time; time.sleep(50)""",
        # where LLVM asks for a kernel that was compiled before: without the answer it would have none
        """import subprocess
    subprocess.run([sys.executable, "-c", "import kernel; kernel.add(1)"], check=True)
    from numba.core.codegen import JITCodeLibrary
    ask = JITCodeLibrary._object_getbuffer_hook.__func__
    def interrupted(library, module):
        compiled = ask(library, module)
        if compiled is not None: os.kill(os.getpid(), signal.SIGINT)
        return compiled
    JITCodeLibrary._object_getbuffer_hook = classmethod(interrupted)
    import kernel; assert kernel.add(1) == 2; import time; time.sleep(50)""",
        # a library that makes something else of it
        """try:
        os.kill(os.getpid(), signal.SIGINT); import time; time.sleep(50)
    except KeyboardInterrupt as stop:
        raise RuntimeError("failed in nopython mode") from stop""",
    ],
)
def test_an_interrupt_is_one_line_whatever_it_falls_into(body, tmp_path):
    (tmp_path / "slow.py").write_text(SLOW_IMPORT)
    (tmp_path / "kernel.py").write_text(KERNEL)
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", AT.format(body=body)],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False, timeout=100,
        preexec_fn=heeding(),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "bayeq: interrupted\n")
    assert time.monotonic() - began < 45


def test_a_command_that_was_started_to_ignore_interrupts_ignores_them(tmp_path):
    body = "os.kill(os.getpid(), signal.SIGINT); print('still here')"
    done = subprocess.run(
        [sys.executable, "-c", AT.format(body=body)],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "still here\n", "")
