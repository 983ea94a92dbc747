"""A `Contents` as text and as HTML."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bayeq.inspection.channels import ChannelInfo
from bayeq.inspection.contents import Contents
from bayeq.inspection.spectrum import bars
from bayeq.markup import code, items, join, paragraph, table

__all__ = ["as_html", "as_text"]

HEADER = (
    "channel",
    "unit",
    "likely",
    "min",
    "max",
    "mean",
    "sd",
    "missing",
    "power by octave",
    "most at",
    "99 % below",
)
LEFT = (0, 1, 2, 8)

# Longer names and units are cut, so that rows stay rows.
LONGEST = 24


def as_text(found: Contents, plain: bool = False) -> str:
    """The summary; with `plain` in characters that every terminal has."""
    lines = [title(found), ""]
    lines += _aligned([HEADER, *(_row(found, channel, plain) for channel in found.channels.values())], plain)
    for heading, texts in _sections(found):
        lines += ["", heading, *(f"  {text}" for text in texts)]
    lines += ["", "next", f"  {found.proposal.command or found.proposal.python}"]
    lines += [f"  {note}" for note in found.proposal.notes]
    return "\n".join(_harmless(line.rstrip()) for line in lines)


def as_html(found: Contents) -> str:
    """The summary for a notebook: title, channels, what was noticed, and what to run next."""
    rows = [_row(found, channel, False) for channel in found.channels.values()]
    parts = [paragraph(title(found), strong=True), table(HEADER, rows, LEFT)]
    for heading, texts in _sections(found):
        parts += [paragraph(heading), items(texts)]
    parts += [paragraph("next"), code(found.proposal.command or found.proposal.python)]
    return join(*parts, items(found.proposal.notes))


def title(found: Contents) -> str:
    """Name, rows, rate and duration in one line."""
    name = f"{found.name}: " if found.name else ""
    count = len(found.channels)
    channels = f"{count} channel{'s' * (count != 1)}"
    rows = f"{found.rows} row{'s' * (found.rows != 1)}"
    if found.fs is None or found.duration is None:
        return f"{name}{rows}, {channels}; no time in it: rate and duration are not known"
    rate = (
        f"at {found.fs:.6g} Hz"
        if found.uniform
        else f"at uneven steps, mostly {1 / found.fs:.4g} s ({found.fs:.4g} Hz)"
    )
    number = len(found.experiments.records)
    several = f" in {number} experiments" if number > 1 else ""
    return f"{name}{rows} {rate}, {found.duration:.6g} s{several}; {channels}"


def _sections(found: Contents) -> list[tuple[str, Sequence[str]]]:
    out: list[tuple[str, Sequence[str]]] = []
    if found.guess.reasons:
        out.append(("why", [f"{_cut(name)}: {why}" for name, why in _reasons(found)]))
    if found.findings:
        out.append(("noticed", found.findings))
    return out


def _reasons(found: Contents) -> list[tuple[str, str]]:
    """Channels with a role, and what says so."""
    out = []
    for name in found.channels:
        role, why = found.guess.role_of(name), found.guess.reasons.get(name)
        if role and why:
            out.append((name, f"{role} ({why})"))
    return out


def _row(found: Contents, channel: ChannelInfo, plain: bool) -> tuple[str, ...]:
    numbers = (channel.least, channel.greatest, channel.mean, channel.sd)
    power = channel.spectrum
    spectrum = ("", "", "") if power is None else (bars(power, plain), _hertz(power.peak), _hertz(power.bandwidth))
    role = found.guess.role_of(channel.name) or ("constant" if channel.constant else "?")
    values = (f"{value:.4g}" if math.isfinite(value) else "" for value in numbers)
    return (_cut(channel.name), _cut(channel.unit), role, *values, str(channel.missing or ""), *spectrum)


def _harmless(text: str) -> str:
    """Text without what a terminal would obey, which names of files may hold."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _hertz(value: float) -> str:
    return f"{value:.3g} Hz"


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def _aligned(rows: Sequence[Sequence[str]], plain: bool) -> list[str]:
    """Columns under each other; those that are empty throughout are left out."""
    kept = [k for k in range(len(rows[0])) if k < 3 or any(row[k] for row in rows[1:])]
    widths = {k: max(len(row[k]) for row in rows) for k in kept}
    lines = ["  ".join(row[k].ljust(widths[k]) if k in LEFT else row[k].rjust(widths[k]) for k in kept) for row in rows]
    rule = "-" if plain else "─"
    return [lines[0], rule * max(map(len, lines)), *lines[1:]]
