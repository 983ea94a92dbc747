"""Small pieces of HTML for notebooks: everything that comes from files or users is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

__all__ = ["code", "items", "join", "paragraph", "table"]

# Left of text, right of numbers, whatever the notebook's own style is.
CELL = "padding:2px 8px;text-align:{side};white-space:pre"


def table(header: Sequence[str], rows: Iterable[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """A table; columns that are not `left` are set right.

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
    """A paragraph, the important ones in bold type."""
    return f"<p><b>{escape(text)}</b></p>" if strong else f"<p>{escape(text)}</p>"


def items(texts: Sequence[str]) -> str:
    """A list; nothing of none."""
    return f"<ul>{''.join(f'<li>{escape(text)}</li>' for text in texts)}</ul>" if texts else ""


def code(text: str) -> str:
    """Text to be copied."""
    return f'<pre style="white-space:pre-wrap">{escape(text)}</pre>'


def join(*parts: str) -> str:
    """Pieces in one block."""
    return f"<div>{''.join(parts)}</div>"
