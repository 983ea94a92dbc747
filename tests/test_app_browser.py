"""`bayeq app` from end to end, in a headless Chromium, as a person uses it."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

import bayeq as bq

pytest.importorskip("nicegui", reason="the extra [app] is not installed")
pytest.importorskip("selenium", reason="the extra [dev], with selenium, is not installed")

from bayeq.app.session import LARGEST
from tests.app_driver import Page, browser, missing_browser
from tests.app_process import running_app

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(missing_browser()), reason=missing_browser())]

# Units that would like to be run, and a name that would like to be elsewhere.
UNITS = {"x": "<img src=x onerror=alert(2)>", "v": "{{7*7}}", "a": '"><script>alert(3)</script>', "u": "N&<"}
HOSTILE = "<img src=x onerror=alert(4)>{{7*7}}.csv"


def hostile_file(folder):
    record = bq.simulate("duffing", n=500, seed=1)
    head = ",".join(f'"{name} [{unit.replace(chr(34), chr(34) * 2)}]"' for name, unit in UNITS.items())
    rows = np.column_stack([record.time, *(record[name] for name in UNITS)])
    np.savetxt(folder / HOSTILE, rows, delimiter=",", header=f"t [s],{head}", comments="")
    return folder / HOSTILE


def said(driver):
    """Errors and warnings on the browser's console."""
    return [entry for entry in driver.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]


def hosts(driver):
    """Whom the browser has talked to."""
    out = set()
    for entry in driver.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            url = message["params"]["request"]["url"]
        elif message["method"] == "Network.webSocketCreated":
            url = message["params"]["url"]
        else:
            continue
        scheme, _, rest = url.partition(":")
        out.add("" if scheme in ("data", "blob", "about") else rest.strip("/").split("/")[0])
    return out - {""}


def children(process):
    """Commands that a process has started and that are running."""
    listed = subprocess.run(["ps", "-eo", "ppid=,stat=,args="], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    return [row[2] for row in rows if row[0] == str(process.pid) and not row[1].startswith("Z")]


def test_from_a_file_to_its_equation(tmp_path):
    """Drop a file, choose roles, discover, change terms, discover again, keep the results."""
    with running_app(cwd=tmp_path) as (_, address), browser(tmp_path) as driver:
        page = Page(driver, address, tmp_path)
        assert "no data leave it" in page.text
        page.drop(hostile_file(tmp_path))
        page.wait(lambda: "What each channel is" in page.text, "channels")
        assert "_img src_x onerror_alert(4)_" in page.text  # the name, without what a name cannot hold
        for name, unit in UNITS.items():
            assert f"{name} [{unit}]" in page.text
        assert "500 rows at 1000 Hz, 0.499 s; 4 channels" in page.text
        # a role that is wrong is said, and nothing is run
        page.choose("Role of x", "velocity")
        page.choose("Role of v", "velocity")
        page.press("Discover")
        page.wait(lambda: "x and v have both the role 'velocity'" in page.error(), "an error")
        page.choose("Role of x", "displacement or angle")
        page.choose("Role of a", "acceleration")
        page.choose("Role of u", "force or other input")
        page.write("Candidate terms", "x, v, u")
        page.press("Discover")
        first = page.result(1)
        assert "Verdict: " in first
        assert "a = " in first
        assert "x**3" not in first.split("Pictures")[0]
        assert "onerror=alert(2)" in first  # the unit, as it stands in the file
        page.write("Candidate terms", "x, v, x**3, u")
        page.write("Rows", "0:450")
        for name, unit in zip("xvau", ("m", "m/s", "m/s^2", "N"), strict=True):
            page.write(f"Unit of {name}", unit)
        page.write("Offset of u", "0.0")
        driver.find_element("css selector", "textarea").send_keys("u == 1\n")
        page.wait(lambda: "--constraint 'u == 1' --save" in page.text, "the command follows")
        page.press("Discover")
        second = page.result(2)
        assert "Verdict: found" in second
        assert "x**3" in second.split("Pictures")[0]
        assert "viscous damping" in second
        assert "N*s/m" in second
        assert len(driver.find_elements("css selector", "main")) == 1
        assert page.error() == ""
        assert "--input u --units x=m --units v=m/s --units 'a=m/s^2' --units u=N --remove-offset u=0.0" in page.text
        assert "--dictionary 'x, v, x**3, u' --rows 0:450 --constraint 'u == 1' --save equation.json" in page.text
        report, equation = (page.download(words) for words in ("Download report", "Download equation (JSON)"))
        # nothing was run, nobody else was talked to
        assert said(driver) == []
        assert hosts(driver) == {address.removeprefix("http://").split("/")[0]}
    assert "<strong>Verdict: found</strong>" in report.read_text(encoding="utf-8")  # the page that the frame has shown
    found = bq.load(equation)
    assert found.verdict.kind == "found"
    assert set(found[0].shown) == {"x", "v", "x**3", "u"}
    assert found.data.n == 450


def test_a_file_on_disk_a_bad_file_and_a_stop(tmp_path):
    """The page goes on after a bad file, and after a run that was stopped in the middle."""
    bq.write(bq.simulate("duffing", n=20_000, seed=1), tmp_path / "run.csv")
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,<b>one</b>\n")
    with running_app("run.csv", cwd=tmp_path) as (process, address), browser(tmp_path, width=390) as driver:
        page = Page(driver, address)
        page.wait(lambda: "What each channel is" in page.text, "channels of the file on disk")
        page.drop(tmp_path / "bad.csv")
        page.wait(page.error, "an error")
        assert page.error().startswith("bad.csv")
        assert "line 3" in page.error()
        assert "<b>one</b>" in page.error()
        assert "run.csv is still open" in page.text
        with (tmp_path / "large.csv").open("wb") as file:
            file.truncate(LARGEST + 1)
        page.drop(tmp_path / "large.csv")
        page.wait(lambda: "larger than 200 MB: open it where it is, by bayeq app FILE" in page.error(), "the limit")
        page.press("Discover")
        page.wait(lambda: any("-m bayeq discover" in words for words in children(process)), "the command runs")
        page.wait(lambda: driver.find_elements("css selector", "[aria-live] li"), "a line of progress")
        assert not page.button("Discover").is_enabled()
        page.press("Stop")
        page.wait(lambda: "Stopped: nothing of this run is kept" in page.text, "it is stopped")
        assert children(process) == []
        # it is usable: one column, nothing beside the screen, the next run says what is wrong
        assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        page.write("Rows", "7:5")
        page.press("Discover")
        page.wait(lambda: "--rows 7:5 leaves none of 20000 rows" in page.error(), "an error of the command")
        page.wait(lambda: page.button("Discover").is_enabled(), "another run may begin")
        assert said(driver) == []
        assert hosts(driver) == {address.removeprefix("http://").split("/")[0]}
