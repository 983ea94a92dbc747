"""Studies: reproducible realisations, stores that survive, tables that are shown."""

from __future__ import annotations

import csv
import io
import json
import random
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from dataclasses import replace

import numpy as np
import pytest
from click import ClickException

from bayeq.cli.app import main
from bayeq.cli.study import study as study_commands
from bayeq.errors import FileFormatError, InputError, UnknownNameError
from bayeq.resumable.store import Claims
from bayeq.study import runner
from bayeq.study.config import StudyConfig
from bayeq.study.runner import ALGORITHMS, Store, Task, draw, realise, run_study
from bayeq.study.table import show

FAST = ("rvm", "vb")


def study(path, realisations=6, jobs=1, systems=("linear", "coulomb"), algorithms=FAST, **options):
    return run_study(
        path, systems=systems, algorithms=algorithms, realisations=realisations, jobs=jobs, batch=2, **options
    )


def contents(path):
    """All that a study holds, without seconds."""
    with Store(path) as store:
        return [replace(result, seconds=None) for result in store.results()]


def shown(path):
    """`study show --json` without seconds, as bytes."""
    with Store(path) as store:
        answer = json.loads(show(store, "json"))
    for row in answer["rows"]:
        del row["seconds"]
    return json.dumps(answer).encode()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "small.db"
    study(path)
    return path


def command(*arguments):
    return study_commands.main([str(a) for a in arguments], prog_name="bayeq study", standalone_mode=False)


# Realisations


def test_a_realisation_alone_is_the_one_of_the_study(small):
    (alone,) = realise(StudyConfig(), Task("coulomb", 3, ("vb",)))
    assert replace(alone, seconds=None) in contents(small)
    assert alone.seconds > 0


def test_every_algorithm_answers_whatever_else_runs():
    config = StudyConfig(samples=300, burn_in=100, chains=2)
    together = realise(config, Task("linear", 1, tuple(ALGORITHMS)))
    assert [r.failure for r in together] == [None] * len(ALGORITHMS)
    for result in together:
        (alone,) = realise(config, Task("linear", 1, (result.algorithm,)))
        assert replace(alone, seconds=0.0) == replace(result, seconds=0.0)


def test_realisations_differ_by_seed_system_and_index():
    one = draw(StudyConfig(), "linear", 0)
    assert one.train.n == one.test.n == 2000
    assert len(one.train.names) == 36
    assert dict(zip(one.train.names, one.truth, strict=True))["u"] == 1.0
    others = [
        draw(StudyConfig(), "linear", 1),
        draw(StudyConfig(seed=1), "linear", 0),
        draw(StudyConfig(), "coulomb", 0),
    ]
    assert all(one.train.yty != other.train.yty for other in others)
    assert draw(StudyConfig(), "linear", 0).train.yty == one.train.yty


def test_parameters_are_perturbed_and_the_mass_is_not():
    ratios = []
    for k in range(60):
        data = draw(StudyConfig(train_rows=50, test_rows=50), "duffing", k)
        truth = dict(zip(data.train.names, data.truth, strict=True))
        ratios.append([truth["x"] / -1e3, truth["v"] / -2.0, truth["x**3"] / -1e5])
        assert truth["u"] == 1.0
    assert np.std(ratios, axis=0) == pytest.approx([0.1] * 3, rel=0.4)
    assert np.mean(ratios, axis=0) == pytest.approx([1.0] * 3, abs=0.05)


def test_a_failure_is_recorded_and_shown(tmp_path, monkeypatch):
    def fails(data, config, seed):
        if seed[2] == 2:
            raise ValueError("did not\nwork")
        return ALGORITHMS["vb"](data, config, seed)

    monkeypatch.setitem(ALGORITHMS, "rvm", fails)
    path = tmp_path / "study.db"
    assert study(path).failures == 2
    rows = {(r.system, r.index, r.algorithm): r for r in contents(path)}
    assert rows["linear", 2, "rvm"].failure == "ValueError: did not work"
    assert rows["linear", 2, "rvm"].metrics is None
    assert rows["linear", 2, "vb"].failure is None
    with Store(path) as store:
        answer = json.loads(show(store, "json"))
        assert "Failed: linear/rvm, 1 realisations from number 2 on: ValueError: did not work" in show(store)
    assert [(r["n"], r["failures"]) for r in answer["rows"]] == [(5, 1), (6, 0)] * 2
    assert [f["message"] for f in answer["failures"]] == ["ValueError: did not work"] * 2
    assert study(path).realisations == 0  # not tried again


def test_estimates_that_are_not_finite_are_failures(monkeypatch):
    def bad(data, config, seed):
        answer = ALGORITHMS["vb"](data, config, seed)
        return replace(answer, coef=answer.coef * np.nan)

    monkeypatch.setitem(ALGORITHMS, "rvm", bad)
    (result,) = realise(StudyConfig(), Task("linear", 0, ("rvm",)))
    assert result.failure == "FloatingPointError: coefficients that are not finite"


