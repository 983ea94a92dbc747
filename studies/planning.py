"""What a plan brings: the probability of the true model after a second record, by the excitation of that record.

A Duffing oscillator with 20 % noise, 1000 samples: too few for one model. A plan is made within the range of the force.
Second records of the same length and the same noise are then made with the best excitation of the plan, with the one in
the middle of its ranking, and with the force of the first record drawn again; both records together are what the
equation is found from.

    python -m studies.planning > docs/tables/planning.csv
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.equation.plan.designs import EXCITATIONS
from bayeq.errors import BayeqWarning
from bayeq.records import Record
from bayeq.systems import simulate
from studies.lines import print_table

__all__ = ["ARMS", "driven", "measure_record", "summary"]

N, FS, NOISE = 1000, 1000.0, 0.2
TERMS = ("x", "v", "x**3", "u", "x*abs(x)", "v*abs(v)", "sign(v)", "x**2*v")
TRUE = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
ARMS = ("first record alone", "force as before", "middle of the ranking", "best of the plan")


def driven(force: NDArray[np.float64], sd: Mapping[str, float], rng: np.random.Generator) -> Record:
    """The oscillator from rest under a force, with noise of these standard deviations."""
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicSpline

    time = np.arange(len(force)) / FS
    u = CubicSpline(time, force)

    def acceleration(x: NDArray[np.float64], v: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
        return TRUE["x"] * x + TRUE["v"] * v + TRUE["x**3"] * x**3 + TRUE["u"] * u(at)

    run = solve_ivp(
        lambda t, s: [s[1], acceleration(s[0], s[1], t)], (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-7, atol=1e-9
    )
    x, v = run.y
    clean = {"x": x, "v": v, "a": acceleration(x, v, time), "u": force}
    noisy = {name: samples + sd[name] * rng.standard_normal(len(time)) for name, samples in clean.items()}
    return Record.from_arrays(noisy, time=time)


def measure_record(seed: int) -> dict[str, float]:
    """Probability of the true model after each arm, and the rates that the plan stated."""
    first = simulate("duffing", n=N, seed=seed, noise=NOISE)
    again = simulate("duffing", n=N, seed=10_000 + seed, noise=0.0)
    sd = {name: NOISE * float(np.std(first[name])) / math.sqrt(1.0 + NOISE**2) for name in ("x", "v", "a", "u")}
    out = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        before = _found([first])
        plan = before.plan(realisations=3)
        middle = plan.outcomes[len(plan.outcomes) // 2]
        rng = np.random.default_rng([seed, 1])
        shape = EXCITATIONS[middle.design.kind].samples(N, FS, middle.design.band, rng)
        forces = {
            ARMS[1]: np.asarray(again["u"]),
            ARMS[2]: plan.offsets["u"] + middle.amplitudes["u"] * shape,
            ARMS[3]: plan.inputs["u"],
        }
        out[ARMS[0]] = _chance(before)
        for k, (arm, force) in enumerate(forces.items()):
            second = driven(force, sd, np.random.default_rng([seed, 2, k]))
            out[arm] = _chance(_found([first, second]))
    return out


def _found(records: list[Record]) -> Equations:
    return discover(
        records, displacement="x", velocity="v", acceleration="a", force="u", dictionary=list(TERMS), smooth="auto"
    )


def _chance(eq: Equations) -> float:
    """Posterior probability of the true model."""
    average = eq[0].posterior.average
    assert average is not None
    true = np.array([term.text in TRUE for term in eq[0].terms])
    return float(average.probability[(average.models == true).all(axis=1)].sum())


def summary(lines: list[dict[str, float]]) -> Iterator[dict[str, object]]:
    """A line per arm."""
    for arm in ARMS:
        chance = np.array([line[arm] for line in lines])
        yield {
            "second_record": arm,
            "records": len(lines),
            "above_0.5": int((chance > 0.5).sum()),
            "above_0.9": int((chance > 0.9).sum()),
            "mean_probability": f"{chance.mean():.3f}",
            "median_probability": f"{np.median(chance):.3f}",
        }


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(description="Probability of the true model after a planned second record.")
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args(arguments)
    with Parallel(n_jobs=given.jobs, inner_max_num_threads=1) as pool:
        print_table(summary(pool(delayed(measure_record)(seed) for seed in range(given.records))))


if __name__ == "__main__":
    main()
