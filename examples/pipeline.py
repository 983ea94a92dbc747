"""The picture of the pipeline in docs/method: ``python -m examples.pipeline`` writes docs/figures/pipeline.svg."""

from __future__ import annotations

from html import escape
from pathlib import Path

__all__ = ["STAGES", "drawn"]

FIGURE = Path(__file__).resolve().parents[1] / "docs" / "figures" / "pipeline.svg"

# What leads to a stage, the stage, and what it holds.
STAGES = [
    ("", "file", "text, MATLAB, HDF5, TDMS, ..."),
    ("read it, check the channels", "Record", "measured channels, time, units"),
    ("smooth; leave out bad samples", "Motion", "states and inputs; rows held out"),
    ("evaluate the dictionary", "Design", "candidate terms as columns"),
    ("follow the record with all equations", "RecordFit", "path, noise levels, information"),
    ("one target at a time", "Regression", "Gram matrix: D'D, D'y, y'y"),
    ("spike-and-slab prior, engine", "RegressionFit", "probabilities, coefficients"),
    ("which terms to show", "Selection", "terms included, terms shown"),
    ("original units, tests, free runs", "Equation", "verdict, coefficients, intervals"),
]
AFTER = ["free runs", "refinement", "next plan"]

# A page on a telephone is 360 wide: letters of 14 stay readable there.
WIDTH, BOX, GAP, MARGIN, STEM = 400, 54, 40, 16, 70
BLUE, PALE = "#0072b2", "#e3eff7"

NAME = 'font-size="16" font-weight="bold" fill="#1f2933"'
INSIDE = 'font-size="14" fill="#1f2933"'
BESIDE = 'font-size="14" fill="#52606d" text-anchor="start"'


def drawn() -> str:
    """The picture, as SVG on a ground of its own, readable on light and dark pages."""
    height = 2 * MARGIN + len(STAGES) * (BOX + GAP) + 34
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        'role="img" font-family="Helvetica, Arial, sans-serif" text-anchor="middle">',
        f"<title>The pipeline of bayeq: {escape(', '.join(name for _, name, _ in STAGES))}</title>",
        f'<rect width="{WIDTH}" height="{height}" rx="8" fill="#ffffff"/>',
    ]
    top = MARGIN
    for leads, name, holds in STAGES:
        if leads:
            parts += [_arrow(STEM, top - GAP, top), _text(STEM + 14, top - GAP / 2 + 4, leads, BESIDE)]
        parts += [
            _box(MARGIN, top, WIDTH - 2 * MARGIN, BOX),
            _text(WIDTH / 2, top + 22, name, NAME),
            _text(WIDTH / 2, top + 43, holds, INSIDE),
        ]
        top += BOX + GAP
    wide = (WIDTH - 4 * MARGIN) / len(AFTER)
    for place, name in enumerate(AFTER):
        left = MARGIN + place * (wide + MARGIN)
        parts += [_arrow(left + wide / 2, top - GAP, top), _box(left, top, wide, 34)]
        parts.append(_text(left + wide / 2, top + 22, name, INSIDE))
    return "\n".join([*parts, "</svg>\n"])


def _box(left: float, top: float, wide: float, high: float) -> str:
    return f'<rect x="{left:g}" y="{top:g}" width="{wide:g}" height="{high:g}" rx="6" fill="{PALE}" stroke="{BLUE}"/>'


def _arrow(x: float, top: float, bottom: float) -> str:
    line = f'<line x1="{x:g}" y1="{top:g}" x2="{x:g}" y2="{bottom - 8:g}" stroke="{BLUE}" stroke-width="2"/>'
    return f'{line}<path d="M{x - 5:g} {bottom - 9:g} h10 l-5 9 z" fill="{BLUE}"/>'


def _text(x: float, y: float, text: str, style: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(text)}</text>'


if __name__ == "__main__":
    FIGURE.write_text(drawn(), encoding="utf-8")