def test_a_realisation_that_cannot_be_drawn_fails_for_every_algorithm(monkeypatch):
    def diverges(*arguments, **options):
        raise InputError("the simulation diverged")

    monkeypatch.setattr(runner, "simulate", diverges)
    results = realise(StudyConfig(), Task("linear", 0, FAST))
    assert [r.failure for r in results] == ["InputError: the simulation diverged"] * 2


def test_running_out_of_memory_is_not_a_result(monkeypatch):
    def hungry(*arguments):
        raise MemoryError

    monkeypatch.setitem(ALGORITHMS, "rvm", hungry)
    with pytest.raises(MemoryError):
        realise(StudyConfig(), Task("linear", 0, ("rvm",)))


# Runs


def test_any_number_of_jobs_and_any_batch_gives_the_same(small, tmp_path):
    outcome = study(tmp_path / "two.db", jobs=2)
    assert (outcome.realisations, outcome.failures) == (12, 0)
    run_study(tmp_path / "auto.db", systems=["coulomb", "linear"], algorithms=FAST[::-1], realisations=6, jobs=1)
    assert contents(tmp_path / "two.db") == contents(tmp_path / "auto.db") == contents(small)
    assert shown(tmp_path / "two.db") == shown(tmp_path / "auto.db") == shown(small)


def test_a_study_grows_by_realisations_systems_and_algorithms(small, tmp_path):
    path = tmp_path / "study.db"
    assert study(path, realisations=2, systems=["linear"], algorithms=["vb"]).realisations == 2
    assert study(path, realisations=4, systems=["linear"], algorithms=["vb"]).realisations == 2
    assert study(path).realisations == 12
    assert study(path, realisations=3).realisations == 0
    assert shown(path) == shown(small)


def test_what_is_missing_is_said(tmp_path):
    with Store(tmp_path / "study.db", StudyConfig()) as store:
        assert "No results yet" in show(store)
        store.plan(["linear"], ["vb"], 3)
        store.add(realise(StudyConfig(), Task("linear", 1, ("vb",))))
        assert "linear/vb 2" in show(store)
        assert store.missing(["linear"], ("vb",), 3) == [[("linear", 0, "vb")], [("linear", 2, "vb")]]


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_interrupt_keeps_what_is_done(small, tmp_path, jobs):
    def stop(done, total):
        if done >= 4:
            raise KeyboardInterrupt

    path = tmp_path / "study.db"
    with pytest.raises(KeyboardInterrupt):
        study(path, jobs=jobs, progress=stop)
    assert 8 <= len(contents(path)) < 24
    study(path, jobs=jobs)
    assert shown(path) == shown(small)


KILLED = """
import sys
from bayeq.study.runner import run_study
run_study(sys.argv[1], systems=["linear", "duffing"], algorithms=["rvm", "vb"], realisations=40, jobs=int(sys.argv[2]),
          batch=1)
"""


def rows_in(path):
    try:
        with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as connection, connection:
            return connection.execute("SELECT count(*) FROM results").fetchone()[0]
    except sqlite3.Error:  # not there yet, or just being written
        return 0


@pytest.mark.slow  # that another goes on: below
def test_killed_at_random_it_ends_as_if_undisturbed(tmp_path):
    undisturbed, path = tmp_path / "undisturbed.db", tmp_path / "killed.db"
    options = {"systems": ["linear", "duffing"], "algorithms": ["rvm", "vb"], "realisations": 40}
    run_study(undisturbed, **options)
    rng = random.Random(time.time_ns())
    kills = 0
    for jobs in ("2", "1"):
        process = subprocess.Popen([sys.executable, "-c", KILLED, str(path), jobs])
        enough = rows_in(path) + rng.randrange(1, 40)
        while process.poll() is None and rows_in(path) < enough:
            time.sleep(0.001)
        time.sleep(0.01 * rng.random())
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
    assert kills >= 1  # the last may come too late
    run_study(path, jobs=2, **options)
    assert shown(path) == shown(undisturbed)
    assert len(contents(path)) == 160


# Stores


def test_another_configuration_is_refused(small, tmp_path):
    with pytest.raises(InputError, match="seed is 0 there and 1 here; smooth is 'none' there and 'auto' here; repeat"):
        study(small, config=StudyConfig(seed=1, smooth="auto"))


