"""The promises of SECURITY.md: nothing of a file or a user is run, followed out of place, or unpacked without limit."""

from __future__ import annotations

import ast
import importlib.util
import io
import json
import struct
import sys
import tracemalloc
import zipfile
from copy import copy
from pathlib import Path

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import BayeqError, ExpressionError, InputError
from bayeq.expressions import parse
from bayeq.records import read

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "bayeq"
MEMORY = 300 * 2**20

# --- the source ------------------------------------------------------------------------------------------------------

BUILTINS = {"eval", "exec", "compile", "__import__", "breakpoint", "input"}
ATTRIBUTES = {
    "os": {"system", "popen", "execv", "execve", "spawnl", "spawnv", "startfile"},
    "pickle": {"load", "loads", "Unpickler"},
    "marshal": {"load", "loads"},
    "shelve": {"open"},
    "dill": {"load", "loads"},
    "cloudpickle": {"load", "loads"},
    "joblib": {"load"},
    "yaml": {"load", "unsafe_load", "full_load"},
    "pd": {"read_pickle", "eval", "read_html", "read_xml"},
    "pandas": {"read_pickle", "eval"},
    "np": {"load"},
    "sympy": {"sympify", "S", "parse_expr", "lambdify", "parse_latex"},
    "subprocess": {"getoutput", "getstatusoutput"},
    "ctypes": {"CDLL"},
}
# The local page, the address of a cluster that the user names, and the name of this machine.
LISTENS = {"app/server.py", "discovery/streaming/cluster.py", "resumable/store.py"}
ANYWHERE = {"sympify", "parse_expr", "lambdify", "eval", "read_pickle"}


