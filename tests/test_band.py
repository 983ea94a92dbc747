"""``--band`` and ``band=``: frequencies in which a record is believed; hum is taken out, drift is a state."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS
from bayeq.likelihood.adequacy import octaves_of
from bayeq.states.prepare import without_hum

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

FEW = "x, v, x**3, u, x**2, v*abs(v), sign(v), x**2*v"
OSCILLATOR = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u"]


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "duffing.csv"
    bq.write(bq.simulate("duffing", n=800, seed=1), path)
    return path


@pytest.fixture(scope="module")
def hum(tmp_path_factory):
    """A Duffing oscillator with hum of half its channels' standard deviation in all of them."""
    rec = bq.simulate("duffing", n=1500, seed=1, noise=0.02)
    rng = np.random.default_rng(1)
    mains = {n: np.sin(2 * np.pi * 50 * rec.time + rng.uniform(0, 2 * np.pi)) for n in "xvau"}
    record = rec.with_channels({n: rec[n] + 0.7 * rec[n].std() * mains[n] for n in "xvau"}, rec.units)
    path = tmp_path_factory.mktemp("run") / "hum.csv"
    bq.write(record, path)
    return path


def test_a_band_leaves_hum_out(hum, tmp_path, capsys):
    channels = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
    law = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
    whole = bq.discover(bq.read(hum), chains="x:v:a", inputs=["u"], dictionary=FEW, smooth="none")
    assert set(whole[0].shown) != set(law)
    eq = tmp_path / "eq.json"
    assert main(["discover", str(hum), *channels, "--dictionary", FEW, "--band", "0.5:40", "--save", str(eq)]) == 0
    out = capsys.readouterr().out
    assert "band: the record is believed between 0.5 and 40 Hz" in out
    found = bq.load(eq)
    assert found.data.band == (0.5, 40.0)
    assert found.smooth == "auto"
    assert found[0].verdict.kind == "found"
    assert set(found[0].shown) == set(law)
    for k, name in enumerate(t.text for t in found[0].terms):
        if name in law:
            assert found[0].shown_coef[name] == pytest.approx(law[name], rel=0.02)
            low, high = found[0].shown_ci95[k]
            assert low - (high - low) < law[name] < high + (high - low)
    direct = bq.discover(bq.read(hum), chains="x:v:a", inputs=["u"], dictionary=FEW, band=(0.5, 40))
    assert direct[0].shown_coef == pytest.approx(found[0].shown_coef)


@pytest.mark.parametrize("drifting", [pytest.param("x", marks=pytest.mark.slow), "a"])
def test_channels_may_drift_below_the_band(drifting):
    rec = bq.simulate("duffing", n=1200, seed=2, noise=0.02)
    walk = np.cumsum(np.random.default_rng(2).normal(size=rec.n))
    drift = 0.5 * rec[drifting].std() * walk / walk.std()
    record = rec.with_channels({drifting: rec[drifting] + drift}, rec.units)
    found = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=FEW, band=(0.5, 1000))[0]
    law = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
    assert set(found.shown) == set(law)
    assert found.verdict.kind == "found"  # judged without the drift: it explains little of a otherwise
    sd = dict(zip(found.posterior.names, found.shown_posterior.sd, strict=True))
    for name, value in law.items():
        assert abs(found.shown_coef[name] - value) < 3.5 * sd[name]


def test_slow_drifts_are_neither_a_misfit_nor_an_even_term():
    # a straight line and half a sine in each channel, and offsets; x**2 was found, or less power than that of a walk
    rec, rng = bq.simulate("duffing", n=1200, seed=5, noise=0.02), np.random.default_rng(5)
    turn = np.linspace(0.0, 1.0, rec.n)
    slow = {name: np.sin(np.pi * turn + 6.0 * rng.uniform()) + 2.0 * turn for name in rec.channels}
    record = rec.with_channels({name: rec[name] + 0.15 * rec[name].std() * slow[name] for name in slow}, rec.units)
    found = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=FEW, band=(0.5, 1000))[0]
    assert set(found.shown) == {"x", "v", "x**3", "u"}
    assert found.verdict.kind == "found"


