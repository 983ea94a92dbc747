"""The pieces of `bayeq app`: commands, names, who is let in, processes. test_app_browser.py uses the page itself."""

from __future__ import annotations

import asyncio
import http.client
import os
import signal
import socket
import stat
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import bayeq as bq
from bayeq.app.choices import EQUATION, INPUT, READING, ROLES, Choice, Choices, chains_of, discover_command
from bayeq.app.server import Guard
from bayeq.app.session import LARGEST, LONGEST_NAME, Child, Session, Workspace, safe_name
from bayeq.cli.app import main
from bayeq.cli.discover import discover
from bayeq.errors import InputError
from tests.app_process import running_app

ROLE_OF = {"x": Choice("displacement"), "v": Choice("velocity"), "a": Choice("acceleration"), "u": Choice("input")}


def info_of(chains, inputs=(), others=(), command="bayeq discover run.csv --disp x"):
    """What `bayeq info --json` prints, as far as the page reads it."""
    names = [name for chain in chains for name in chain.split(":") if name]
    return {
        "channels": [{"name": name} for name in (*names, *inputs, *others)],
        "roles": {"chains": list(chains), "inputs": list(inputs), "undecided": list(others)},
        "next": {"command": command},
    }


# --- what is run -----------------------------------------------------------------------------------------------------


def test_the_command_holds_what_was_chosen():
    choices = Choices(dict(ROLE_OF), "x, v, x**3, u", rows=" 0:500", band="0.5:40", fs="1000")
    assert discover_command(["run 1.csv"], choices) == [
        "discover", "run 1.csv", "--chain", "x:v:a", "--input", "u", "--fs", "1000",
        "--dictionary", "x, v, x**3, u", "--rows", "0:500", "--band", "0.5:40",
        "--save", "equation.json", "--report", "report.html",
    ]  # fmt: skip
    bare = discover_command(["run.csv"], Choices({"x": Choice("displacement")}, "", rows="  "))
    assert bare == ["discover", "run.csv", "--chain", "x::", "--save", "equation.json", "--report", "report.html"]