def test_files_that_are_no_store_are_refused(tmp_path):
    text, other, empty = tmp_path / "run.csv", tmp_path / "other.db", tmp_path / "empty.db"
    text.write_text("t,x\n0,1\n" * 1000)
    with closing(sqlite3.connect(other)) as connection, connection:
        connection.execute("CREATE TABLE t (a)")
    connection.close()
    empty.touch()
    for path, message in ((text, "is not a study"), (other, "is not a study"), (tmp_path, "is a directory")):
        with pytest.raises(FileFormatError, match=message):
            Store(path, StudyConfig())
        with pytest.raises(FileFormatError, match=message):
            Store(path)
    assert text.read_text().startswith("t,x")
    with pytest.raises(FileFormatError, match="no such file"):
        Store(tmp_path / "absent.db")
    with pytest.raises(FileFormatError, match="no directory"):
        Store(tmp_path / "absent" / "study.db", StudyConfig())
    with pytest.raises(FileFormatError, match="is not a study"):
        Store(empty)
    Store(empty, StudyConfig()).close()  # what a kill before the first commit leaves
    Store(empty).close()


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_store_is_an_input_error(small, tmp_path, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(small.read_bytes())
    if seed % 2:
        data = data[: rng.integers(100, len(data))]
    else:
        start = int(rng.integers(0, len(data) - 3000))
        data[start : start + 3000] = rng.bytes(3000)
    path = tmp_path / "damaged.db"
    path.write_bytes(data)
    with suppress(FileFormatError), Store(path) as store:  # damage to a value alone is not seen
        show(store, "json")


def test_a_store_of_another_version_is_refused(small, tmp_path):
    path = tmp_path / "new.db"
    path.write_bytes(small.read_bytes())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA user_version = 9")
    connection.close()
    with pytest.raises(FileFormatError, match="another version"):
        Store(path)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"systems": ["lorenz"]}, UnknownNameError),
        ({"algorithms": ["lasso"]}, UnknownNameError),
        ({"algorithms": []}, InputError),
        ({"realisations": 0}, InputError),
        ({"realisations": 10**9}, InputError),
        ({"jobs": 0}, InputError),
        ({"jobs": 1.5}, InputError),
        ({"config": StudyConfig(seed=-1)}, InputError),
        ({"config": StudyConfig(burn_in=5000)}, InputError),
        ({"config": StudyConfig(noise=float("nan"))}, InputError),
        ({"config": StudyConfig(smooth="much")}, InputError),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(tmp_path, options, error):
    with pytest.raises(error):
        run_study(tmp_path / "study.db", **options)
    assert not (tmp_path / "study.db").exists()


# Shown


def test_formats(small):
    with Store(small) as store:
        text, markdown, table, answer = (show(store, form) for form in ("text", "markdown", "csv", "json"))
    answer = json.loads(answer)
    assert answer["config"]["seed"] == 0
    assert [(r["system"], r["algorithm"], r["n"]) for r in answer["rows"]] == [
        (s, a, 6) for s in ("linear", "coulomb") for a in FAST
    ]
    assert answer["rows"][1]["paper"]["exact"] == 0.991
    rows = list(csv.DictReader(io.StringIO(table)))
    assert [float(r["e_theta"]) for r in rows] == [r["e_theta"] for r in answer["rows"]]
    assert (rows[1]["paper_exact"], float(rows[1]["se_exact"])) == ("0.991", answer["rows"][1]["se"]["exact"])
    assert "paper SS-VB" in text
    assert text.isprintable() or "\x1b" not in text
    assert "| linear | rvm | 6 |" in markdown


def test_table_3(small):
    with Store(small) as store:
        rows = json.loads(show(store, "json", 3))["rows"]
        assert "to RVM" in show(store, "text", 3)
        assert "to RVM" in show(store, "markdown", 3)
        assert show(store, "csv", 3).startswith("algorithm,n,seconds")
    assert [(r["algorithm"], r["n"]) for r in rows] == [("rvm", 12), ("vb", 12)]
    assert rows[1]["ratio_rvm"] == pytest.approx(rows[1]["seconds"] / rows[0]["seconds"])
    assert rows[1]["paper"]["ratio_rvm"] == pytest.approx(11)


# The command


def test_the_command_runs_and_shows(tmp_path, capsys, small):
    path = tmp_path / "study.db"
    arguments = ["--systems", "linear, coulomb", "--algorithms", "rvm,vb", "--realisations", 6, "--jobs", 1]
    command("table2", *arguments, "--store", path)
    out, err = capsys.readouterr()
    assert out.startswith("Table 2")
    assert "12 realisations in" in err
    command("show", path, "--json")
    out, err = capsys.readouterr()
    assert json.loads(out)["rows"][0]["n"] == 6
    assert err == ""
    assert shown(path) == shown(small)
    command("table2", *arguments, "--store", path)
    assert capsys.readouterr().err == ""


