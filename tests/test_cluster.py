"""Work on a Dask cluster: the same answer on any number of workers, whatever becomes of them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.discovery.streaming.cluster import Cluster, connected
from bayeq.discovery.streaming.work import AsMeasured, Extent, by_threads, fold, units_of
from bayeq.errors import BayeqError, InputError, MissingExtraError, RecordError, UnknownNameError
from bayeq.expressions import parse
from bayeq.records.stream import RecordStream, open_streams
from bayeq.states import Roles
from bayeq.study.runner import Store, run_study

dask = pytest.importorskip("dask", reason="needs the extra dask")
distributed = pytest.importorskip("distributed", reason="needs the extra dask")
pytest.importorskip("pyarrow", reason="needs the extra parquet")

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
OPTIONS = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--smooth", "none", "--json"]
FEW = {**OSCILLATOR, "dictionary": ["x", "v", "x**3", "sign(v)", "u"]}
TERMS = tuple(parse(text) for text in ("x", "v", "x**3", "sign(v)", "u"))


@contextmanager
def local(workers, folder):
    """A cluster of processes of one thread each, and its client."""
    with (
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            local_directory=str(folder),
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cluster")


@pytest.fixture(scope="module")
def client(folder):
    with local(2, folder) as found:
        yield found


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=40_000, seed=3)


@pytest.fixture(scope="module")
def frame(record):
    return pd.DataFrame({"t": record.time, **{name: record[name] for name in record.names}, "noise": 0.0})


@pytest.fixture(scope="module")
def path(frame, folder):
    frame.to_parquet(folder / "r.parquet", index=False, row_group_size=1000)
    return folder / "r.parquet"


@pytest.fixture(autouse=True)
def small_units(monkeypatch):
    """Units of few rows, so that short files have several; workers are sent where these begin."""
    monkeypatch.setattr("bayeq.records.formats.parquet.UNIT_ROWS", 1000)
    monkeypatch.setattr("bayeq.records.formats.protocol.grid.__defaults__", (3000,))


def quietly(*args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*args, **{"smooth": "none", **FEW, **options})


@pytest.fixture(scope="module")
def expected(record):
    """What is found in memory."""
    return quietly(record)


def compare(found, expected, rtol=1e-8):
    a, b = found.table(), expected.table()
    assert a.term.tolist() == b.term.tolist()
    assert a.included.tolist() == b.included.tolist()
    np.testing.assert_allclose(a.coef, b.coef, rtol=rtol)
    np.testing.assert_allclose(a.sd, b.sd, rtol=rtol)
    np.testing.assert_allclose(a.pip, b.pip, atol=1e-6)


def as_bytes(found):
    return found.table().to_json(double_precision=15).encode()


# --- records ---------------------------------------------------------------------------------------------------------


def test_a_file_on_two_workers_is_that_in_memory(path, client, expected):
    seen = []
    found = quietly(path, client=client, progress=lambda *step: seen.append(step))
    compare(found, expected)
    assert found.data.n == 40_000
    # sums come in order and rows are counted
    assert [done for stage, done, _ in seen if stage == "rows"] == [0, *range(8000, 40_001, 8000)]


def test_a_dask_data_frame_is_read_by_its_partitions(frame, client, expected):
    dd = pytest.importorskip("dask.dataframe", reason="needs the extra dask")
    whole = dd.from_pandas(frame, npartitions=7)
    holes = dd.concat([whole.partitions[:3], whole.partitions[3][whole.partitions[3].t < 0], whole.partitions[3:]])
    compare(quietly(client.persist(holes), client=client), expected)


def test_dask_arrays_are_channels(record, client, expected):
    da = pytest.importorskip("dask.array", reason="needs the extra dask")
    arrays = {name: da.from_array(record[name], chunks=9000) for name in record.names}
    compare(quietly({"zeit": da.from_array(record.time, chunks=7000), **arrays}, t="zeit", client=client), expected)


@pytest.mark.slow  # of other units of a file: test_streaming
def test_derivatives_by_differences_see_the_rows_of_other_partitions(record, frame, client):
    dd = pytest.importorskip("dask.dataframe", reason="needs the extra dask")
    options = {"chains": "x:v:", "inputs": ["u"], "dictionary": ["x", "v", "x**3", "u"], "smooth": "none"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = bq.discover(dd.from_pandas(frame, npartitions=7), client=client, **options)
        compare(found, bq.discover(record, **options), rtol=1e-6)


@pytest.mark.slow
def test_long_lists_of_records_are_sent_and_short_ones_are_not(record, client, expected, monkeypatch):
    parts = [record.take(slice(0, 20_000)), record.take(slice(20_000, 40_000))]
    sent = []
    submit = client.submit
    monkeypatch.setattr(client, "submit", lambda *args, **options: sent.append(args[0]) or submit(*args, **options))
    here = quietly(parts, client=client)
    assert not sent
    monkeypatch.setattr("bayeq.discovery.entry.MOST_ROWS", 10_000)
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "100 kiB"}), warnings.catch_warnings():
        warnings.filterwarnings("error", message="Sending large graph")
        compare(bq.discover(parts, **FEW, smooth="none", client=client), here)
    assert len(sent) > 28


@pytest.mark.slow
def test_the_likelihood_of_all_rows_is_that_of_threads(path, client, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", 300)
    monkeypatch.setattr("bayeq.discovery.streaming.whole.BLOCK_ROWS", 3000)
    (stream,) = open_streams([path])
    rows = [Extent(stream, 0, 6001)]  # a unit of one row says nothing
    found, here = (quietly(rows, smooth="auto", client=who) for who in (client, None))
    compare(found, here, rtol=1e-7)
    assert found.data.stretches == here.data.stretches == 20


# --- workers ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # of threads: test_streaming; of two workers: above
def test_any_number_of_workers_gives_the_same_bytes(path, record, client, folder):
    in_file = tuple(Extent(one, 0, one.bounds[-1]) for one in open_streams([path]))
    in_memory = (Extent(RecordStream(record), 0, record.n),)
    with local(1, folder) as alone:
        for extents in (in_file, in_memory):
            work = AsMeasured(extents, Roles.parse(**OSCILLATOR), TERMS, 0.2)
            sums = [
                fold(work, units_of(extents), executor, lambda *_: None, "rows").train.moments.cross
                for executor in (Cluster(client).map, Cluster(alone).map, partial(by_threads, workers=2))
            ]
            assert sums[0].tobytes() == sums[1].tobytes()
            np.testing.assert_allclose(sums[0], sums[2], rtol=1e-9, atol=1e-9 * np.abs(sums[2]).max())


def test_what_is_wrong_with_the_data_is_said_as_without_a_cluster(frame, client, folder):
    spoilt = frame.assign(x=frame.x.where(frame.index != 33_333))
    spoilt.to_parquet(folder / "spoilt.parquet", index=False, row_group_size=1000)
    with pytest.raises(RecordError, match="x"):
        quietly(folder / "spoilt.parquet", client=client)
    with pytest.raises(UnknownNameError, match="'acc'"):
        quietly(folder / "spoilt.parquet", client=client, acceleration="acc")


def test_files_that_workers_do_not_find_are_named(frame, client, folder):
    path = folder / "gone.parquet"
    frame.to_parquet(path, index=False, row_group_size=1000)

    def remove(stage, done, total):
        if stage == "rows":
            path.unlink(missing_ok=True)

    with pytest.raises(InputError, match=r"gone.parquet: a worker cannot read it .*same path"):
        quietly(path, client=client, progress=remove)


@pytest.mark.slow
def test_workers_that_die_one_after_the_other_end_the_work(folder):
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), local(1, folder) as client:
        with pytest.raises(BayeqError, match="memory") as error:
            list(Cluster(client).unordered(os._exit, [1]))
        assert "\n" not in str(error.value)
        client.wait_for_workers(1)
        assert list(Cluster(client).unordered(abs, [-2, 3])) in ([2, 3], [3, 2])
        client.scheduler_info()


# --- refused ---------------------------------------------------------------------------------------------------------


def test_what_cannot_be_read_by_a_cluster_is_refused(frame, client, path):
    da = pytest.importorskip("dask.array", reason="needs the extra dask")
    dd = pytest.importorskip("dask.dataframe", reason="needs the extra dask")
    whole = dd.from_pandas(frame, npartitions=2)
    dates = whole.assign(time=pd.Timestamp("2024-01-01"))
    column = da.ones(10)
    for data, options, message in (
        (whole, {"client": None}, "client="),
        (da.ones((10, 2)), {}, "mapping of channels"),
        ({"x": da.ones((10, 2))}, {}, "x: give Dask arrays of one dimension"),
        ({"x": column, "v": column[:5]}, {}, "unequal lengths: x 10, v 5"),
        ([whole, path], {}, "no record can be made of"),
        (whole, {"t": np.arange(3.0)}, "t names the column"),
        (dates, {"t": "time"}, "'time': holds dates"),
        (whole[whole.t < 0], {}, "no rows"),
        (path, {"client": "tcp://localhost:8786"}, "Client, not str"),
        (path, {"band": (0.5, 40), "smooth": "auto"}, "in no band"),
    ):
        with pytest.raises(InputError, match=message):
            quietly(data, **{"client": client, **options})
    with pytest.raises(UnknownNameError, match="'acc'"):
        quietly(whole, client=client, acceleration="acc")


def test_workers_of_another_version_are_refused(client, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.streaming.cluster.version", lambda _: "9.9")
    monkeypatch.setattr(client, "run", lambda *_: {"tcp://node7:4000": "0.1.0"})
    with pytest.raises(InputError, match=r"node7:4000 has bayeq 0.1.0, here it is 9.9: install the same"):
        Cluster(client)


@pytest.mark.slow
def test_a_cluster_without_workers_is_not_waited_for_for_ever(folder, monkeypatch):
    with local(0, folder) as client:
        monkeypatch.setattr("bayeq.discovery.streaming.cluster.JOIN", 0.2)
        with pytest.raises(InputError, match=r"no worker has joined the cluster in 0\.2 s: start some"):
            Cluster(client)
        monkeypatch.setattr("bayeq.discovery.streaming.cluster._require_workers", lambda _: None)
        monkeypatch.setattr("bayeq.discovery.streaming.cluster.LOOK", 0.1)
        monkeypatch.setattr("bayeq.discovery.streaming.cluster.COME_BACK", 0.3)
        with pytest.raises(BayeqError, match="all workers of the cluster have gone"):
            list(Cluster(client).unordered(abs, [1]))


def test_addresses_where_nobody_answers_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.streaming.cluster.ANSWER", 0.5)
    (tmp_path / "odd.json").write_text("[1]")
    for address, message in (
        ("tcp://127.0.0.1:9", "no Dask scheduler answers"),
        ("nonsense", "no Dask scheduler answers"),
        ("http://127.0.0.1:80", "no Dask scheduler answers"),
        ("tcp://127.0.0.1:none", "no Dask scheduler answers"),
        (str(tmp_path / "absent.json"), "no such file"),
        (str(tmp_path / "odd.json"), "no address"),
    ):
        with pytest.raises(InputError, match=message), connected(address):
            pass
    with socket.socket() as silent:  # listens, and says nothing
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(InputError, match="no Dask scheduler answers"), connected(address):
            pass


def test_without_dask_the_extra_is_named(monkeypatch, path, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[dask\]"), connected("tcp://127.0.0.1:9"):
        pass
    assert main(["discover", str(path), *OPTIONS, "--dask", "tcp://127.0.0.1:9"]) == 2
    assert "bayeq[dask]" in capsys.readouterr().err


def test_the_command_takes_no_whole_files_to_a_cluster(path, capsys):
    assert main(["discover", str(path), *OPTIONS, "--no-stream", "--dask", "tcp://127.0.0.1:9"]) == 2
    assert "--no-stream" in capsys.readouterr().err


# --- from the shell --------------------------------------------------------------------------------------------------


class Shell:
    """`dask scheduler` and two `dask worker`, each a process."""

    def __init__(self, folder):
        self.folder, self.file, self.started = folder, folder / "scheduler.json", []
        self.environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def start(self, *arguments):
        command = Path(sys.executable).with_name("dask")
        with (self.folder / f"{len(self.started)}.log").open("w") as log:
            process = subprocess.Popen(
                [command, *map(str, arguments), "--no-dashboard"],
                env=self.environment,
                cwd=self.folder,
                stdout=log,
                stderr=log,
            )
        self.started.append(process)
        return process

    def worker(self):
        return self.start("worker", "--scheduler-file", self.file, "--nthreads", 1, "--no-nanny")

    def __enter__(self):
        self.start("scheduler", "--host", "127.0.0.1", "--port", 0, "--scheduler-file", self.file)
        self.workers = [self.worker(), self.worker()]
        ends = time.monotonic() + 60
        while not self.file.exists():
            assert time.monotonic() < ends, (self.folder / "0.log").read_text()
            time.sleep(0.1)
        return self

    def __exit__(self, *_):
        for process in reversed(self.started):
            process.kill()
            process.wait(30)


@pytest.fixture(scope="module")
def shell(tmp_path_factory):
    with Shell(tmp_path_factory.mktemp("shell")) as found:
        yield found


def command(*arguments, **options):
    done = subprocess.run(
        [sys.executable, "-m", "bayeq", *map(str, arguments)], capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_commands_on_workers_from_the_shell(shell, path, expected, tmp_path):
    terms = ["--dictionary", ",".join(FEW["dictionary"])]
    found = json.loads(command("discover", path.name, *OPTIONS, *terms, "--dask", shell.file, cwd=path.parent))
    assert found["data"]["n"] == 40_000
    coefficients = {term["name"]: term["coef"] for term in found["equations"][0]["terms"]}
    assert coefficients == pytest.approx(
        dict(zip(*(expected.table()[name] for name in ("term", "coef")), strict=True)), rel=1e-8
    )
    study = ["--systems", "linear", "--algorithms", "rvm,vb", "--realisations", 6]
    command("study", "table2", *study, "--store", tmp_path / "there.db", "--dask", shell.file)
    run_study(tmp_path / "here.db", systems=["linear"], algorithms=["rvm", "vb"], realisations=6, jobs=1)
    rows = []
    for name in ("there.db", "here.db"):
        with Store(tmp_path / name) as store:
            rows.append([(r.index, r.algorithm, r.metrics, r.selected) for r in store.results()])
    assert len(rows[0]) == 12
    assert rows[0] == rows[1]


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_time_only(shell, path):
    with connected(str(shell.file)) as client:
        client.wait_for_workers(2, timeout=60)
        undisturbed = quietly(path, client=client)
        killed = []

        def kill(stage, done, total):
            if stage == "rows" and not killed:  # tasks are sent, and hardly any is done
                killed.append(shell.workers[0])
                threading.Timer(0.05, shell.workers[0].send_signal, [signal.SIGKILL]).start()

        disturbed = quietly(path, client=client, progress=kill)
        assert killed[0].wait(30) == -signal.SIGKILL
        assert as_bytes(disturbed) == as_bytes(undisturbed)
        shell.workers[0] = shell.worker()


@pytest.mark.slow
def test_a_scheduler_that_goes_ends_the_work_with_a_line(tmp_path, capfd):
    with Shell(tmp_path) as own, connected(str(own.file)) as client:
        threading.Timer(2.0, own.started[0].kill).start()
        with pytest.raises(BayeqError, match="scheduler of the cluster has gone") as error:
            list(Cluster(client).unordered(time.sleep, [1, 60]))
        assert "\n" not in str(error.value)
    assert "Traceback" not in capfd.readouterr().err
