"""Which channel is displacement, velocity, acceleration or force: from units, names, and what derives from what."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from bayeq.inspection.links import Link
from bayeq.records.units import in_si, parse_unit

__all__ = ["INPUT", "Clue", "Guess", "clue_of", "guess_roles"]

# The derivative that a channel is of its coordinate, 0 to 2, or an input.
INPUT = -1
TITLES = {0: "displacement", 1: "velocity", 2: "acceleration", INPUT: "force or input"}

FORCES = {"N", "kN", "mN", "MN", "daN", "lbf", "kgf", "Nm", "kNm", "mNm"}
ANGLES = {"rad", "mrad", "deg", "°", "rev", "rpm"}

# Parts of names in the usual languages, in small letters; single letters count where they are all of the name.
WORDS: Mapping[int, str] = {
    0: "x y z q s d o th theta phi psi disp displ displacement pos position angle deflection weg auslenkung winkel lage"
    " deplacement desplazamiento spostamento lvdt laser hub level",
    1: "v w om omega vel velo velocity speed rate gyro xd xdot yd ydot zd zdot dx dy dz thd thdot dth"
    " geschwindigkeit vitesse velocidad velocita",
    2: "a acc accel acceleration accelerometer beschleunigung xdd xddot ydd yddot zdd zddot ddx ddy ddz thdd thddot"
    " ddth aceleracion accelerazione",
    INPUT: "u f fx fy fz force load kraft in input exc excitation shaker torque moment tau voltage drive cmd command"
    " anregung effort fuerza forza",
}
NAMES = {word: order for order, words in WORDS.items() for word in words.split()}


@dataclass(frozen=True, slots=True)
class Clue:
    """What a channel's unit and name say."""

    order: int | None  # derivative that it is of its coordinate, or `INPUT`
    why: str  # as words
    by_unit: bool  # whether the unit says it, which is surer than a name
    index: str  # what the name has besides: the number of the coordinate
    angle: bool  # whether it is an angle in radians, by its unit or name


@dataclass(frozen=True)
class Guess:
    """Roles of the channels."""

    # names of a coordinate and its derivatives, None where one is not measured; one name alone: a first-order state
    chains: tuple[tuple[str | None, ...], ...]
    inputs: tuple[str, ...]
    undecided: tuple[str, ...]  # channels that may be anything
    reasons: Mapping[str, str]  # why, by channel

    def driven_by(self, shares: Mapping[str, float]) -> Guess:
        """The same with channels that were undecided as inputs, for the share of the motion that each explains."""
        reasons = {
            name: f"explains {100.0 * min(share, 0.999):.1f} % of what the motion itself leaves of the acceleration"
            for name, share in shares.items()
        }
        undecided = tuple(name for name in self.undecided if name not in shares)
        return replace(self, inputs=(*self.inputs, *shares), undecided=undecided, reasons={**self.reasons, **reasons})

    def role_of(self, name: str) -> str:
        """Role of a channel as a word; empty where it is not decided."""
        if name in self.inputs:
            return TITLES[INPUT]
        for chain in self.chains:
            if name in chain:
                return "state" if len(chain) == 1 else TITLES[chain.index(name)]
        return ""


def clue_of(name: str, unit: str) -> Clue:
    """Read a channel's unit and name.

    Examples
    --------
    >>> clue_of("ch2", "m/s^2").order, clue_of("acc_left", "").order, clue_of("x2", ""), clue_of("ch1", "").order
    (2, 2, Clue(order=0, why='its name', by_unit=False, index='2', angle=False), None)
    """
    by_name, index = _order_of_name(name)
    angle = unit == "rad" or (not unit and _is_angle(name))
    by_unit = _order_of_unit(unit)
    if by_unit is not None:
        return Clue(by_unit, f"its unit {unit}", True, index, angle)
    return Clue(by_name, "" if by_name is None else "its name", False, index, angle)


def _order_of_unit(unit: str) -> int | None:
    powers = parse_unit(unit)
    if any(symbol in FORCES for symbol in powers):
        return INPUT if len(powers) == 1 or set(powers) <= {"N", "m", "mm"} else None
    found = in_si(powers)
    if found is None:
        return None
    length, time = (found[1].get(symbol, Fraction(0)) for symbol in ("m", "s"))
    motion = length == 1 or (length == 0 and any(symbol in ANGLES for symbol in powers))
    return int(-time) if motion and time in (0, -1, -2) else None


