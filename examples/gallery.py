"""The gallery of pictures: ``python -m examples.gallery`` writes docs/gallery.md and its figures again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import bayeq as bq
from examples.page import write_figure

__all__ = ["PICTURES", "draw_gallery", "page"]

DOCS = Path(__file__).resolve().parents[1] / "docs"

# What each picture shows, in the order of the page.
PICTURES = {
    "restoring_force_surface": "The picture of this field (Masri and Caughey 1979): the acceleration of each "
    "row, less the equation's terms of the force and with the other sign, over "
    "displacement and velocity. The discovered surface should pass through the "
    "dots, and end where they do.",
    "restoring_force_curve": 'The same for the spring alone, over the displacement; `over="v"` is the '
    "damper. The line is the discovered curve, the band its 95 % interval. Dots "
    "that follow another curve than the line show what the equation lacks.",
    "pip_bars": "How probable it is that each term is in the law. Filled bars are in the "
    "equation. Bars near the dashed line, at 0.5, are undecided. Here of one second with 10 % noise: in "
    "the record above all four terms are certain.",
    "coefficient_forest": "Every coefficient and its 95 % interval, in per cent of the estimate, so that "
    "different units stand on one scale. A simulated record knows its law: diamonds"
    " are the true values.",
    "measured_against_predicted": "The target of each row against what the equation gives there. Dots along the "
    "line are right; a bend is a missing term.",
    "one_step": "The target at the measured states of each row. The band should hold 95 % of "
    "the samples, and the residual look like noise.",
    "free_run": "The equation started once and left to itself, driven by the measured force. "
    "Errors add up here: it is the hardest test.",
    "spectra": "Where in frequency the free run agrees with what was measured. The floor of "
    "the measured spectrum is its noise.",
    "frequency_response": "Magnitude and phase from the force to the displacement, the receptance, and how much "
    "of the motion follows the force (coherence), here over 40 s of the same oscillator: the longer the record, the "
    "finer the resonance is resolved. At the resonance the coherence of both is low: that is the cubic spring, not "
    "noise, which takes over from 30 Hz on.",
    "phase_portrait": "Velocity against displacement: the record, and the free run over the rows held out.",
    "candidate_correlation": "How alike the columns of the likeliest terms are. Terms near 1 or -1 can "
    "hardly be told apart by this record; one with other amplitudes would tell.",
}

CODE = """import bayeq as bq

rec = bq.simulate("duffing", n=4000, seed=1)
eq = bq.discover(rec, displacement="x", velocity="v", acceleration="a", force="u")"""

START = f"""# Gallery

Each picture is a function of `bayeq.figures`; it takes the equations, the record and, if wanted, matplotlib axes, and
returns these: `bayeq.figures.free_run(eq, rec, ax=(upper, lower))`. Where there are several equations, `target=` names
the one meant; `channel=` names a state. They need the extra `plot`.

The report, `eq.report("out.html", rec)` or `bayeq discover ... --report out.html`, holds them with hover values (extra
`report`); bars of probabilities only where something is undecided, and none of an equation that was not found.

Here of a simulated Duffing oscillator with 5 % noise:

```python
{CODE}
```
"""

END = """
Path and sensitivity have pictures of their own: `eq[0].path().plot()` shows the best equation of each size, and
`eq[0].sensitivity().plot()` the probabilities under other priors.

`python -m examples.gallery` writes this page and its figures again.
"""


def draw_gallery(folder: Path) -> None:
    """Write every picture."""
    rec = bq.simulate("duffing", n=4000, seed=1)
    short = bq.simulate("duffing", n=1000, noise=0.1, seed=2)
    eq, doubtful = (
        bq.discover(one, displacement="x", velocity="v", acceleration="a", force="u") for one in (rec, short)
    )
    others = {"pip_bars": (doubtful, short), "frequency_response": (eq, bq.simulate("duffing", n=40_000, seed=2))}
    for name in PICTURES:
        drawn: Any = getattr(bq.figures, name)(*others.get(name, (eq, rec)))
        figure = np.ravel(np.array(drawn, dtype=object))[0].figure
        write_figure(figure, folder / f"gallery_{name}.png")


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize().replace("Pip", "PIP")


def page() -> str:
    """The text of the page."""
    parts = [
        f"## {_title(name)}\n\n`bayeq.figures.{name}(eq, rec)`\n\n{text}\n\n"
        f"![{name.replace('_', ' ')}](figures/gallery_{name}.png)\n"
        for name, text in PICTURES.items()
    ]
    return "\n".join([START, *parts]) + END


if __name__ == "__main__":
    draw_gallery(DOCS / "figures")
    (DOCS / "gallery.md").write_text(page(), encoding="utf-8")
