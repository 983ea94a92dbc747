"""What an example leaves behind: shown code with what it printed, numbers, figures; and how these reach the page."""

from __future__ import annotations

import ast
import csv
import inspect
import io
import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from bayeq.errors import ConvergenceWarning
from bayeq.figures.runs import draw_forecasts
from bayeq.figures.style import UNSIGNED, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayeq import Forecast

__all__ = ["Example", "draw", "markers", "put_blocks", "write_figure", "write_table"]

# Resolution of the figures [dots per inch]: for the screen.
DPI = 240

# Colours of the figures: text and lines look the same, and files are a third as large.
COLOURS = 128

# Lines of a printed answer that the page leaves out: candidates outside the equation and their bounds, the intercept,
# noise, training fit, statistics of residuals, runners-up, and how the record was used. Longer lines are cut.
LONGEST = 150
LEFT_OUT = re.compile(
    r"\| .* \| not included|\| intercept|\* interval over|\d+ more candidates|noise sd|training rows|residuals:"
    r"|not determined by|by the likelihood alone|runners-up| +1:\d|\d+ rows at|not measured, estimated"
    r"|\d+ runs with coefficients|too small to be seen"
)


@dataclass
class Example:
    """One record.

    Attributes
    ----------
    name : str
        Of its markers, figure and rows in the table.
    blocks : dict
        Name -> Markdown of the code and of what it printed.
    numbers : dict
        Quantity -> what the page says of it.
    hidden : set
        Names of blocks that the page does not show.
    figure : matplotlib.figure.Figure or None
    """

    name: str
    blocks: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, str] = field(default_factory=dict)
    hidden: set[str] = field(default_factory=set)
    figure: Figure | None = None

    @contextmanager
    def block(self, name: str, shown: bool = True) -> Iterator[None]:
        """Run what stands in the `with` statement; keep its source and what it prints, which the page has if `shown`.

        Lines of an answer that the page does not need (`LEFT_OUT`) are dropped. Warnings of `discover` are part of
        what equations print; those of `refine` that nothing better was found are not, and are added.
        """
        current = inspect.currentframe()
        # this generator is called by contextlib's __enter__, and that by the function with the statement
        assert current is not None
        assert current.f_back is not None
        assert current.f_back.f_back is not None
        code = _body(current.f_back.f_back)
        printed = io.StringIO()
        with warnings.catch_warnings(record=True) as caught, redirect_stdout(printed):
            warnings.simplefilter("always")
            yield
        text = _shortened(printed.getvalue()).rstrip()
        for warning in caught:
            if issubclass(warning.category, ConvergenceWarning):
                text += f"\nwarning: {warning.message}"
        output = f"\n\n```text\n{text.strip()}\n```" if text.strip() else ""
        if not shown:
            self.hidden.add(name)
        self.blocks[name] = f"```python\n{code}\n```{output}"


def _shortened(text: str) -> str:
    """What was printed without the lines that the page leaves out, long ones cut, and no two empty lines in a row."""
    cut = [
        line if len(line) <= LONGEST else textwrap.shorten(line, LONGEST, placeholder=" ...")
        for line in text.splitlines()
    ]
    kept = "\n".join(line for line in cut if not LEFT_OUT.match(line))
    return re.sub(r"\n{3,}", "\n\n", kept)


def _body(frame: FrameType) -> str:
    """Source of the `with` statement that a frame is about to enter."""
    lines = Path(frame.f_code.co_filename).read_text(encoding="utf-8").splitlines()
    for node in ast.walk(ast.parse("\n".join(lines))):
        if isinstance(node, ast.With) and node.lineno == frame.f_lineno:
            return textwrap.dedent("\n".join(lines[node.lineno : node.end_lineno]))
    raise ValueError(f"{frame.f_code.co_filename}, line {frame.f_lineno}: no with statement")


def draw(runs: Sequence[tuple[str, Forecast]], time: str) -> Figure:
    """Free runs under each other, with their titles and a label of their time."""
    from matplotlib.ticker import MaxNLocator

    figure = draw_forecasts(runs, time)
    with style():
        for ax in figure.axes:
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))  # a year is whole
        figure.draw_without_rendering()  # what is made on drawing is made in this style
    return figure


def write_figure(figure: Figure, path: Path) -> None:
    """As PNG of few colours, the same bytes every time."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    with style():
        figure.savefig(path, format="png", dpi=DPI, metadata=UNSIGNED["png"])
    with Image.open(path) as drawn:
        drawn.convert("RGB").quantize(COLOURS).save(path, optimize=True, dpi=(DPI, DPI))


def write_table(examples: Iterable[Example], path: Path) -> None:
    """Every number that the page quotes and its blocks do not show; a row each."""
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write("# python -m examples\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("example", "quantity", "value"))
        writer.writerows((e.name, quantity, value) for e in examples for quantity, value in e.numbers.items())


def markers(text: str) -> list[str]:
    """Names of the blocks that a page has places for.

    >>> markers("<!-- begin: tanks found -->\\n<!-- end -->")
    ['tanks found']
    """
    return re.findall(r"^<!-- begin: (.+) -->$", text, flags=re.MULTILINE)


def put_blocks(text: str, examples: Iterable[Example]) -> str:
    """A page with what stands between its markers replaced.

    Raises
    ------
    ValueError
        The page has no place for a block.
    """
    for example in examples:
        for name, content in example.blocks.items():
            if name in example.hidden:
                continue
            begin, end = f"<!-- begin: {example.name} {name} -->", "<!-- end -->"
            before, found, rest = text.partition(begin)
            if not found:
                raise ValueError(f"the page lacks {begin}")
            text = f"{before}{begin}\n\n{content}\n\n{end}{rest.partition(end)[2]}"
    return text