def test_the_command_refuses(tmp_path, small):
    for arguments in (
        ["table2", "--store", small, "--seed", 4],
        ["table2", "--store", tmp_path / "s.db", "--algorithms", "vbb"],
        ["show", tmp_path / "absent.db"],
        ["show", small, "--table", 4],
        ["show", small, "--json", "--format", "csv"],
        [],
    ):
        with pytest.raises(InputError):
            command(*arguments)
    for arguments in (["show", small, "--format", "html"], ["table2", "--smooth", "much"], ["show"]):
        with pytest.raises(ClickException):
            command(*arguments)


def test_an_interrupted_command_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    def stopped(*arguments, **options):
        options["progress"](7, 20)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayeq.study.runner.run_study", stopped)
    assert main(["study", "table2", "--store", str(tmp_path / "study.db")]) == 130
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "7 realisations were added" in err
    assert "the same command continues" in err


def test_a_killed_worker_ends_the_run_with_a_reason(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WORKER_KILLED, str(tmp_path / "study.db")],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.stdout.startswith("a worker process was killed")


WORKER_KILLED = """
import os, signal, sys
from contextlib import suppress
from bayeq.errors import BayeqError
from bayeq.study.runner import run_study

def kill(done, total):
    from joblib.externals.loky import reusable_executor
    for pid in list(reusable_executor._executor._processes):
        with suppress(ProcessLookupError):  # killed before, when other records were done
            os.kill(pid, signal.SIGKILL)
try:
    run_study(sys.argv[1], algorithms=["rvm"], realisations=400, jobs=2, batch=1, progress=kill)
except BayeqError as error:
    print(error)
"""


# Several runs on one store


SHARING = ["--systems", "linear,duffing", "--algorithms", "rvm,vb", "--realisations", "60", "--jobs", "1"]


def started(path):
    return subprocess.Popen(
        [sys.executable, "-m", "bayeq", "study", "table2", *SHARING, "--store", str(path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def added(process):
    """Realisations that a run says it has added."""
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return sum(int(line.split(": ")[1].split()[0]) for line in err.splitlines() if "realisations in" in line)


@pytest.mark.slow  # of a batch, by the same store: test_batch
def test_two_runs_on_one_store_share_the_work(tmp_path):
    path = tmp_path / "study.db"
    both = [started(path), started(path)]
    counts = [added(process) for process in both]
    assert sum(counts) == 120  # none twice
    assert min(counts) > 0
    with Store(path) as store:
        assert len(list(store.results())) == 240


def test_what_a_killed_run_has_claimed_is_done_by_another(tmp_path):
    path = tmp_path / "study.db"
    killed, other = started(path), started(path)
    while killed.poll() is None and rows_in(path) < 20:
        time.sleep(0.005)
    killed.kill()
    killed.communicate()
    added(other)
    with Store(path) as store:
        assert len(list(store.results())) == 240


def test_claims_of_other_machines_count_until_they_end(tmp_path, monkeypatch):
    path = tmp_path / "study.db"
    with Store(path, StudyConfig()) as store:
        ends = time.time() + 3.0
        keys = [("linear", 0, "vb"), ("linear", 1, "vb"), ("linear", 1, "rvm")]
        with closing(sqlite3.connect(path)) as connection, connection:
            claimed = [(*key, "elsewhere:1:a", ends) for key in keys]
            connection.executemany("INSERT INTO claims VALUES (?, ?, ?, ?, ?)", claimed)
        connection.close()
        with Claims(store) as claims:
            assert claims.free(keys) == ()
        seen = []
        outcome = study(
            path, realisations=2, systems=["linear"], progress=lambda *step: seen.append((step, time.time()))
        )
        assert outcome.realisations == 3  # of one first one algorithm, and then the other
        assert seen[0] == ((1, 2), seen[0][1])
        assert seen[-1][1] > ends
        with Claims(store) as claims:  # what is done needs none
            assert claims.free([("linear", 0, "vb"), ("linear", 5, "vb")]) == (("linear", 5, "vb"),)


def test_claims_are_prolonged_and_given_back(tmp_path, monkeypatch):
    monkeypatch.setattr("bayeq.resumable.store.BEAT", 0.05)
    path = tmp_path / "study.db"
    Store(path, StudyConfig()).close()

    def until():
        with closing(sqlite3.connect(path)) as connection, connection:
            found = connection.execute("SELECT until FROM claims").fetchall()
        connection.close()
        return [row[0] for row in found]

    with Store(path) as store, Claims(store) as claims:
        assert claims.free([("linear", 0, "vb")]) == (("linear", 0, "vb"),)
        first = until()
        ends = time.monotonic() + 10
        while until() == first:
            assert time.monotonic() < ends
            time.sleep(0.02)
    assert until() == []


def test_stores_of_earlier_versions_go_on(small, tmp_path):
    path = tmp_path / "study.db"
    path.write_bytes(small.read_bytes())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE claims")
    connection.close()
    assert study(path, realisations=7).realisations == 2
