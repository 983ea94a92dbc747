"""Constants of the choice of terms that are shown."""

from __future__ import annotations

from dataclasses import dataclass

from bayeq.numerics.settings import setting


@dataclass(frozen=True)
class SelectionSettings:
    """Nearly true laws, terms that are not determined, and motion that repeats itself."""

    # fmt: off

    tolerance: float = setting(0.005, "Terms of a nearly true law are left out, one by one, while free runs are "
        "worse by no more, a share of the states' spread, or `tolerance=`; an equation is not determined where "
        "others predict otherwise by more. Half of the 1 % to which sensors are calibrated; with 1 % Coulomb "
        "friction of 0.7 to 1.2 % was left out in 31 of 100 records.", "`tests/test_selection.py`", cliff=True)
    damping: float = setting(0.1, "... or where their damping differs by more than this share of it: on a ring-down of "
        "a damping ratio of 0.1 % all forms explain less than the tolerance.", "`tests/test_ring_down.py`")
    short_run: float = setting(1.0, "Length of the free runs that are compared: chaotic motion can be followed so "
        "long,", "`tests/test_selection.py`", "periods")
    long_run: float = setting(10.0, "... and so long, at most half a record: keeps damping of a ratio of 0.1 %.",
        "`tests/test_selection.py`", "periods")
    follows: float = setting(0.5, "They count where the run of all terms errs by less than this share of the spread: "
        "runs that are out of step tell nothing.", "`tests/test_selection.py`")
    least_periods: float = setting(5.0, "Motion repeats itself over this many periods or more.",
        "`tests/test_excitation.py`", "periods")
    harmonics: int = setting(12, "... along a curve of this many harmonics, at most: 12 of 12 steady sines, none of "
        "40 other records.", "`tests/test_excitation.py`")
    not_noise: float = setting(1e-6, "... where power beside them has this chance.", "`tests/test_excitation.py`")
    transient: float = setting(0.03, "... and up to this share of a channel is beside the curve: a transient tells "
        "the candidates no better apart.", "`tests/test_excitation.py`")
    # fmt: on


SELECTION = SelectionSettings()
