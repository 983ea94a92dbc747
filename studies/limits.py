"""Inputs at their extremes (`bayeq.states.limits`): is a sensor that is clipped told from an actuator at its limit?

    python -m studies.limits > docs/tables/limits.csv

Records of 4,000 rows of four oscillators, 1 or 5 % noise on the channels of the motion. A force is band-limited, or a
square wave of 1 to 4 Hz with edges of 2 ms; its sensor, or the actuator, ends at a share of its greatest value.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator

import numpy as np

import bayeq as bq
from bayeq.states import Roles
from bayeq.states.bad_samples import find_bad_samples
from bayeq.systems import get_system
from bayeq.systems.simulate import band_limited_noise

RECORDS, SEED, N, FS = 24, 850000, 4000, 1000.0
SYSTEMS, NOISE = ("linear", "duffing", "quadratic", "coulomb"), (0.01, 0.05)
CHAINS = ("x:v:a", "x::", ":v:", "::a")


def draw(k: int, square: bool, end: float, actuator: bool) -> bq.Record:
    """Record k; `end` is the share of the greatest force."""
    system, seed = SYSTEMS[k % 4], SEED + k
    source, rng = get_system(system).force, np.random.default_rng([seed, N])
    assert source is not None
    force = band_limited_noise(source, N, FS, rng)
    if square:
        rate = rng.uniform(1.0, 4.0)
        force = source.std * np.tanh(np.sin(2.0 * np.pi * rate * np.arange(N) / FS) / (2.0 * np.pi * rate * 0.002))
    limit = end * np.abs(force).max()
    noise = dict.fromkeys("xva", NOISE[k // 4 % 2]) | {"u": 0.0}
    given = np.clip(force, -limit, limit) if actuator else force
    record = bq.simulate(system, n=N, fs=FS, seed=seed, noise=noise, force=given)
    return record.with_channels({"u": np.clip(record["u"], -limit, limit)})


def lines() -> Iterator[list[object]]:
    yield ["ends", "force", "share_of_greatest", "chain", "records", "called_clipped", "samples_at_ends_percent"]
    for actuator in (False, True):
        for square, ends in ((False, (0.9, 0.7, 0.4)), (True, (0.95, 0.7))):
            for end in ends:
                for text in CHAINS:
                    roles, called, at = Roles.parse(text, None, None, None, None, ["u"]), 0, 0.0
                    for k in range(RECORDS):
                        record = draw(k, square, end, actuator)
                        (bad,) = find_bad_samples([record], roles)
                        called += "clipped" in bad.get("u", {})
                        at += 100.0 * float((np.abs(record["u"]) == np.abs(record["u"]).max()).mean()) / RECORDS
                    ends_of = "actuator" if actuator else "sensor"
                    yield [ends_of, "square" if square else "band-limited", end, text, RECORDS, called, f"{at:.0f}"]


def main() -> None:
    print("# python -m studies.limits")
    csv.writer(sys.stdout, lineterminator="\n").writerows(lines())


if __name__ == "__main__":
    main()