def name_of(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def unsafe_calls(tree: ast.AST) -> list[str]:
    """Calls that could run what they are given, with their lines."""
    out = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = name_of(node.func)
        module, _, last = called.rpartition(".")
        bad = called in BUILTINS or last in ATTRIBUTES.get(module, ()) or last in ANYWHERE
        for keyword in node.keywords:
            value = getattr(keyword.value, "value", None)
            bad |= keyword.arg in ("shell", "allow_pickle") and value is not False
            bad &= not (called == "np.load" and keyword.arg == "allow_pickle" and value is False)
        if bad:
            out.append(f"{called or '?'} in line {node.lineno}")
    return out


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda p: str(p.relative_to(SOURCE)))
def test_no_source_file_runs_text(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert unsafe_calls(tree) == []
    imported = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    imported |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not imported & {"pickle", "shelve", "dill", "cloudpickle", "yaml", "xmlrpc", "telnetlib", "code", "imp"}
    assert not imported & {"urllib.request", "http.client", "requests", "ftplib", "smtplib"}
    assert "socket" not in imported or str(path.relative_to(SOURCE)) in LISTENS


@pytest.mark.parametrize(
    "text",
    [
        "eval('1')",
        "exec(code)",
        "compile(a, b, 'exec')",
        "os.system(x)",
        "subprocess.run(x, shell=True)",
        "subprocess.run(x, shell=flag)",
        "np.load(x, allow_pickle=True)",
        "sympy.lambdify(a, b)",
        "parse_expr(text)",
        "frame.eval(text)",
        "pickle.loads(x)",
    ],
)
def test_the_rule_sees_what_it_forbids(text):
    assert unsafe_calls(ast.parse(text))


# --- a corpus of what would like to be run ---------------------------------------------------------------------------

MARK = "harm"
RUN = [
    "__import__('os').system('touch harm')",
    "().__class__.__bases__[0].__subclasses__()",
    "exec(\"open('harm','w')\")",
    "open('harm','w')",
    "x.__init__.__globals__",
    "(lambda: open('harm','w'))()",
    "[open('harm','w') for x in [1]]",
    "f\"{open('harm','w')}\"",
    "`touch harm`",
    "$(touch harm)",
    "x; import os",
    "x\nimport os",
    "{{7*7}}",
    "${7*7}",
    "%s%n%x",
    "=cmd|'/C touch harm'!A0",
    '=HYPERLINK("http://localhost/")',
    "@SUM(1+1)*cmd|'/C touch harm'!A0",
    "<script>alert(1)</script>",
    "../../../../tmp/harm",
    "/etc/passwd",
    "\\\\server\\share",
    "x' OR 1=1 --",
    "!!python/object/apply:os.system ['touch harm']",
    "cos\nsystem\n(S'touch harm'\ntR.",
    "sympify('x')",
    "Symbol('x')",
    "\x1b]0;title\x07",
    "\u202etxt.exe",
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert not list(tmp_path.rglob(MARK))
    assert not Path("/tmp/harm").exists()


@pytest.fixture
def bounded():
    """Fails a test that allocates more than `MEMORY` bytes."""
    tracemalloc.start()
    yield
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < MEMORY, peak


@pytest.mark.parametrize("text", RUN)
def test_terms_are_refused(here, text):
    with pytest.raises(ExpressionError):
        parse(text)
    record = bq.simulate("duffing", n=60, seed=1)
    with pytest.raises(InputError):
        bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=[text])
    with pytest.raises(InputError):
        bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v"], constraints=[f"{text} == 1"])


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".json", ".xlsx", ".h5", ".mat", ".parquet"])
@pytest.mark.parametrize("name", RUN)
def test_names_of_channels_are_names(here, suffix, name):
    """A channel has a name that a term can use, whatever the file calls it."""
    path, values = here / f"a{suffix}", np.arange(5.0)
    try:
        if suffix == ".csv":
            cells = ['"' + text.replace('"', '""') + '"' for text in ("t", name)]
            path.write_text(",".join(cells) + "\n" + "\n".join(f"{v},{v * v}" for v in values), encoding="utf-8")
        elif suffix == ".npz":
            np.savez(path, **{name: values, "t": values})
        elif suffix == ".json":
            path.write_text(json.dumps({"t": values.tolist(), name: values.tolist()}))
        elif suffix == ".xlsx":
            book = pytest.importorskip("openpyxl", reason="needs openpyxl, pip install 'bayeq[files]'").Workbook()
            book.active.append(["t", name])
            for v in values:
                book.active.append([v, v * v])
            book.save(path)
        elif suffix == ".h5":
            with pytest.importorskip("h5py", reason="needs h5py, pip install 'bayeq[files]'").File(path, "w") as file:
                file["t"], file[name] = values, values
        elif suffix == ".mat":
            from scipy.io import savemat

            savemat(path, {"s": {name[:31]: values}, "t": values})
        else:
            pa = pytest.importorskip("pyarrow", reason="needs pyarrow, pip install 'bayeq[parquet]'")
            import pyarrow.parquet as pq

            pq.write_table(pa.table({"t": values, name: values}), path)
    except (ValueError, KeyError, OSError, TypeError, Warning):
        pytest.skip("the format cannot hold this name")
    except Exception as error:
        if type(error).__name__ != "IllegalCharacterError":
            raise
        pytest.skip("the format cannot hold this name")
    try:
        record = read(path)
    except BayeqError as refused:
        message = str(refused)
    else:
        message = ""
        assert all(channel.isidentifier() for channel in record.names)
    assert "\n" not in message
    assert [p.name for p in here.iterdir()] == [path.name]  # nothing was unpacked beside it


@pytest.mark.parametrize("text", RUN)
def test_the_command_line_says_one_line(here, text, capsys):
    bq.write(bq.simulate("duffing", n=60, seed=1), here / "r.csv")
    for given in (
        ["--disp", text],
        ["--chain", text],
        ["--chain", "x:v:a", "--dictionary", text],
        ["--chain", "x:v:a", "--noise", text],
        ["--chain", "x:v:a", "--units", text],
        ["--chain", "x:v:a", "--rows", text],
        ["--chain", "x:v:a", "--constraint", text],
    ):
        assert main(["discover", "r.csv", *given]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert "Traceback" not in said.err
        assert "\x1b]" not in said.err
    assert main(["info", text]) == 2
    capsys.readouterr()


# --- saved equations -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> dict:
    record = bq.simulate("duffing", n=80, seed=1)
    with pytest.warns(bq.errors.BayeqWarning):
        eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "u"], smooth="none", method="vb")
    path = tmp_path_factory.mktemp("saved") / "eq.json"
    eq.save(path)
    return json.loads(path.read_text())


def names_in(content: object, name: str, place: tuple = ()) -> list[tuple]:
    """Where a text stands in a tree of JSON."""
    if isinstance(content, dict):
        return [at for key, value in content.items() for at in names_in(value, name, (*place, key))]
    if isinstance(content, list):
        return [at for k, value in enumerate(content) for at in names_in(value, name, (*place, k))]
    return [place] if content == name else []


