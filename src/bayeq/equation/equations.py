"""`Equations`: the answer of `discover`, one equation per coordinate."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.equation.data import DataSummary
from bayeq.equation.runs import EquationsRuns
from bayeq.errors import InputError
from bayeq.records import Record
from bayeq.records.atomic import replacing
from bayeq.states import derive_all

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DataSummary", "Equations"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Equations(EquationsRuns):
    """Equations of motion with a posterior on every term.

    Indexing and iteration give the single `Equation`s, in the order of the chains.

    Attributes
    ----------
    equations : tuple of Equation
    inputs : tuple of str
        Channels of the inputs.
    method : str
        The engine that the numbers come from.
    dictionary : str
        The dictionary's specification.
    smooth : str
        How derivatives that were not measured were had.
    data : DataSummary
    dropped : tuple of DroppedTerm
        Candidates that were left out, and why.
    warnings : tuple of str
        What makes the answer less than it seems.
    constraints : tuple of str
        What was known of the coefficients.
    scores : Scores or None
        Errors of the single step and of the free run on the rows that were held out; None where there are none, or no
        time.
    refined : Refinement or None
        How the coefficients were refined, if they were.
    """

    def table(self) -> pd.DataFrame:
        """All candidates of all equations: target, term, coef, sd, ci_low, ci_high, pip, included."""
        import pandas as pd

        tables = []
        for equation in self.equations:
            one = equation.table()
            one.insert(0, "target", equation.target)
            tables.append(one)
        return pd.concat(tables, ignore_index=True)

    def to_sympy(self) -> Any:
        """`sympy.Eq`, or a list of them where there are several equations."""
        out = [equation.to_sympy() for equation in self.equations]
        return out[0] if len(out) == 1 else out

    def to_latex(self) -> str:
        """LaTeX, one equation per line."""
        return " \\\\\n".join(equation.to_latex() for equation in self.equations)

    def rhs(self, t: float, state: ArrayLike, u: ArrayLike | None = None) -> Floats:
        """Time derivative of the state vector, as SciPy's `solve_ivp` takes it.

        Parameters
        ----------
        t : float
            Time; the equations are autonomous.
        state : (d,) array
            In the order of `states`: each coordinate and its derivatives below the highest.
        u : (m,) array or float, optional
            Inputs at this time, needed where there are inputs.

        Returns
        -------
        (d,) array
        """
        del t
        values = np.asarray(state, dtype=np.float64)
        if values.shape != (len(self.states),):
            raise InputError(f"the state has {len(self.states)} entries {self.states}, got shape {values.shape}")
        given = np.atleast_1d(np.asarray([] if u is None else u, dtype=np.float64))
        if given.shape != (len(self.inputs),):
            raise InputError(f"need {len(self.inputs)} input values {self.inputs}, got {given.size}")
        columns = dict(zip(self.states, values, strict=True)) | dict(zip(self.inputs, given, strict=True))
        out: list[float] = []
        for equation in self.equations:
            out.extend(columns[name] for name in equation.chain.states[1:])
            out.append(float(equation.evaluate(columns)))
        return np.array(out)

    def predict(self, record: Record, return_std: bool = False) -> Any:
        """Target(s) of a record, eqs. (29)-(30): the right-hand side at its measured states and inputs.

        Parameters
        ----------
        record : Record
            With the channels that the equations were found from.
        return_std : bool
            Also return the predictive standard deviation.

        Returns
        -------
        (n,) array, or (n, k) for k equations; with `return_std` a pair of them

        Raises
        ------
        InputError
            Not a Record, or one without the channels.
        """
        if not isinstance(record, Record):
            raise InputError(f"predict needs a Record (bayeq.read reads a file), not {type(record).__name__}")
        columns = derive_all([record], self.chains, self.inputs, self.smooth)[0].columns
        parts = [equation.predict(columns, return_std) for equation in self.equations]
        if len(parts) == 1:
            return parts[0]
        if return_std:
            return tuple(np.column_stack(pieces) for pieces in zip(*parts, strict=True))
        return np.column_stack(parts)

    def to_dict(self) -> dict[str, Any]:
        """What ``bayeq discover --json`` prints."""
        from bayeq.equation.storage import to_dict

        return to_dict(self)

    def save(self, path: str | Path) -> None:
        """Write to a JSON file that `bayeq.load` reads."""
        from bayeq.equation.storage import to_saved

        text = json.dumps(to_saved(self), indent=1, allow_nan=False) + "\n"
        with replacing(Path(path)) as part:
            part.write_text(text, encoding="utf-8")

    def __str__(self) -> str:
        """The answer as a person reads it: in colour on a terminal, plain (Markdown) elsewhere."""
        from bayeq.equation.text import render

        return render(self)

    def __repr__(self) -> str:
        return f"<Equations: {'; '.join(equation.text for equation in self.equations)}>"
