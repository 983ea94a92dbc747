"""Constants of the verdict and of what an answer says."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class EquationSettings:
    """Verdict, intervals and neighbours of the equation that is shown."""

    # fmt: off

    least_r2: float = setting(0.5, "An equation that explains a smaller share of what stands above its target's "
        "noise is `none`: more is unexplained than explained.", cliff=True)
    as_the_mean: float = setting(1.0, "Runs over windows of a period that err by this much, over the spread and "
        "noise of the whole motion, are `none`: the mean would do as well.", unit="times")
    at_rest: float = setting(0.1, "Rows held out are at rest where their signal is below this share of that of the "
        "whole motion: R2 is then by the variance of the whole motion.", "`tests/test_verdict.py`")
    doubt: float = setting(0.05, "An equation is not determined where models that predict otherwise have more "
        "probability: well determined records had 0 to 2 % (8 records each of five systems).", "`adverse.csv`")
    independent: float = setting(0.5, "Residuals of rows as measured are not white where less than this share of "
        "them are independent: filters, of zero phase too, leave what looks like a law.", "`tests/test_adequacy.py`")
    different: float = setting(0.2, "The interval over models is printed where its width or an end differs from the "
        "conditional one by a larger share of the width: an end that is this much too near leaves out 12 % in place "
        "of 2.5 %. Hoeting et al. (1999).", "literature; `tests/test_mixture.py`", cliff=True)
    # fmt: on


EQUATION = EquationSettings()
