"""Springs with stops (`bayeq.likelihood.hinges`): are kinks named that no candidate has, and is what is offered right?

    python -m studies.kinks > docs/tables/kinks.csv

Records of 2,000 rows at 200 Hz under a multisine of 0.3 to 6 Hz, 0.5 to 2 % of noise on all channels, by SciPy's
solver: springs that are stiffer by 5 to 60 % beyond 15 to 30 mm, or that candidates fit. *found and wrong*: with false
terms and no kink named. Where kinks are named, what the verdict offers is added to the candidates: *again found* with
the true terms, and *stiffness inside* its interval.
"""

from __future__ import annotations

import csv
import re
import sys
import warnings
from collections.abc import Callable, Iterator

import numpy as np
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.errors import BayeqWarning

RECORDS, SEED, ROWS, FS, LENGTH = 20, 870000, 2000, 200.0, 0.05
CHAINS = ("x:v:a", "x::")

# Force of a spring of unit stiffness beside x, by x, its place and its share; and terms that candidates have for it.
SPRINGS: dict[str, tuple[Callable[[float, float, float], float], set[str] | None]] = {
    "stops on both sides": (lambda x, g, s: s * (max(x - g, 0.0) - max(-x - g, 0.0)), None),
    "a stop on one side": (lambda x, g, s: s * max(x - g, 0.0), None),
    "cubic": (lambda x, g, s: s * x * (x / LENGTH) ** 2, {"x**3"}),
    "quadratic and cubic": (lambda x, g, s: s * x * (0.5 * x / LENGTH + (x / LENGTH) ** 2), {"x**2", "x**3"}),
    "x*abs(x) and cubic": (lambda x, g, s: s * x * (abs(x) / LENGTH + (x / LENGTH) ** 2), {"x*abs(x)", "x**3"}),
}


def draw(name: str, seed: int) -> tuple[bq.Record, float]:
    """A record with the channels x, v, a, u, and the stiffness over the mass."""
    rng, t = np.random.default_rng([seed, list(SPRINGS).index(name)]), np.arange(ROWS) / FS
    frequency, phase, size = rng.uniform(0.3, 6.0, 24), rng.uniform(0.0, 2.0 * np.pi, 24), rng.uniform(0.5, 1.0, 24)
    mass = rng.uniform(0.5, 2.0)
    stiffness = mass * (2.0 * np.pi * rng.uniform(1.5, 3.0)) ** 2
    damping = 2.0 * rng.uniform(0.01, 0.04) * np.sqrt(stiffness * mass)
    push = stiffness * LENGTH * rng.uniform(0.15, 0.4) / np.sqrt(0.5 * (size**2).sum())
    place, share, noise = rng.uniform(0.3, 0.6) * LENGTH, rng.uniform(0.05, 0.6), rng.choice([0.005, 0.01, 0.02])
    spring, _ = SPRINGS[name]

    def force(s: float) -> float:
        return float(push * (size * np.cos(2.0 * np.pi * frequency * s + phase)).sum())

    def acceleration(s: float, x: float, v: float) -> float:
        return (force(s) - damping * v - stiffness * (x + spring(x, place, share))) / mass

    solved = solve_ivp(
        lambda s, y: [y[1], acceleration(s, *y)], (0.0, t[-1]), [0, 0], t_eval=t, rtol=1e-9, atol=1e-11, max_step=1 / FS
    )
    a = np.array([acceleration(s, *y) for s, y in zip(t, solved.y.T, strict=True)])
    channels = {"x": solved.y[0], "v": solved.y[1], "a": a, "u": np.array([force(s) for s in t])}
    noisy = {key: one + noise * one.std() * rng.standard_normal(ROWS) for key, one in channels.items()}
    return bq.Record.from_arrays(noisy, time=t), stiffness / mass


def judged(name: str, chain: str, seed: int) -> tuple[bool, bool, bool, bool]:
    """Whether the first answer is found and wrong, whether it names kinks; the second found, its stiffness inside."""
    record, stiffness = draw(name, seed)
    if chain == "x::":
        record = bq.Record.from_arrays({key: record[key] for key in "xu"}, time=record.time)
    ask = {"chains": [chain], "inputs": ["u"]}
    first = bq.discover(record, **ask)[0]
    terms, velocity = SPRINGS[name][1], chain.split(":")[1] or "dx"
    wrong = terms is None or set(first.shown) != {"x", velocity, "u", *terms}
    offer = re.search(r"no candidate has.*offer (max.*)$", str(first.verdict))
    if offer is None:
        return first.verdict.kind == "found" and wrong, False, False, False
    again = bq.discover(record, dictionary=f"oscillator + {offer[1]}", **ask)[0]
    true = {"x", velocity, "u"} | {one for one in again.shown if one.startswith("max(")}
    held = "x" in again.shown and abs(again.shown_model.coefficients["x"] + stiffness) <= 1.96 * float(
        again.shown_model.sd[list(again.shown_model.terms).index("x")]
    )
    return False, True, again.verdict.kind == "found" and set(again.shown) == true, held


def lines() -> Iterator[list[object]]:
    yield ["spring", "chain", "records", "found_and_wrong", "kinks_named", "again_found", "stiffness_inside"]
    for name in SPRINGS:
        for chain in CHAINS:
            counts = np.zeros(4, dtype=int)
            for seed in range(SEED, SEED + RECORDS):
                counts += judged(name, chain, seed)
            yield [name, chain, RECORDS, *counts.tolist()]


def main() -> None:
    warnings.simplefilter("ignore", BayeqWarning)
    print("# python -m studies.kinks")
    out = csv.writer(sys.stdout, lineterminator="\n")
    for line in lines():
        out.writerow(line)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
