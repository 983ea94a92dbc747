"""Several records of one system, in some of which a channel does not vary."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import RecordError
from bayeq.states.derive import require_varying

SETTINGS = {"chains": "x:v:a", "inputs": ["u"]}


def forced_and_decay(seed):
    """A Duffing oscillator driven for 0.8 s, and the free decay that follows, with a force of exactly zero."""
    force = bq.simulate("duffing", n=3300, seed=seed, noise=0.0)["u"].copy()
    force[800:] = 0.0
    whole = bq.simulate("duffing", force=force, seed=seed, noise={"x": 0.05, "v": 0.05, "a": 0.05})
    decay = whole.slice(800)
    assert np.ptp(decay["u"]) == 0.0
    return whole.slice(0, 800).renamed("forced"), decay.renamed("decay")


@pytest.mark.filterwarnings("ignore:.*is exactly 0 between blows")
@pytest.mark.statistical(short=1, full=6)
def test_a_free_decay_joins_a_forced_record(number):
    true = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
    errors = []
    for seed in range(number):
        forced, decay = forced_and_decay(seed)
        # of the coefficients of all rows; alone, those of the true terms are what the second answer is compared with
        alone = bq.discover(forced, **SETTINGS, dictionary=list(true), holdout=0.0)[0]
        found = [alone, bq.discover([forced, decay], **SETTINGS, holdout=0.0)[0]]
        assert set(found[1].included) == set(true)
        errors.append([[one.coef[name] / true[name] - 1.0 for name in ("x", "v")] for one in found])
    # three times the rows, in which nothing but stiffness and damping shows
    alone, together = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (together < 0.6 * alone).all()


@pytest.mark.parametrize("smooth", ["auto", "none"])
def test_what_was_found_predicts_a_free_decay(smooth):
    forced, decay = forced_and_decay(0)
    few = "x, v, x**2, x**3, x*v, v**3, v*abs(v), u"
    eq = bq.discover(forced, smooth=smooth, **SETTINGS, dictionary=few, holdout=0.0)
    # the last 2.5 of 12 periods, by what 0.8 s at 5 % noise have shown
    assert eq.score(decay).free_run["x"] < 0.5
    assert eq.simulate(decay, draws=0).mean["x"].shape == (decay.n,)
    assert np.isfinite(eq.predict(decay)).all()


# in so short a record other forms of damping keep a PIP of some 0.1, which is warned about
@pytest.mark.filterwarnings("ignore::bayeq.errors.AmbiguityWarning")
@pytest.mark.filterwarnings("ignore::bayeq.errors.CorrelatedResidualsWarning")
@pytest.mark.parametrize("level", [pytest.param(0.0, marks=pytest.mark.slow), 0.05])
@pytest.mark.parametrize(
    "dictionary", ["x, dx, x**2, x**3, dx**3, u", pytest.param("oscillator", marks=pytest.mark.slow)]
)
def test_a_record_at_rest_joins_others(dictionary, level):
    # in balance: the force that holds the spring at a level
    forced, _ = forced_and_decay(1)
    held = {"x": np.full(300, level), "u": np.full(300, 1000.0 * level + 1e5 * level**3)}
    rest = bq.Record(held, np.arange(300) / 1000.0)
    for records in ([forced, rest], [rest, forced]):
        eq = bq.discover(records, chains="x::", inputs=["u"], dictionary=dictionary, holdout=0.0)
        assert eq[0].included == ("x", "dx", "x**3", "u")


def test_what_is_constant_in_all_records_is_refused():
    forced, decay = forced_and_decay(0)
    still = decay.with_channels({"x": 2.0 * decay["x"], "u": np.zeros(decay.n)})
    with pytest.raises(RecordError, match=r"2 records: channel 'u' is constant \(0 in all 5000 rows\)"):
        bq.discover([decay, still], **SETTINGS)
    # a step from record to record is a change
    held = [forced.with_channels({"u": np.full(forced.n, level)}) for level in (1.0, 2.0)]
    require_varying(held, ["u"])