def test_every_option_is_one_of_the_command_line():
    roles = ROLE_OF | {"x": Choice("displacement", unit=" mm", offset="0.2"), "v": Choice("velocity", offset="mean")}
    choices = Choices(roles, "x", "0:5", "1:2", "10", "u == 1\n\n v <= 0 ", dict.fromkeys(READING, "1"))
    words = discover_command(["run.csv", "other.csv"], choices)
    assert words[:3] == ["discover", "run.csv", "other.csv"]
    for option, values in (
        ("--units", ["x=mm"]), ("--remove-offset", ["x=0.2", "v"]), ("--constraint", ["u == 1", "v <= 0"])
    ):  # fmt: skip
        assert [words[k + 1] for k, word in enumerate(words) if word == option] == values
    known = {option for parameter in discover.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known


@pytest.mark.parametrize("text", ["--report=/tmp/x", "x; rm -rf ~", "$(id)", "`id`", "-100:", "--"])
def test_what_is_typed_is_the_value_of_its_option_and_nothing_else(text):
    roles = {"x": Choice("displacement", unit=text, offset=text)}
    choices = Choices(roles, dictionary=text, rows=text, band=text, constraints=text, reading={"--time": text})
    words = discover_command(["run.csv"], choices)
    context = discover.make_context("discover", words[1:], help_option_names=["-h", "--help"])  # which click keeps
    assert context.params["dictionaries"] == (text,)
    assert (context.params["rows"], context.params["band"]) == (text, text)
    assert (context.params["time"], context.params["constraints"]) == (text, (text,))
    assert (context.params["units"], context.params["offsets"]) == ((f"x={text}",), (f"x={text}",))
    assert context.params["report"] == Path("report.html")


@pytest.mark.parametrize(
    "chains", [["x:v:a"], ["x::a"], ["x1:v1:a1", "x2:v2:a2"], ["hare", "lynx"], ["h:dh"], ["p:dp", "q:dq"], ["::a"]]
)
def test_proposed_roles_make_the_proposed_chains(chains):
    choices = Choices.proposed(info_of(chains, ["u", "f"], ["other"])).roles
    assert chains_of(choices) == chains
    assert [name for name, choice in choices.items() if choice.role == INPUT] == ["u", "f"]
    assert choices["other"].role == ""
    # states alone have no numbers, which the page would have to show
    assert {choice.coordinate for choice in choices.values()} == {1} or any(":" in chain for chain in chains[1:])
    assert {choice.role for choice in choices.values()} <= set(ROLES)


def test_roles_that_make_no_chain_are_said():
    with pytest.raises(InputError, match="no channel has a role"):
        chains_of({"x": Choice(), "u": Choice("input")})
    with pytest.raises(InputError, match="x and y have both the role 'displacement' of coordinate 1"):
        chains_of({"x": Choice("displacement"), "y": Choice("displacement")})
    with pytest.raises(InputError, match="dx is the rate of a state"):
        chains_of({"x": Choice("state"), "y": Choice("state"), "dx": Choice("rate")})
    assert chains_of({"x": Choice("displacement", 2), "y": Choice("displacement")}) == ["y::", "x::"]


def test_options_about_reading_are_those_of_the_proposal():
    command = "bayeq discover run.csv --time 'T sec' --group trial --fs 50 --chain x --dictionary polynomial:3"
    choices = Choices.proposed(info_of(["x"], command=command))
    assert choices.words == ["--time", "T sec", "--group", "trial"]
    assert (choices.fs, choices.dictionary) == ("50", "polynomial:3")
    assert Choices.proposed(info_of(["x"], command="bayeq discover run.csv --fs RATE --chain x")).fs == ""


# --- files -----------------------------------------------------------------------------------------------------------


@example("a" * 79 + " b")  # a name that is cut ends in no space
@example("0" * 18 + "\u00aa" * 2 + "\u00b2" * 5 + "\u0904" * 15 + " \u0904")
@given(st.text(max_size=300))
def test_a_safe_name_is_a_name_in_its_folder(name):
    safe = safe_name(name)
    assert Path(safe).name == safe
    assert safe not in (".", "..")
    assert safe[0] not in " -."
    assert not set(safe) & set("/\\:*?\"<>|\0$`';&\n")
    assert len(safe.encode()) <= 4 * LONGEST_NAME
    assert safe_name(safe) == safe


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("run.csv", "run.csv"),
        ("/etc/passwd", "passwd"),
        ("C:\\data\\run.mat", "run.mat"),
        ("messung größe.xlsx", "messung größe.xlsx"),
        ("--report", "report"),
        (f"{'x' * 300}.csv.gz", f"{'x' * (LONGEST_NAME - 7)}.csv.gz"),
        ("", "record"),
    ],
)
def test_names_of_files(name, safe):
    assert safe_name(name) == safe


def test_the_folder_is_private_and_goes():
    workspace = Workspace()
    inner = workspace.new_folder()
    assert workspace.new_folder() != inner
    if os.name == "posix":
        assert {stat.S_IMODE(path.stat().st_mode) for path in (workspace.path, inner)} == {0o700}
    with pytest.raises(ValueError, match="is not in"):
        workspace.remove(workspace.path.parent)
    workspace.remove()
    assert not workspace.path.exists()


# --- who is let in ---------------------------------------------------------------------------------------------------

HOST = "127.0.0.1:8000"
COOKIE = {"cookie": "other=1; bayeq_app_8000=secret"}