@pytest.mark.parametrize("text", RUN)
def test_a_saved_file_names_nothing_but_names(here, saved, text):
    for name in ("x", "v", "a", "u"):
        places = names_in(saved, name)
        assert places
        for place in places:
            content = json.loads(json.dumps(saved))
            holder = content
            for key in place[:-1]:
                holder = holder[key]
            holder[place[-1]] = text
            path = here / "eq.json"
            path.write_text(json.dumps(content))
            try:
                eq = bq.load(path)
            except InputError as refused:
                assert "\n" not in str(refused)  # noqa: PT017
                continue
            # what is loaded all the same is text that no program is made of
            made = [eq.to_code(language) for language in ("python", "c", "matlab")] if hasattr(eq, "to_code") else []
            assert not any(MARK in line for source in made for line in source.splitlines())


@pytest.mark.parametrize("text", RUN)
def test_names_of_channels_in_a_saved_file_are_checked(here, saved, text):
    """Also of an input that no term uses, which no parser of terms sees."""
    record = bq.simulate("duffing", n=80, seed=1)
    with pytest.warns(bq.errors.BayeqWarning):
        eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v"], smooth="none", method="vb")
    path = here / "eq.json"
    eq.save(path)
    content = json.loads(path.read_text())
    assert content["data"]["inputs"] == ["u"]
    content["data"]["inputs"] = [text]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError) as caught:
        bq.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000, '"' + "a" * 10**6, "\x00"])
def test_deep_and_endless_json_is_refused(here, content):
    path = here / "eq.json"
    path.write_text(content)
    for use in (bq.load, read):
        with pytest.raises(InputError) as caught:
            use(path)
        assert "\n" not in str(caught.value)


# --- archives and XML ------------------------------------------------------------------------------------------------


def test_members_of_archives_stay_inside(here):
    inside = here / "inside"
    inside.mkdir()
    array = io.BytesIO()
    np.save(array, np.arange(5.0))
    for name in ("../out.npy", "/tmp/harm.npy", "a/../../out.npy", "C:\\out.npy"):
        with zipfile.ZipFile(inside / "a.npz", "w") as archive:
            archive.writestr("t.npy", array.getvalue())
            archive.writestr(name, array.getvalue())
        assert all(channel.isidentifier() for channel in read(inside / "a.npz").names)
        assert [p.name for p in here.rglob("*")] == ["inside", "a.npz"]


def test_members_that_overlap_or_lie_about_their_size(here, bounded):
    array = io.BytesIO()
    np.save(array, np.zeros(2_000_000))
    path = here / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("c0.npy", array.getvalue())
        for k in range(1, 300):  # names for the same bytes
            member = copy(archive.filelist[0])
            member.filename = f"c{k}.npy"
            archive.filelist.append(member)
    assert path.stat().st_size < 1e5
    with pytest.raises(InputError, match=r"the archive takes 4.47 GiB; at most 4 GiB are read"):
        read(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", array.getvalue())
    raw = path.read_bytes()
    path.write_bytes(raw.replace(struct.pack("<I", len(array.getvalue())), struct.pack("<I", 300)))
    with pytest.raises(InputError):
        read(path)


def with_sheet(path: Path, sheet: str, shared: str | None = None) -> None:
    """A workbook with other XML in it."""
    openpyxl = pytest.importorskip("openpyxl", reason="needs openpyxl, pip install 'bayeq[files]'")
    book, made = openpyxl.Workbook(), io.BytesIO()
    book.active.append(["t", "x"])
    book.save(made)
    with zipfile.ZipFile(made) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "xl/worksheets/sheet1.xml":
                content = sheet.encode()
            elif name == "xl/sharedStrings.xml" and shared is not None:
                content = shared.encode()
            new.writestr(name, content)


SHEET = (
    '<?xml version="1.0"?>{head}<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
    "{rows}</sheetData></worksheet>"
)
ROWS = "".join(
    f'<row r="{k}"><c r="A{k}"><v>{k}</v></c><c r="B{k}" t="inlineStr"><is><t>{{text}}</t></is></c></row>'
    for k in range(1, 5)
)


def test_entities_of_xml_do_not_grow(here, bounded):
    levels = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12))
    head = f'<!DOCTYPE w [<!ENTITY l0 "lol">{levels}]>'
    with_sheet(here / "a.xlsx", SHEET.format(head=head, rows=ROWS.format(text="&l11;")))
    with pytest.raises(InputError) as caught:
        read(here / "a.xlsx")
    assert "\n" not in str(caught.value)
    quadratic = f'<!DOCTYPE w [<!ENTITY a "{"a" * 100_000}">]>'
    with_sheet(here / "b.xlsx", SHEET.format(head=quadratic, rows=ROWS.format(text="&a;" * 5000)))
    with pytest.raises(InputError):
        read(here / "b.xlsx")


