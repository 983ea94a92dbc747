"""The report: one page, nothing loaded, nothing of a file run, read in a real browser where there is one."""

from __future__ import annotations

import base64
import hashlib
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from html.parser import HTMLParser

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.report.page import _wanted, as_bokeh, repeat_command, samples_hash, without_maths
from bayeq.errors import InputError, MissingExtraError, UnknownNameError
from bayeq.expressions import parse
from bayeq.expressions.symbolic import mathml
from bayeq.figures import style

pytest.importorskip("matplotlib")
pytest.importorskip("bokeh")

ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
UNITS = {"x": "<img src=x onerror=alert(2)>", "v": "$m/s", "a": '"><script>alert(3)</script>', "u": "N&<"}


class Page(HTMLParser):
    """Elements of a page with their attributes, its texts, and the contents of its scripts."""

    VOID = frozenset({"meta", "link", "img", "br", "hr", "input"})

    def __init__(self, text):
        super().__init__()
        self.elements, self.scripts, self.texts, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        (self.scripts if self.open[-1:] == ["script"] else self.texts).append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=800, seed=1)


@pytest.fixture(scope="module")
def eq(record):
    return bq.discover(record, **ROLES, dictionary="x, v, x**3, v*abs(v), sign(v), u")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory, record):
    """A report, by the command line, of a file whose name, channels and units would like to be run."""
    folder = tmp_path_factory.mktemp("hostile") / "<script>alert(1)<"
    folder.mkdir()
    file = folder / "script><img src=x onerror=alert(4)>.csv"
    head = ",".join(f'"{name} [{unit.replace(chr(34), chr(34) * 2)}]"' for name, unit in UNITS.items())
    rows = np.column_stack([record.time, *(record[name] for name in UNITS)])
    np.savetxt(file, rows, delimiter=",", header=f"t [s],{head}", comments="")
    out = folder / "out.html"
    given = ["discover", str(file), "--chain", "x:v:a", "--input", "u", "--dictionary", "x, v, x**3, u"]
    assert main([*given, "--report", str(out)]) == 0
    return file, out


def without_pictures(patch):
    """Those of `hostile` are looked at."""
    patch.setattr("bayeq.equation.report.page.pictures", lambda *_: ([], []))