def answered(headers, kind="http", path="/", query="", method="GET"):
    """What the guard answers: a code, and whether the application behind it was reached."""
    reached, sent = [], []

    async def behind(scope, receive, send):
        reached.append(scope["path"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {
        "type": kind, "path": path, "query_string": query.encode(), "method": method,
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
    }  # fmt: skip
    asyncio.run(Guard(behind, HOST, "secret")(scope, None, send))
    first = sent[0]
    return first.get("status", first.get("code")), bool(reached), dict(first.get("headers", ()))


def test_the_token_is_exchanged_for_a_cookie():
    code, reached, headers = answered({"host": HOST}, query="token=secret")
    assert (code, reached) == (303, False)
    assert headers[b"location"] == b"/"  # without the token
    assert b"HttpOnly; SameSite=Lax" in headers[b"set-cookie"]
    assert answered({"host": HOST, **COOKIE})[:2] == (200, True)


@pytest.mark.parametrize(
    ("headers", "request_", "code"),
    [
        ({"host": HOST}, {}, 403),
        ({"host": HOST}, {"query": "token=wrong"}, 403),
        ({"host": HOST}, {"query": "token=secret", "path": "/report.html"}, 403),
        ({"host": HOST, "cookie": "bayeq_app_8000=sécret"}, {}, 403),
        ({"host": HOST, "cookie": "bayeq_app_9000=secret"}, {}, 403),
        ({"host": "rebound.example", **COOKIE}, {}, 421),
        ({"host": "127.0.0.1", **COOKIE}, {}, 421),
        ({**COOKIE}, {}, 421),
        ({"host": HOST, "origin": "http://other.example", **COOKIE}, {}, 403),
        ({"host": HOST, "origin": "null", **COOKIE}, {}, 403),
        ({"host": HOST, **COOKIE}, {"kind": "websocket"}, 1008),
        ({"host": HOST, "origin": "http://127.0.0.1:9000", **COOKIE}, {"kind": "websocket"}, 1008),
        ({"host": HOST, "origin": f"http://{HOST}"}, {"kind": "websocket"}, 1008),
        ({"host": HOST, "content-length": str(2 * LARGEST), **COOKIE}, {"method": "POST"}, 413),
        ({"host": HOST, **COOKIE}, {"method": "POST"}, 411),
    ],
)
def test_others_are_refused(headers, request_, code):
    assert answered(headers, **request_)[:2] == (code, False)


def test_the_page_itself_is_let_in():
    mine = {"host": HOST, "origin": f"http://{HOST}", **COOKIE}
    assert answered(mine, kind="websocket")[1]
    assert answered({**mine, "content-length": "1000"}, method="POST")[1]
    _, _, headers = answered(mine)
    assert b"default-src 'self'" in headers[b"content-security-policy"]
    assert b"http" not in headers[b"content-security-policy"]


# --- processes -------------------------------------------------------------------------------------------------------


def test_a_child_says_its_error_in_a_line(tmp_path):
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,one\n")
    outcome = asyncio.run(Child(["info", "bad.csv", "--json"], tmp_path, lambda line: None).run())
    assert "line 3" in outcome.error
    assert "one" in outcome.error
    assert "\n" not in outcome.error
    assert not outcome.error.startswith("bayeq")


def test_a_file_in_the_folder_is_never_imported(tmp_path, monkeypatch):
    """A file that was dropped and is called as a module of Python's."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.environ.get("PYTHONPATH", ""), "", "."]))
    for name in ("json.py", "click.py", "numpy.py"):
        (tmp_path / name).write_text("import os; os._exit(77)\n")
    outcome = asyncio.run(Child(["systems"], tmp_path, lambda line: None).run())
    # "." was this folder when the test began, which the child does not take for its own
    assert outcome.error == ""
    assert "duffing" in outcome.out


def test_a_child_is_stopped(tmp_path):
    bq.write(bq.simulate("duffing", n=5000, seed=1), tmp_path / "run.csv")
    lines = []

    async def stopped():
        child = Child(["discover", "run.csv", "--chain", "x:v:a", "--input", "u", "--verbose"], tmp_path, lines.append)
        work = asyncio.create_task(child.run())
        while not lines:
            await asyncio.sleep(0.05)
        await child.stop()
        return child._process.pid, await work

    began = time.monotonic()
    pid, outcome = asyncio.run(stopped())
    assert outcome.stopped
    assert outcome.error == ""
    assert time.monotonic() - began < 30
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_session_keeps_what_is_open_when_another_file_is_bad(tmp_path):
    session = Session(Workspace())
    bad = session.workspace.new_folder() / "bad.csv"
    bad.write_text("no table\n")
    good = tmp_path / "run.csv"
    bq.write(bq.simulate("linear", n=300, seed=1), good)

    async def opened():
        await session.open(good, good.name)
        await session.open(bad, bad.name)

    try:
        asyncio.run(opened())
        assert session.opened.name == "run.csv"
        assert session.choices.roles["x"].role == "displacement"
        assert session.file_error.startswith("bad.csv")  # without its folder
        assert not bad.exists()
        assert good.exists()
        session.choices.roles["v"].role = "displacement"
        asyncio.run(session.discover())
        assert "x and v have both the role" in session.run_error
        assert session.busy == ""
    finally:
        session.close()
    assert not session.workspace.path.exists()


def test_a_session_reads_again_and_takes_further_records(monkeypatch):
    # without the report, whose pictures take most of the time
    monkeypatch.setattr("bayeq.app.session.discover_command", lambda *given: discover_command(*given)[:-2])
    session = Session(Workspace())
    first, second = (session.workspace.new_folder() / "run.csv" for _ in range(2))
    for seed, path in enumerate((first, second)):
        rows = bq.simulate("linear", n=300, seed=seed)
        np.savetxt(path, np.column_stack([rows.time, *rows.channels.values()]), delimiter=",", header="run\nt,x,v,a,u")

    async def opened():
        await session.open(first, first.name)
        session.choices.reading |= {"--skip": "2", "--names": "t,p,q,r,s"}
        await session.read_again()
        session.further.append(second)
        session.choices.roles = {"p": Choice("displacement"), "r": Choice("acceleration"), "s": Choice("input")}
        session.choices.dictionary = "p, dp, s"
        await session.discover()

    try:
        asyncio.run(opened())
        assert (session.file_error, session.run_error) == ("", "")
        assert [one["name"] for one in session.opened.info["channels"]] == ["p", "q", "r", "s"]
        assert session.words()[:3] == ["discover", "run.csv", "record2_run.csv"]
        assert session.words()[3:7] == ["--names", "t,p,q,r,s", "--skip", "2"]
        assert bq.load(session.result.folder / EQUATION).data.n == 600
        session.further.append(session.workspace.path / "other.csv")
        assert session.words()[2:4] == ["record2_run.csv", "other.csv"]  # a number where the name is there already
        session.further.pop()
        session.drop(second)
        assert not second.exists()
        session.choices.reading["--skip"] = "no"
        asyncio.run(session.read_again())
        assert "--skip" in session.file_error
        assert first.exists()  # what was open stays open
    finally:
        session.close()


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert main(["app"]) == 2
    assert "bayeq[app]" in capsys.readouterr().err


def test_bad_arguments_are_said(tmp_path, capsys):
    pytest.importorskip("nicegui", reason="the extra [app] is not installed")
    assert main(["app", str(tmp_path / "no.csv")]) == 2
    assert "no.csv: there is no such file" in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["app", "--port", port]) == 2
        assert f"--port {port}: " in capsys.readouterr().err
    assert main(["app", "--port", "70000"]) == 2
    assert "a port is a number" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_running_page_is_of_this_computer_alone_and_leaves_nothing(tmp_path):
    pytest.importorskip("nicegui", reason="the extra [app] is not installed")
    with running_app(cwd=tmp_path, TMPDIR=str(tmp_path)) as (process, address):
        host, _, token = address.removeprefix("http://").partition("/?token=")
        name, port = host.split(":")
        assert name == "127.0.0.1"
        assert len(token) >= 32
        (folder,) = tmp_path.iterdir()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700

        def get(path, **headers):
            with closing(http.client.HTTPConnection(name, int(port), timeout=20)) as connection:
                connection.request("GET", path, headers={"Host": host, **headers})
                answer = connection.getresponse()
                return answer.status, answer.getheader("Set-Cookie", ""), answer.read().decode()

        code, cookie, _ = get(f"/?token={token}")
        assert code == 303
        mine = {"Cookie": cookie.split(";")[0]}
        code, _, page = get("/", **mine)
        assert code == 200
        assert "bayeq" in page
        assert token not in page
        assert get("/report.html", **mine)[0] == 404  # nothing was found yet
        assert get("/")[0] == 403
        assert get("/", **mine, Host="rebound.example")[0] == 421
        assert get("/", **mine, Origin="http://other.example")[0] == 403
        upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        upgrade["Sec-WebSocket-Key"] = "dGhlIHNhbXBsZSBub25jZQ=="
        socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
        assert get(socket_path, **mine, **upgrade, Origin="http://other.example")[0] == 403
        assert get("/_nicegui_ws/socket.io/?EIO=4&transport=polling")[0] == 403
        if sys.platform == "linux":  # every address of 127.0.0.0/8 is this computer's
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.2", int(port)), timeout=5)
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=20)
    assert list(tmp_path.iterdir()) == []
