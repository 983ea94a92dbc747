"""HTML fragments for notebooks, with text from files and users escaped; and plain text with tables."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

# Style of a cell: text left, numbers right, overriding the notebook's own style.
CELL = "padding:2px 8px;text-align:{side};white-space:pre"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """HTML table; columns not listed in `left` are right-aligned.

    Examples
    --------
    >>> "&lt;b&gt;" in table(["term"], [["<b>"]])
    True
    """
    sides = ["left" if k in set(left) else "right" for k in range(len(header))]

    def line(tag: str, cells: Sequence[str]) -> str:
        made = (
            f'<{tag} style="{CELL.format(side=side)}">{escape(cell)}</{tag}>'
            for side, cell in zip(sides, cells, strict=True)
        )
        return f"<tr>{''.join(made)}</tr>"

    body = "".join(line("td", row) for row in rows)
    return f"<table><thead>{line('th', header)}</thead><tbody>{body}</tbody></table>"


def paragraph(text: str, strong: bool = False) -> str:
    """HTML paragraph, in bold type if `strong`."""
    return f"<p><b>{escape(text)}</b></p>" if strong else f"<p>{escape(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """HTML list; empty string for no items."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>" if texts else ""


def code(text: str) -> str:
    """HTML block of preformatted text, for copying."""
    return f'<pre style="white-space:pre-wrap">{escape(text)}</pre>'


def join(*parts: str) -> str:
    """Join HTML fragments in one `div`."""
    return f"<div>{''.join(parts)}</div>"


def shortened(text: str, longest: int = 18) -> str:
    """Shorten a text to `longest` characters (an even number); keep its beginning and end, where names differ."""
    return text if len(text) <= longest else f"{text[: longest // 2 - 1]}…{text[-longest // 2 :]}"


def text_console(width: int) -> Console:
    """Console that collects text: styled if standard output is a terminal, else plain and `width` characters wide."""
    from rich.console import Console

    terminal = sys.stdout.isatty()
    return Console(
        file=io.StringIO(), force_terminal=terminal, no_color=not terminal, width=None if terminal else width,
        highlight=False, soft_wrap=True,
    )  # fmt: skip


def printed(console: Console) -> str:
    """Text printed to a `text_console`, without the extra empty lines around tables."""
    assert isinstance(console.file, io.StringIO)
    lines = [line.rstrip() for line in console.file.getvalue().rstrip().splitlines()]
    return "\n".join(line for k, line in enumerate(lines) if line or (k and lines[k - 1]))


def aligned(rows: Sequence[Sequence[str]], left: Iterable[int] = (0,)) -> list[str]:
    """Lines of a table in columns two spaces apart; columns not listed in `left` are right-aligned.

    >>> aligned([("term", "value"), ("x", "-1000.3")])
    ['term    value', 'x     -1000.3']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = ["<" if k in set(left) else ">" for k in range(len(widths))]
    return [
        "  ".join(f"{cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True)).rstrip()
        for row in rows
    ]
