"""PySINDy's STLSQ of noisy states: at all thresholds, and by the grid of ODEBench."""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.records import Record
from bayeq.records.formats.limits import needing

THRESHOLDS = np.geomspace(1e-3, 10.0, 60)

#: From an initial state and times to the states (n, C), fewer rows where it leaves the range of numbers.
Run = Callable[[Floats, Floats], Floats]

# Of the weak form, for every trajectory.
TEST_FUNCTIONS = 200


class Fits(NamedTuple):
    """Models of one library.

    Attributes
    ----------
    terms : list of str
        Of the library.
    coefficients : list of (C, P) arrays
        One for each threshold.
    columns : callable
        From states (n, C) to the library's columns (n, P).
    cpu : float
        Seconds for derivatives, library and one model.
    """

    terms: list[str]
    coefficients: list[Floats]
    columns: Callable[[Floats], Floats]
    cpu: float


def fits(method: str, records: Sequence[Record], states: Sequence[str], degree: int, seed: int) -> Fits:
    """All models of "stlsq", from smoothed differences, or of "weak", in weak form.

    Raises
    ------
    MissingExtraError
        PySINDy is not installed.
    """
    with needing("pysindy", "pysindy", "PySINDy's fits"):
        import pysindy
    start = time.process_time()
    plain: Any = pysindy.PolynomialLibrary(degree=degree)
    samples = [np.column_stack([one[state] for state in states]) for one in records]
    plain.fit(pysindy.AxesArray(samples[0], {"ax_time": 0, "ax_coord": 1}))
    weak = method != "stlsq"
    rows, targets = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of thresholds that leave no term, and of its own arrays' axes
        for one, values in zip(records, samples, strict=True):
            library = plain
            if weak:
                np.random.seed(seed)  # noqa: NPY002 (where PySINDy takes the places of its test functions from)
                library = pysindy.WeakPDELibrary(
                    pysindy.PolynomialLibrary(degree=degree), spatiotemporal_grid=one.time, K=TEST_FUNCTIONS
                )
            axes = pysindy.AxesArray(values, {"ax_time": 0, "ax_coord": 1})
            prepared, target = library.calc_trajectory(pysindy.SmoothedFiniteDifference(), axes, one.time)
            rows.append(np.asarray(library.fit_transform([prepared])[0]))
            targets.append(np.asarray(target))
        names = [name.replace(" ", "*").replace("^", "**") for name in plain.get_feature_names(list(states))]
        columns, target = np.concatenate(rows), np.concatenate(targets)
        prepared_at = time.process_time()
        models = [pysindy.STLSQ(threshold=float(t), alpha=1e-5).fit(columns, target) for t in THRESHOLDS]
    each = (time.process_time() - prepared_at) / len(models)

    def evaluated(values: Floats) -> Floats:
        return np.asarray(plain.transform(pysindy.AxesArray(values, {"ax_time": 0, "ax_coord": 1})))

    return Fits(names, [np.asarray(m.coef_) for m in models], evaluated, prepared_at - start + each)


# Of ODEBench: thresholds, ridges, orders of differences, windows of smoothing, degrees; what a model is fitted to.
GRID = ((0.05, 0.1, 0.15), (0.025, 0.05, 0.075), (2, 3, 4), (None, 15), (1, 2, 3))
TRAINED = 0.7

# A free run that is further from zero has left.
FARTHEST = 1e6


def of_grid(record: Record, functions: bool) -> tuple[Run | None, float]:
    """The best of ODEBench's grid by R2 of the derivatives in the last 30 %, and the seconds of CPU of all.

    Parameters
    ----------
    record : Record
        Noisy states.
    functions : bool
        Whether sin, cos and exp may stand beside the monomials.
    """
    with needing("pysindy", "pysindy", "PySINDy's fits"):
        import pysindy
    start = time.process_time()
    values, times = np.column_stack([record[name] for name in record.channels]), np.asarray(record.time)
    split = round(TRAINED * len(times))
    best: tuple[float, Any] = (-np.inf, None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for numbers in itertools.product(*GRID, (False, True) if functions else (False,)):
            model = _model(pysindy, *numbers)
            try:
                model.fit(values[:split], t=times[:split])
                score = float(model.score(values[split:], t=times[split:]))
            except (ValueError, np.linalg.LinAlgError):  # no term is left, or a column is not finite
                continue
            if score > best[0]:
                best = (score, model)
    cpu = time.process_time() - start
    return (None if best[1] is None else partial(_run, best[1])), cpu


def _model(pysindy: Any, threshold: Any, alpha: Any, order: Any, window: Any, degree: Any, functions: bool) -> Any:
    library = pysindy.PolynomialLibrary(degree=degree)
    if functions:
        own = [lambda v: np.sin(v), lambda v: np.cos(v), lambda v: np.exp(v)]
        library = library + pysindy.CustomLibrary(library_functions=own)
    differences = pysindy.FiniteDifference(order=order)
    if window is not None:
        differences = pysindy.SmoothedFiniteDifference(order=order, smoother_kws={"window_length": window})
    return pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=threshold, alpha=alpha),
        feature_library=library,
        differentiation_method=differences,
    )


def _run(model: Any, initial: Floats, times: Floats) -> Floats:
    from scipy.integrate import solve_ivp

    def inside(t: float, y: Floats) -> float:
        return FARTHEST - float(np.abs(y).max())

    inside.terminal = True  # type: ignore[attr-defined]
    out = solve_ivp(
        lambda t, y: model.predict(y[None])[0],
        (times[0], times[-1]),
        initial,
        t_eval=times,
        method="LSODA",
        events=inside,
    )
    return np.asarray(out.y.T)
