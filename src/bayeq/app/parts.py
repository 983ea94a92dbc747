"""Smaller pieces of the page. Texts from files are set as text, never as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from bayeq.app.roles import INPUT, RATE, ROLES, Choice

__all__ = ["bullets", "channel_rows", "command", "field", "heading", "is_several", "message", "summary", "text"]

# More channels are not offered on a page.
MOST_CHANNELS = 60

# More coordinates are not offered.
MOST_COORDINATES = 9


def command(words: str) -> None:
    """A command, which breaks between its options."""
    with ui.element("pre").classes("command"):
        for part in words.replace(" --", " \0--").split("\0"):
            text(part, tag="span")


def heading(number: int, title: str) -> None:
    """The title of a step."""
    ui.html(f"{number}. {title}", tag="h2", sanitize=False)


def text(words: str, kind: str = "", tag: str = "p") -> Any:
    """A paragraph."""
    element = ui.element(tag).classes(kind)
    with element:
        ui.label(words).style("display: inline")
    return element


def message(words: str, kind: str) -> None:
    """A line that should be seen: an error or a note."""
    with ui.element("div").classes(kind).props("role=alert" if kind == "error" else "role=status"):
        text(words)


def bullets(texts: Sequence[str]) -> None:
    """A list; nothing of none."""
    if texts:
        with ui.element("ul"):
            for words in texts:
                text(words, tag="li")


def field(label: str, hint: str, target: Any, name: str) -> Any:
    """A labelled field for a text, bound to an attribute."""
    made = ui.input(label).props(f'outlined dense spellcheck=false autocomplete=off hint="{hint}"')
    return made.bind_value(target, name)


def summary(info: Mapping[str, Any]) -> str:
    """What is in a file, in a line."""
    time, count = info["time"], len(info["channels"])
    channels = f"{count} channel{'s' * (count != 1)}"
    if time["fs"] is None:
        return f"{info['rows']} rows, {channels}; no time in the file"
    steps = "at" if time["uniform"] else "at uneven steps, mostly at"
    return f"{info['rows']} rows {steps} {time['fs']:.6g} Hz, {time['duration']:.6g} s; {channels}"


def channel_rows(info: Mapping[str, Any], choices: dict[str, Choice], several: bool) -> None:
    """A row for each channel: its name, what it is like, and its role."""
    channels = sorted(info["channels"], key=lambda one: not choices[one["name"]].role)
    with ui.element("div").classes("channels several" if several else "channels"):
        for channel in channels[:MOST_CHANNELS]:
            name, choice = channel["name"], choices[channel["name"]]
            unit = f" [{channel['unit']}]" if channel["unit"] else ""
            text(name + unit, "channel-name", "div")
            text(_about(channel), "channel-about", "div")
            ui.select(ROLES, label=f"Role of {name}").props("outlined dense options-dense").bind_value(choice, "role")
            if several:
                _coordinate(name, choice)
    if len(channels) > MOST_CHANNELS:
        message(
            f"The file has {len(channels)} channels; the first {MOST_CHANNELS} are offered here. For others, write the"
            " command below in a terminal.",
            "said",
        )


def _coordinate(name: str, choice: Choice) -> None:
    """Of which coordinate a channel is."""
    numbers = list(range(1, max(MOST_COORDINATES, choice.coordinate) + 1))
    made = ui.select(numbers, label="Coordinate").props(
        f'outlined dense options-dense aria-label="Coordinate of {name}"'
    )
    made.bind_value(choice, "coordinate")
    made.bind_visibility_from(choice, "role", lambda role: role not in ("", INPUT))


def is_several(choices: Mapping[str, Choice]) -> bool:
    """Whether coordinates need numbers."""
    return any(choice.coordinate > 1 or choice.role == RATE for choice in choices.values())


def _about(channel: Mapping[str, Any]) -> str:
    """Range, and what is wrong with a channel."""
    if channel["min"] is None:
        return "no numbers in it"
    if channel["constant"]:
        return f"constant, {channel['min']:.4g}: it says nothing of the motion"
    parts = [f"{channel['min']:.3g} to {channel['max']:.3g}"]
    if channel["missing"]:
        parts.append(f"{channel['missing']} samples missing")
    parts += [f"{kind}: {found['samples']} samples" for kind, found in channel["bad"].items()]
    if channel["why"]:
        parts.append(f"role proposed: {channel['why']}")
    return "; ".join(parts)