def test_entities_of_xml_read_no_file(here):
    (here / "secret.txt").write_text("42.5")
    for place in ((here / "secret.txt").as_uri(), "http://localhost:9/x"):
        head = f'<!DOCTYPE w [<!ENTITY s SYSTEM "{place}">]>'
        with_sheet(here / "a.xlsx", SHEET.format(head=head, rows=ROWS.format(text="&s;").replace("inlineStr", "n")))
        try:
            found = read(here / "a.xlsx")
        except InputError as refused:
            assert "42.5" not in str(refused)  # noqa: PT017
        else:
            assert not any((values == 42.5).any() for values in found.channels.values())


def test_a_sheet_that_unpacks_to_far_more(here, bounded):
    with_sheet(here / "a.xlsx", SHEET.format(head="", rows="<row></row>" * 12_000_000))
    with pytest.raises(InputError, match=r"claims .* MiB in a file of"):
        read(here / "a.xlsx")


def test_formulas_keep_the_saved_value(here):
    formula = '<f>WEBSERVICE("http://localhost:9")</f>'
    rows = "".join(
        f'<row r="{k}"><c r="A{k}"><v>{k}</v></c><c r="B{k}">{formula}<v>{k * 2}</v></c></row>' for k in range(1, 6)
    )
    with_sheet(here / "a.xlsx", SHEET.format(head="", rows=rows))
    assert sorted(v for values in read(here / "a.xlsx").channels.values() for v in values)[-1] == 10.0


# --- MATLAB and HDF5 -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [3, 16, 17, 18, 255])
def test_objects_of_matlab_are_no_channels(here, kind):
    from scipy.io import savemat

    savemat(here / "a.mat", {"f": np.arange(5.0), "x": np.arange(5.0)})
    raw = bytearray((here / "a.mat").read_bytes())
    assert raw[144] == 6  # the class of the first variable, double
    raw[144] = kind
    (here / "a.mat").write_bytes(raw)
    try:
        names = read(here / "a.mat").names
    except InputError as refused:
        assert "\n" not in str(refused)  # noqa: PT017
    else:
        assert names == ("x",)


def test_links_of_hdf5_stay_in_the_file(here):
    h5py = pytest.importorskip("h5py", reason="needs h5py, pip install 'bayeq[files]'")
    with h5py.File(here / "secret.h5", "w") as file:
        file["x"] = np.full(5, 42.5)
    with h5py.File(here / "a.h5", "w") as file:
        group = file.create_group("g")
        group["x"] = h5py.ExternalLink(str(here / "secret.h5"), "/x")
        file["u"] = np.arange(5.0)
        file["soft"] = h5py.SoftLink("/g/x")
        file["round"] = h5py.SoftLink("/round")
    try:
        found = read(here / "a.h5")
    except InputError as refused:
        assert "another file" in str(refused)  # noqa: PT017
    else:
        assert not any((values == 42.5).any() for values in found.channels.values())


# --- what else is read -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"garbage", b"SQLite format 3\0" + bytes(84), b"\x80\x04cos\nsystem\n."])
def test_files_of_studies(here, content, capsys):
    (here / "study.db").write_bytes(content)
    assert main(["study", "show", "study.db"]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err


def audit():
    spec = importlib.util.spec_from_file_location("audit", ROOT / ".ci" / "audit.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_audit_says_one_line(capsys, tmp_path):
    module = audit()
    fine = {"name": "numpy", "version": "2.0", "vulns": []}
    weak = {"name": "old", "version": "1.0", "vulns": [{"id": "CVE-1"}]}
    unknown = {"name": "new", "skip_reason": "not found"}
    assert module.verdict([fine]) == (0, "1 packages, no known vulnerability")
    assert module.verdict([fine, weak, unknown]) == (
        1,
        "1 of 3 packages have known vulnerabilities: old 1.0 (CVE-1)",
    )
    assert module.verdict([fine, unknown])[0] == 2
    assert module.verdict([])[0] == 2
    script = tmp_path / "answers.py"
    script.write_text("import sys; sys.exit('ConnectionError: no route')")
    assert module.main([sys.executable, str(script)]) == 2
    assert module.main([str(tmp_path / "nothing")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "audit: pip-audit gave no answer: ConnectionError: no route"
    assert len(said) == 2