def _parts(name: str) -> list[str]:
    """Words of a name: divided at underscores, at numbers and where small letters end."""
    return re.findall(r"\d+|[^\W\d_]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name))


def _order_of_name(name: str) -> tuple[int | None, str]:
    """What the first telling word of a name says, and the other words."""
    parts = _parts(name)
    for k, part in enumerate(parts):
        # a single letter counts at the beginning only
        if part.casefold() in NAMES and (len(part) > 1 or k == 0):
            return NAMES[part.casefold()], "_".join(parts[:k] + parts[k + 1 :]).casefold()
    return None, "_".join(part for part in parts if part.isdigit())


def _is_angle(name: str) -> bool:
    return any(part.casefold() in ("th", "theta", "phi", "angle", "winkel") for part in _parts(name))


def guess_roles(
    names: Sequence[str], clues: Mapping[str, Clue], links: Sequence[Link], first: Mapping[str, float]
) -> Guess:
    """Put channels that move together to chains and inputs.

    By what units and names say (`clues`), what derives from what (`links`, the surest first), and `first`: channels
    whose changes the others explain, with the share, which are first-order states unless something else is known.
    """
    reasons: dict[str, str] = {}
    runs = _runs(_agreeing(links, clues), reasons)
    linked = {name for run in runs for name in run if name is not None}
    inputs = [name for name in names if clues[name].order == INPUT and name not in linked]
    rest = [name for name in names if name not in linked and name not in inputs]
    chains = [_completed(_placed(run, clues), rest, clues, reasons) for run in runs]
    rest = [name for name in rest if not any(name in chain for chain in chains)]
    chains += _by_clues(rest, clues, first, chains, reasons)
    for name in inputs:
        reasons[name] = clues[name].why
    for chain in chains:
        for low, high in zip(chain, [*chain[1:], None], strict=True):
            if low is not None and low not in reasons:
                reasons[low] = clues[low].why or f"{high} is its derivative"
    used = {name for chain in chains for name in chain}
    ordered = sorted(chains, key=lambda chain: min(names.index(name) for name in chain if name is not None))
    return Guess(tuple(ordered), tuple(inputs), tuple(name for name in rest if name not in used), reasons)


def _agreeing(links: Sequence[Link], clues: Mapping[str, Clue]) -> list[Link]:
    """Links, those that contradict nothing that names say before the others; none against units."""

    def contradiction(link: Link) -> int:
        below, above = clues[link.below], clues[link.above]
        if INPUT in (below.order, above.order) and abs(abs(link.gain) - 1.0) > 0.1:
            return 2  # something proportional to a force
        if below.order is None or above.order is None:
            return 0
        agrees = above.order - below.order == link.order and below.index == above.index
        return 0 if agrees else 2 if (below.by_unit and above.by_unit) or INPUT in (below.order, above.order) else 1

    graded = [(contradiction(link), link) for link in links]
    return [link for grade, link in sorted(graded, key=lambda one: (one[0], one[1].order)) if grade < 2]


def _runs(links: Sequence[Link], reasons: dict[str, str]) -> list[list[str | None]]:
    """Channels that follow each other as derivatives; each belongs to one run."""
    up: dict[str, Link] = {}
    down: dict[str, Link] = {}
    for link in links:
        if link.below in up or link.above in down or _reaches(up, link.above, link.below):
            continue
        up[link.below], down[link.above] = link, link
    runs = []
    for start in [name for name in up if name not in down]:
        run: list[str | None] = [start]
        while run[-1] in up and len(run) < 3:
            link = up[str(run[-1])]
            if len(run) + link.order > 3:
                break
            run += [None] * (link.order - 1) + [link.above]
            sign = "-" if link.gain < 0 else ""
            reasons[link.above] = f"moves as {sign}{link.stands_for}, gain {abs(link.gain):.3g}"
        runs.append(run)
    return runs


def _reaches(up: Mapping[str, Link], start: str, end: str) -> bool:
    while start in up:
        start = up[start].above
        if start == end:
            return True
    return start == end


def _placed(run: list[str | None], clues: Mapping[str, Clue]) -> tuple[str | None, ...]:
    """A run as a chain of second order: it begins at the derivative that most of its channels' clues say."""
    votes = [order - k for k, name in enumerate(run) if name is not None and (order := clues[name].order) in (0, 1, 2)]
    shift = max(set(votes), key=votes.count) if votes else 0
    shift = min(max(shift, 0), 3 - len(run))
    return (*[None] * shift, *run, *[None] * (3 - shift - len(run)))


def _completed(
    chain: tuple[str | None, ...], rest: Sequence[str], clues: Mapping[str, Clue], reasons: dict[str, str]
) -> tuple[str | None, ...]:
    """A chain with derivatives that unit and name say, where nothing was found to derive from the others."""
    index = next(clues[name].index for name in chain if name is not None)
    out = list(chain)
    for name in rest:
        clue = clues[name]
        if clue.order in (0, 1, 2) and clue.index == index and out[clue.order] is None:
            out[clue.order], reasons[name] = name, clue.why
    return tuple(out)


def _by_clues(
    rest: Sequence[str],
    clues: Mapping[str, Clue],
    first: Mapping[str, float],
    chains: Sequence[tuple[str | None, ...]],
    reasons: dict[str, str],
) -> list[tuple[str | None, ...]]:
    """Chains of channels that nothing was found to derive from: by their units and names, or first-order states."""
    out: list[tuple[str | None, ...]] = []
    groups: dict[str, dict[int, str]] = {}
    for name in rest:
        clue = clues[name]
        if name in first and not clue.by_unit:
            out.append((name,))
            reasons[name] = f"the channels explain {100 * min(first[name], 0.999):.1f} % of its changes: first order"
        elif clue.order is not None and clue.order >= 0:
            groups.setdefault(clue.index, {}).setdefault(clue.order, name)
    for orders in groups.values():
        # velocity alone is no coordinate, and an acceleration beside whole chains is another sensor
        if 0 in orders or (2 in orders and not chains and not out):
            chain = tuple(orders.get(k) for k in range(3))
            out.append(chain)
            for name in filter(None, chain):
                reasons[name] = clues[name].why
    return out
