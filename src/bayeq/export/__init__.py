"""Equations for other programs: functions of NumPy and JAX, source text of several languages, LaTeX.

`to_callable` and `to_code` take the laws of a system; `with_sd` writes numbers for LaTeX.
"""

from bayeq.export.functions import LANGUAGES, to_callable, to_code
from bayeq.export.latex import Uncertainty, sum_in_latex

__all__ = ["LANGUAGES", "Uncertainty", "sum_in_latex", "to_callable", "to_code"]