def test_less_power_than_a_drift_has_is_no_misfit():
    rng, n, fs = np.random.default_rng(6), 8000, 100.0
    lines = np.fft.rfft(rng.standard_normal(n))
    frequency = np.fft.rfftfreq(n, 1.0 / fs)
    lines[(frequency > 0.4) & (frequency < 0.8)] *= 0.5  # a quarter of the power
    values = [np.fft.irfft(lines, n)]
    (low,) = [one for one in octaves_of("x", values, 1.0 / fs) if 0.38 < one.low < 0.4]
    assert low.ratio < 0.35
    assert low.p < 1e-6
    allowed = [one for one in octaves_of("x", values, 1.0 / fs, least=lambda _: 0.2) if one.low == low.low]
    assert allowed[0].p > 0.1
    # of more power nothing changes
    assert [one.p for one in octaves_of("x", values, 1.0 / fs, least=lambda _: 0.2) if one.ratio > 1.0] == [
        one.p for one in octaves_of("x", values, 1.0 / fs) if one.ratio > 1.0
    ]


def test_hum_is_taken_out_of_all_channels_alike():
    n, fs = 8000, 1000.0
    time, rng = np.arange(n) / fs, np.random.default_rng(3)
    u = rng.normal(size=n)
    hum = np.sin(2 * np.pi * 49.987 * time + 1.0) + 0.3 * np.sin(2 * np.pi * 150.02 * time)
    slow = np.sin(2 * np.pi * 3.0 * time)  # a line below the band's end stays
    missing = np.where(np.arange(n) % 7 == 3, np.nan, u + hum)
    record = bq.Record({"u": u + hum, "a": 3.0 * u + slow - 2.0 * hum, "half": missing, "slow": slow}, time)
    [found], messages = without_hum([record], ["u", "a", "half", "slow"], 0.0, 40.0)
    (message,) = messages
    assert message.startswith("hum above the band was taken out of all channels, at 49.99, 150.0")
    # what the channels have at those frequencies goes with it: four numbers of each line
    assert np.std(found["u"] - u) < 0.08
    np.testing.assert_allclose(found["a"] - 3.0 * found["u"], slow, atol=0.03)
    np.testing.assert_allclose(found["slow"], slow, atol=0.01)
    seen = np.isfinite(missing)
    assert np.std(found["half"][seen] - u[seen]) < 0.08
    [same], nothing = without_hum([record], ["u"], 0.0, 160.0)
    assert nothing == []
    np.testing.assert_array_equal(same["u"], record["u"])


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_the_edge_of_a_force_are_no_hum(seed):
    record = bq.simulate("duffing", n=20_000, seed=seed, noise=0.02)  # the force ends at 100 Hz
    assert without_hum([record], list("xvau"), 0.0, 40.0)[1] == []


def test_the_upper_end_decides_no_terms():
    record = bq.simulate("duffing", n=800, seed=5, noise=0.02)
    ask = {"chains": "x:v:a", "inputs": ["u"], "dictionary": FEW, "holdout": 0.0}
    found = [bq.discover(record, **ask, band=(0.0, high))[0].coef for high in (20.0, 400.0)]
    assert found[0] == found[1]


def test_a_band_is_fitted_where_nothing_is_noisy():
    record = bq.simulate("duffing", n=600, seed=1, noise=0.0)
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u", band=(1, 60))
    assert eq.data.smoothed
    assert eq[0].shown_coef["x"] == pytest.approx(-1000.0, rel=0.01)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--band", "5"], "--band '5': give two numbers with a colon between"),
        (["--band", "a:5"], "--band: 'a' is no number"),
        (["--band", "50:5"], "band 50 to 5 Hz: give two frequencies, the lower one first"),
        (["--band", "-1:5"], "band -1 to 5 Hz"),
        (["--band", "nan:5"], "band nan to 5 Hz"),
        (["--band", "1:inf"], "band 1 to inf Hz"),
        (["--band", "900:1000"], "the band 900 to 1000 Hz is above half of the sampling rate, 500 Hz"),
        (["--band", "5:40", "--smooth", "none"], "band= needs the likelihood of the record"),
        (["--band", "5:400", "--rows", "0:8"], "8 rows: too few for a regression (at least 10)"),
    ],
)
def test_bands_that_cannot_be_fitted(record, capsys, options, part):
    assert main(["discover", str(record), *OSCILLATOR, *options]) == 2
    out, err = capsys.readouterr()
    said = [line for line in err.splitlines() if line != COMPILING and not line.startswith(PROGRESS)]
    assert (out, len(said)) == ("", 1)
    assert part in said[0]


def test_uneven_steps_have_no_band():
    record = bq.simulate("duffing", n=600, seed=1)
    uneven = bq.Record(dict(record.channels), record.time + 3e-4 * np.sin(np.arange(600.0)))
    with pytest.raises(bq.errors.InputError, match="sampled evenly"):
        bq.discover(uneven, chains="x:v:a", inputs=["u"], dictionary="x, v, u", band=(1, 40))