@pytest.fixture(scope="module")
def page(eq, record, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "out.html"
    with pytest.MonkeyPatch.context() as patch:
        without_pictures(patch)
        eq.report(out, record)
    return Page(out.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def illustrated(hostile):
    return Page(hostile[1].read_text(encoding="utf-8"))


def test_the_page_has_what_was_found(page, eq):
    text = page.text
    assert text.index("Verdict: found") < text.index("x**3") < text.index("Data and settings")
    assert eq[0].text in text
    for term in ("x", "v", "x**3", "u", "intercept"):
        assert term in [piece.strip() for piece in page.texts]
    coef = f"{eq[0].shown_coef['u']:.3f}"
    assert any(piece.startswith(coef) for piece in page.texts)
    assert len(page.all("math")) >= 5


def test_the_page_has_pictures_and_loads_nothing(illustrated):
    page = illustrated
    assert len(page.all("figure")) == len(page.all("img")) >= 12
    for tag, attributes in page.elements:
        for name in ("src", "href", "data", "action"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)
    (policy,) = [a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "'unsafe-inline'" not in policy.split("style-src")[0]
    assert "http" not in policy


def test_the_policy_lets_these_scripts_run_and_no_other(illustrated):
    page = illustrated
    (policy,) = [a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    run = [a for a in page.all("script") if a.get("type") != "application/json"]
    allowed = re.findall(r"'sha256-([^']+)'", policy)
    assert len(allowed) == len(run) == 2
    found = {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in page.scripts}
    assert set(allowed) <= found


def test_without_a_record_there_are_fewer_pictures_and_no_samples(eq, tmp_path):
    eq.save(tmp_path / "eq.json")
    bq.load(tmp_path / "eq.json").report(tmp_path / "out.html")
    page = Page((tmp_path / "out.html").read_text(encoding="utf-8"))
    assert len(page.all("figure")) == 1  # coefficients; no probability is in doubt
    assert "SHA-256" not in page.text
    assert "Verdict: found" in page.text


def test_the_method_is_a_word(page):
    assert "auto (bayeq discover -h)" in page.text


def test_physical_parameters_and_the_verdict_once(page, eq):
    text = page.text
    assert text.count("Verdict:") == 1
    assert text.index("m*a + c*v + k*x + k3*x**3 = u") < text.index(eq[0].text)
    for q in eq.physical():
        if q.symbol != "omega_n":
            assert f"{q.symbol} " in text
            assert q.meaning in text
    assert "natural frequency" in text
    assert "N/m³" in text
    assert f"Checked on {eq[0].held_out.n} rows that were not used" in text
    assert f"{eq.data.n_held_out} held out" in text
    assert "* over all equations" not in text  # no interval is marked


def test_no_pictures_of_no_equation(tmp_path):
    rng = np.random.default_rng(0)
    walk = rng.standard_normal((3, 300)).cumsum(axis=1)
    record = bq.Record(dict(zip("xau", walk, strict=True)), np.arange(300) / 100)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eq = bq.discover(record, chains="x::a", inputs="u", dictionary="x, x**2, u")
    assert eq.verdict.kind == "none"
    eq.report(tmp_path / "out.html", record)
    page = Page((tmp_path / "out.html").read_text(encoding="utf-8"))
    assert not page.all("figure")
    assert "Physical parameters" not in page.text
    assert "No equation of a was found" in page.text
    assert page.text.index("bayeq info") < page.text.index("Warnings")


def test_an_interval_over_models_is_explained_where_it_stands(tmp_path):
    record = bq.simulate("duffing", n=1000, noise=0.1, seed=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eq = bq.discover(record, **ROLES)
    assert eq[0].printed_over_models.any()
    eq.report(tmp_path / "out.html")
    page = Page((tmp_path / "out.html").read_text(encoding="utf-8"))
    assert page.text.count("* over all equations that hold the term") == 1
    assert sum(piece.endswith(" *") for piece in page.texts) >= eq[0].printed_over_models.sum()
    assert len(page.all("figure")) == 2  # a probability is in doubt


def test_several_equations_and_records(tmp_path, monkeypatch):
    records = [bq.simulate("lorenz", n=300, seed=seed) for seed in (0, 1)]
    eq = bq.discover(records, chains=["x", "y"], inputs=["z"], dictionary="x, y, x*z")
    captions = [caption for _, _, caption in _wanted(eq, records[0])]
    assert {
        "Coefficients and their 95 % intervals, each over its own size (dx)",
        "Free run of y, its band, and residual",
    } <= set(captions)
    without_pictures(monkeypatch)
    eq.report(tmp_path / "out.html", records)
    text = Page((tmp_path / "out.html").read_text(encoding="utf-8")).text
    assert "Equations" in text
    assert "Governing equation: dx, dy" in text
    assert all(samples_hash(record) in text for record in records[-1:])


def test_the_command_finds_the_same_again(eq, record, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bq.write(record.slice(0, 400), tmp_path / "run.csv")
    few = {**ROLES, "dictionary": "x, v, x**3, u", "holdout": 0.0}
    command = repeat_command(bq.discover(tmp_path / "run.csv", **few))
    assert command.startswith("bayeq discover run.csv --chain x:v:a --input u --dictionary")
    assert main(shlex.split(command)[1:]) == 0
    assert "x**3" in capsys.readouterr().out


def test_hashes_and_the_command_of_the_command_line(hostile, illustrated):
    file, page = hostile[0], illustrated
    assert hashlib.sha256(file.read_bytes()).hexdigest() in page.text
    assert "--report" in page.text
    assert "--input u" in page.text


def test_names_and_units_of_a_file_are_text_and_nothing_else(illustrated):
    page = illustrated
    assert all(attributes["src"].startswith("data:image/png") for attributes in page.all("img"))
    assert not [name for _, attributes in page.elements for name in attributes if name.startswith("on")]
    assert len([a for a in page.all("script") if a.get("type") != "application/json"]) == 2
    assert "onerror=alert(2)" in page.text  # the unit, as it stands in the file


def test_samples_hash_is_of_every_number(record):
    assert samples_hash(record) == samples_hash(record.renamed("other"))
    changed = record["x"].copy()
    changed[-1] = np.nextafter(changed[-1], 1.0)
    assert samples_hash(record) != samples_hash(record.with_channels({"x": changed}))


def test_bad_places_and_files_are_said(eq, record, tmp_path, capsys):
    with pytest.raises(InputError, match="nowhere"):
        eq.report(tmp_path / "nowhere" / "out.html")
    with pytest.raises(InputError, match=r"no\.csv"):
        eq.report(tmp_path / "out.html", record, files=[tmp_path / "no.csv"])
    with pytest.raises(UnknownNameError, match="'v'"):
        eq.report(tmp_path / "out.html", bq.Record({"x": record["x"], "a": record["a"]}, record.time))
    bq.write(record, tmp_path / "run.csv")
    given = ["discover", str(tmp_path / "run.csv"), "--disp", "x", "--report"]
    assert main([*given, str(tmp_path / "out.pdf")]) == 2
    assert "end it in .html" in capsys.readouterr().err
    assert main([*given, str(tmp_path / "run.csv")]) == 2
    assert not (tmp_path / "out.html").exists()


def test_the_extra_is_named(eq, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh.plotting", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[report\]"):
        eq.report(tmp_path / "out.html")


def test_live_pictures_hold_the_numbers_of_the_still_ones(eq, record):
    ax = bq.figures.restoring_force_curve(eq, record)
    plot = as_bokeh([ax])
    (line,) = [line for line in ax.lines if line.get_label() == "discovered"]
    sources = [glyph.data_source.data for glyph in plot.renderers]
    assert any(
        len(source["x"]) == 400 and np.allclose(source["y"], line.get_ydata(), rtol=1e-6)
        for source in sources
        if "x" in source
    )
    bars = as_bokeh([bq.figures.pip_bars(eq)])
    assert "x³" in bars.yaxis[0].major_label_overrides.values()
    assert bars.tools


def test_ticks_of_few_decades_do_not_overlap_and_few_long_numbers_stand_below():
    ax = style.new_panels(1, height=50.0)[1][0, 0]
    ax.plot([-2e6, 2e6], [0.0008, 0.03])
    ax.set_yscale("log")
    plot = as_bokeh([ax])
    ticks = [tick for tick in plot.yaxis[0].ticker.ticks if 0.0008 < tick < 0.03]
    np.testing.assert_allclose(ticks, [0.001, 0.002, 0.005, 0.01, 0.02])
    assert plot.xaxis[0].ticker.desired_num_ticks == 4
    assert without_maths("$u_{C}$") == "uC"


def test_what_pictures_and_checks_are_of_and_the_kind_of_law(page, eq, tmp_path, monkeypatch, record):
    assert "Equation of motion: a" in page.text
    assert "2 more candidates are not included, each with PIP below 0.01" in page.text
    still = {"caption": "one", "still": "", "live": "", "narrow": True}
    monkeypatch.setattr("bayeq.equation.report.page.pictures", lambda *_: ([still], []))
    eq.report(tmp_path / "out.html", record)
    text = Page((tmp_path / "out.html").read_text(encoding="utf-8")).text
    assert f"from the {eq.data.n_train} rows that were not held out" in text


def test_a_matrix_keeps_its_height_and_legends_have_room(eq, record):
    matrix = as_bokeh([bq.figures.candidate_correlation(eq, record)])
    assert matrix.height is None
    assert matrix.frame_height == 30 * len(matrix.yaxis[0].major_label_overrides)
    assert type(matrix.right[0]).__name__ == "ColorBar"
    curve = as_bokeh([bq.figures.restoring_force_curve(eq, record)])
    assert [one.ncols for one in curve.above if type(one).__name__ == "Legend"] == [2]


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        ("x**2*v", "<msup><mi>x</mi><mn>2</mn></msup>"),
        ("abs(x)", '<mo fence="true">|</mo>'),
        ("(x - y)**3", "<mo>(</mo><mi>x</mi><mo>\N{MINUS SIGN}</mo><mi>y</mi><mo>)</mo>"),
        ("1/x", "<mfrac>"),
        ("sqrt(x)", "<msqrt><mi>x</mi></msqrt>"),
        ("where(x < 0.5, x, -y)", "&lt;"),
        ("x - (y - z)", "<mrow><mo>(</mo><mi>y</mi>"),
    ],
)
def test_terms_in_maths(term, expected):
    text = mathml(parse(term))
    assert expected in text
    elements = Page(text)
    assert not elements.open  # all are closed


def test_a_sum_behind_a_coefficient_has_brackets():
    assert mathml(parse("x - y"), factor=True).startswith("<mrow><mrow><mo>(</mo>")
    assert mathml(parse("2*x"), factor=True).startswith("<mrow><mo>(</mo>")


@pytest.fixture(scope="module")
def browser():
    for name in BROWSERS:
        if shutil.which(name):
            return name
    pytest.skip("there is no Chromium here to open the page in")


def opened(browser, file, width, folder):
    """The page as the browser has it after its scripts have run, and what it said on its console."""
    command = [
        browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}",
        f"--window-size={width},2000", "--virtual-time-budget=60000", "--enable-logging=stderr", "--dump-dom",
        file.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=240)
    return Page(done.stdout), [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("width", [1280, pytest.param(390, marks=pytest.mark.slow)])
def test_in_a_browser(browser, hostile, width, tmp_path):
    _, out = hostile
    page, console = opened(browser, out, width, tmp_path)
    assert not [line for line in console if re.search("error|refused|uncaught|violat", line, re.IGNORECASE)], console
    (html,) = page.all("html")
    live = [a for a in page.all("script") if a.get("type") == "application/json"]
    assert int(html["data-drawn"]) == len(live) >= 10
    assert "Verdict:" in page.text
    assert page.all("math")
    assert page.all("table")
    assert not [name for _, attributes in page.elements for name in attributes if name.startswith("on")]
    assert all(attributes["src"].startswith("data:") for attributes in page.all("img"))
