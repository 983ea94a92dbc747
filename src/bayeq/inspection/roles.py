"""Roles of channels (displacement, velocity, acceleration or force), from units, names and derivative links."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from fractions import Fraction

from bayeq.inspection.links import CLEARLY, SAME, Link
from bayeq.records.names import FORCES, REVOLUTIONS, in_si, parse_unit

# Order of a channel: that of the derivative of its coordinate, 0 to 2, or input, reference, first-order state.
INPUT, REFERENCE, STATE = -1, -2, -3
TITLES = {0: "displacement", 1: "velocity", 2: "acceleration", INPUT: "force or input"}

LOADS = {*FORCES, "Nm", "kNm", "mNm"}
ANGLES = {"rad", "mrad", "deg", "°", "rev", "rpm"}
DEGREES = {"deg", "°"}
PRESSURES = {"Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi", "atm", "mmHg"}
NAMES_OF_ANGLES = {"th", "theta", "phi", "angle", "winkel"}
WARMTH = {"°C", "K", "degC", "°F", "degF"}

# Words of names in English, German, French, Spanish and Italian, in small letters without accents. Quantities take
# precedence over sensors and places, these over symbols; a single letter counts only as the first word.
LEVELS = "level niveau pegel fullstand fuellstand"
QUANTITIES: Mapping[int, str] = {
    0: "disp displ displacement pos position angle deflection stroke travel weg auslenkung winkel lage ausschlag hub"
    " verschiebung deplacement elongation desplazamiento spostamento",
    1: "vel velo velocity speed rate geschwindigkeit drehzahl vitesse velocidad velocita",
    2: "acc accel acceleration beschl beschleunigung aceleracion accelerazione",
    INPUT: "force kraft torque moment couple effort fuerza forza voltage volt spannung tension current strom courant"
    " power leistung puissance heizleistung pwm duty command cmd commanded commande befehl stell"
    " inflow zulauf zufluss flow durchfluss debit caudal",
    STATE: f"{LEVELS} temp temperature temperatur concentration konzentration",
}
SENSORS: Mapping[int, str] = {
    0: "lvdt laser encoder poti potentiometer",
    1: "gyro tacho",
    2: "accelerometer",
    INPUT: "load last charge in input exc excitation shaker anregung drive heater heizung pump pumpe pompe ambient room"
    " umgebung ambiante motor antrieb moteur",
}
SYMBOLS: Mapping[int, str] = {
    0: "x y z q s d o th theta phi psi",
    1: "v w om omega xd xdot yd ydot zd zdot dx dy dz thd thdot dth",
    2: "a ag xdd xddot ydd yddot zdd zddot ddx ddy ddz thdd thddot ddth",
    INPUT: "u f fx fy fz tau",
    REFERENCE: "r e",
}
TABLES = (QUANTITIES, SENSORS, SYMBOLS)
TIERS = tuple({word: order for order, words in table.items() for word in words.split()} for table in TABLES)
# KINDS: words for references and errors; for commands, which are references if they command a motion or a state; for
# measured forces; for currents. Of one motor's inputs the force is proposed, else the current, else the command.
# PLACES, also at the beginning of longer words: surroundings; a moving base, whose acceleration is an input.
KINDS = (
    "ref reference soll setpoint target desired demand consigne fuhrungs vorgabe error err fehler abweichung"
    " regelabweichung ecart erreur",
    "command cmd commanded commande befehl stell",
    "force kraft torque drehmoment moment couple effort fuerza forza load last charge",
    "current strom courant",
)
PLACES = (
    "ambient room umgebung ambiante raum outside",
    "base ground foundation fondation boden fundament sockel socle sol support shake shaking vibrante rutteltisch"
    " schwingtisch",
)
# Words of a base by themselves: Tischbeschleunigung may be that of a machine.
BASES = {"ag", "table", "tisch", "road", "fahrbahn", "strasse", "route"}
# Words that are no place: of quantities, motion sensors, symbols and values, and units in names.
OF_VALUES = "sensor channel ch signal raw meas measured actual ist filt filtered mm cm m s ms g deg rad"
NO_PLACE = {
    *OF_VALUES.split(),
    *TIERS[0],
    *(word for word, order in TIERS[1].items() if order != INPUT),
    *(word for word in TIERS[2] if len(word) > 1),
}
# Words of this many letters are found at the beginning and the end of longer ones: Motorspannung, Kraftmessdose.
COMPOUND = 5
SENSOR_ENDS = re.compile(r"(?<=\w{3})(mess)?(aufnehmer|sensor|geber|dose|zelle|wert|signal|grosse)$")

#: The largest correlation over all lags, by pair of channels.
Alike = Mapping[frozenset[str], float]
# Correlation from which two inputs belong to one motor.
ONE_INPUT = 0.5
# Rows by which channels of one place may be late, if their names say two.
LATE = 1.0
# A channel named like a force may be an acceleration if its fit to a second derivative exceeds this.
EXACTLY = 0.999


@dataclass(frozen=True, slots=True)
class Clue:
    """Role of a channel according to its unit and name."""

    order: int | None  # order of the derivative of its coordinate, or `INPUT`, `REFERENCE`, `STATE`
    why: str  # the reason in words
    by_unit: bool  # whether the order comes from the unit, which is surer than a name
    index: str  # distinguishes channels of one kind: the numbers in its name, or else its other words
    angle: bool | None  # whether it is of an angle, by its unit or name, or else of a length; None if unknown
    degrees: bool  # whether it is an angle in degrees
    symbol: bool = False  # whether the order comes from a symbol, which is less sure than a word
    rank: int = 0  # rank of an input: 0 measured force, 1 current, 2 command
    base: int | None = None  # order of the motion, if its name is that of what the others stand on
    place: frozenset[str] = frozenset()  # words and numbers of the name that are no quantity, sensor or axis
    axis: str = ""  # x, y or z, if the name says one

    def apart(self, other: Clue) -> bool:
        """Whether both names say where they are measured, and not the same place."""
        if self.axis and other.axis and self.axis != other.axis:
            return True
        return not (self.place <= other.place or other.place <= self.place)


@dataclass(frozen=True)
class Guess:
    """Roles of the channels."""

    # names of a coordinate and its derivatives, None where one is not measured; one name alone: a first-order state
    chains: tuple[tuple[str | None, ...], ...]
    inputs: tuple[str, ...]
    undecided: tuple[str, ...]  # channels that are not used; those without a reason may be anything
    reasons: Mapping[str, str]  # the reason for its role, by channel
    questions: tuple[str, ...] = ()  # open questions, a sentence each

    def driven_by(self, shares: Mapping[str, float], alike: Alike) -> Guess:
        """The guess with undecided channels as inputs, given the share of the residual motion that each explains."""
        reasons, questions = dict(self.reasons), list(self.questions)
        for name, share in shares.items():
            rivals = [
                other for other in shares if other != name and alike.get(frozenset((other, name)), 0.0) > ONE_INPUT
            ]
            if all(1.0 - shares[other] > CLEARLY * (1.0 - share) for other in rivals):
                percent = f"{100.0 * min(share, 0.999):.1f} %"
                reasons[name] = f"explains {percent} of what the motion itself leaves of the acceleration"
            elif all(shares[other] <= share for other in rivals):
                both = " and ".join([name, *rivals])
                questions.append(f"{both} move alike and each may drive the motion: add the nearer one as --input")
        inputs = [name for name in shares if name in reasons]
        undecided = tuple(name for name in self.undecided if name not in inputs)
        return Guess(self.chains, (*self.inputs, *inputs), undecided, reasons, tuple(questions))

    def exchanged(self, p: str, q: str) -> Guess:
        """The guess with channels p and q of a chain swapped, because p is the derivative of q."""
        other = {p: q, q: p}
        chains = tuple(tuple(name and other.get(name, name) for name in chain) for chain in self.chains)
        reasons = {**self.reasons, q: f"{p} derives from it", p: f"derives from {q}, against their units"}
        return replace(self, chains=chains, reasons=reasons)

    def without_absolute(self, of_base: Mapping[str, tuple[str, str]]) -> Guess:
        """The guess with absolute accelerations as undecided; `of_base` gives displacement and base of each."""
        said = {
            q: f"is absolute: {q} - {base} is the second derivative of {p}; as {p}::{q}: --remove-offset {q}={base}"
            for q, (p, base) in of_base.items()
        }
        return replace(self, undecided=(*self.undecided, *said), reasons={**self.reasons, **said})

    def role_of(self, name: str) -> str:
        """Role of a channel as a word; empty if it is undecided."""
        if name in self.inputs:
            return TITLES[INPUT]
        for chain in self.chains:
            if name in chain:
                return "state" if len(chain) == 1 else TITLES[chain.index(name)]
        return ""


def clues_of(units: Mapping[str, str]) -> dict[str, Clue]:
    """Read the units and names of the channels of a record.

    A prefix of all names is ignored if it implies no role, as rig of rig_x and rig_F, or is a letter before names of
    different roles. Names of a recorder's inputs, such as Voltage_0 and Voltage_1, imply no role at all.

    >>> {name: clue.order for name, clue in clues_of({"rig_x": "", "rig_F": ""}).items()}
    {'rig_x': 0, 'rig_F': -1}
    >>> [clue.order for clue in clues_of({"A_x": "", "A_F": ""}).values()]
    [0, -1]
    >>> [clue.order for clue in clues_of({"Voltage_0": "", "Voltage_1": ""}).values()]
    [None, None]
    """
    first = {name.rpartition("_")[0] for name in units}
    if len(units) < 2 or len(first) > 1:
        return _together({name: clue_of(name, unit) for name, unit in units.items()}, units)
    rest = {name: name.rpartition("_")[2] for name in units}
    said, tier, _ = _order_of_name(_parts("".join(first)))
    if said == INPUT and tier == 0 and all(name.isdigit() for name in rest.values()):
        return {name: clue_of(f"ch{rest[name]}", unit) for name, unit in units.items()}
    kinds = {_order_of_name(_parts(name))[0] for name in rest.values()}
    plain = said is None or (tier == 2 and None not in kinds and len(kinds) > 1)
    return _together({name: clue_of(rest[name] if plain else name, unit) for name, unit in units.items()}, units)


def _together(clues: Mapping[str, Clue], units: Mapping[str, str]) -> dict[str, Clue]:
    """Clues with what the other channels say: a pressure beside a displacement is an input, as that of a cylinder."""
    pressures = [name for name, unit in units.items() if unit in PRESSURES and clues[name].order in (None, 0, 1, 2)]
    if any(clue.order == 0 for name, clue in clues.items() if name not in pressures):
        why = {name: f"its unit {units[name]}, beside a displacement" for name in pressures}
        given = {name: replace(clues[name], order=INPUT, why=why[name], by_unit=True, rank=0) for name in pressures}
        clues = {**clues, **given}
    return _on_a_base(clues)


def _on_a_base(clues: Mapping[str, Clue]) -> dict[str, Clue]:
    """Clues with the displacement of a base as an input if another is there, or an acceleration at another place.

    Where the base is all that moves, as the table of a machine, its acceleration is no input.
    """
    motions = [clue for clue in clues.values() if clue.order in (0, 1, 2)]
    alone = bool(motions) and all(clue.base is not None for clue in motions)
    borne = [clue for clue in motions if clue.base is None and clue.order in (0, 2)]
    out = dict(clues)
    for name, clue in clues.items():
        moved = any(one.order == 0 or one.apart(clue) for one in borne)
        if moved and clue.base == clue.order == 0 and not clue.angle:
            out[name] = replace(clue, order=INPUT, why="its name", by_unit=False)
        elif alone and clue.base == 2:
            out[name] = replace(clue, order=2)
    return out


def clue_of(name: str, unit: str) -> Clue:
    """Read a channel's unit and name.

    >>> clue_of("ch2", "m/s^2").order, clue_of("acc_left", "").order, clue_of("Motorspannung", "V").order
    (2, 2, -1)
    >>> clue_of("Weg_Soll", "mm").order, clue_of("x2", "").index, clue_of("ch1", "").order
    (-2, '2', None)
    """
    parts = _parts(name)
    by_name, tier, others = _order_of_name(parts)
    numbers = [part for part in parts if part.isdigit()]
    index = "_".join(numbers or others)
    by_unit = _order_of_unit(unit)
    turns = not unit and bool(NAMES_OF_ANGLES & set(parts))
    turns |= unit in REVOLUTIONS or bool(ANGLES & set(parse_unit(unit)))
    angle = turns or (False if by_unit in (0, 1, 2) else None)
    order, why = (by_name, "its name") if by_unit is None else (by_unit, f"its unit {unit}")
    wanted, commands, measured, current = (bool(set(words.split()) & set(parts)) for words in KINDS)
    ambient, moved = (any(_is_place(part, words.split()) for part in parts) for words in PLACES)
    moved |= bool(BASES & set(parts)) or {"floor", "0"} <= set(parts)
    base = order if moved and order in (0, 1, 2) else None
    rank = 2 if wanted or commands else 0 if measured or by_unit == INPUT else 1 if current else 2
    if (wanted and order != INPUT) or (commands and order in (0, 1, 2, STATE) and (by_unit is not None or not unit)):
        order, why = REFERENCE, "its name"
    elif (order == STATE and ambient) or base == 2:
        order, why = INPUT, "its name"
    elif by_name == STATE and order == 0:
        order, why = STATE, "its name"
    sure = by_unit is not None and order == by_unit
    why = why if order is not None else ""
    symbol = not sure and tier == 2 and base is None
    said = [part for part in others if part not in NO_PLACE and not _axis(part)]
    # xb and ab are both at b
    place = frozenset(part[-1] if re.fullmatch("[xyzqsdvwa][a-z]", part) else part for part in said).union(numbers)
    axis = next(filter(None, map(_axis, parts)), "")
    return Clue(order, why, sure, index, angle, unit in DEGREES, symbol, rank, base, place, axis)


def _axis(part: str) -> str:
    """The axis that a word names: x of x, ax, xdot and accx; or nothing."""
    found = re.fullmatch(r"(?:dd?|[av])?([xyz])(?:dd?|d?dot)?", part)
    if found:
        return found[1]
    return part[-1] if part[-1] in "xyz" and any(part[:-1] in words for words in TIERS[:2]) else ""


def _order_of_unit(unit: str) -> int | None:
    powers = parse_unit(unit)
    if any(symbol in LOADS for symbol in powers):
        return INPUT if len(powers) == 1 or set(powers) <= {"N", "m", "mm"} else None
    if unit in WARMTH:
        return STATE
    found = in_si(powers)
    if found is None:
        return None
    length, time = (found[1].get(symbol, Fraction(0)) for symbol in ("m", "s"))
    motion = length == 1 or (length == 0 and any(symbol in ANGLES for symbol in powers))
    return int(-time) if motion and time in (0, -1, -2) else None


def _parts(name: str) -> list[str]:
    """Words of a name in small letters without accents, divided at underscores, at numbers, between small and capital
    letters, and around the German words soll (wanted) and ist (actual)."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    divided = re.sub(r"([a-z])([A-Z])", r"\1_\2", plain).casefold()
    divided = re.sub(r"^i_(?=[a-z])", "current_", divided)  # i_q of a motor
    divided = re.sub(r"(?<![^\W_])(soll|ist)(?=[a-z]{3})|(?<=[a-z])(soll)", r"_\1\2_", divided)
    parts = re.findall(r"\d+|[^\W\d_]+", divided)
    return [SENSOR_ENDS.sub("", part) or part for part in parts]


def _order_of_name(parts: Sequence[str]) -> tuple[int | None, int, list[str]]:
    """Order that the most significant word of a name implies, the tier of that word, and the other words."""
    for tier, table in enumerate(TIERS):
        said = [(k, order) for k, part in enumerate(parts) if (order := _said(part, table, tier, k)) is not None]
        if said:
            k, order = said[-1]  # the head of "shaker acceleration" is its last word
            others = [_stem(part, table) if i == k else part for i, part in enumerate(parts)]
            return order, tier, [part for part in others if part and not part.isdigit()]
    return None, 0, [part for part in parts if not part.isdigit()]


def _said(part: str, table: Mapping[str, int], tier: int, place: int) -> int | None:
    """Order that a word implies: by itself, with an axis behind it, or as the beginning or end of a longer word."""
    if part in table or tier == 2:
        return table.get(part) if len(part) > 1 or place == 0 else None
    if len(part) > 3 and part[-1] in "xyz" and part[:-1] in table:
        return table[part[:-1]]
    within = [w for w in table if len(w) >= COMPOUND and part.startswith(w)] + _ends(part, table)
    return table[max(within, key=len)] if within else None


def _ends(part: str, table: Mapping[str, int]) -> list[str]:
    """Words of a table in which a compound may end."""
    return [w for w in table if (len(w) >= COMPOUND or w == "weg") and part.endswith(w)]


def _stem(part: str, table: Mapping[str, int]) -> str:
    """A compound without the words of the table that end it, as pendel of pendelwinkelgeschwindigkeit; else empty."""
    stem = part
    while ends := _ends(stem, table):
        stem = stem.removesuffix(max(ends, key=len))
    return stem if stem != part else ""


def _is_place(part: str, places: Sequence[str]) -> bool:
    """Whether a word is a place, or begins with it: Fundamentbeschleunigung, but no shaker."""
    return part in places or any(len(w) >= COMPOUND and part.startswith(w) and len(part) > len(w) + 3 for w in places)


def names_level(name: str) -> bool:
    """Whether a name says that it is the level of a liquid."""
    return bool(set(LEVELS.split()) & set(_parts(name)))


def guess_roles(
    names: Sequence[str],
    clues: Mapping[str, Clue],
    links: Sequence[Link],
    first: Mapping[str, float],
    alike: Alike,
    twins: Set[frozenset[str]],
    rough: set[str],
    step: float,
) -> Guess:
    """Assign channels that move to chains and inputs.

    `clues` are the roles by unit and name; `links` the derivatives found, the surest first; `first` the share of each
    first-order state that channels explain; `alike` the correlations; `twins` the pairs that measure one motion;
    `rough` the channels that look like noise; `step` the time step.
    """
    reasons: dict[str, str] = {}
    questions: list[str] = []
    clues = _with_base(names, clues, links, questions)
    runs = _runs(_clear(_agreeing(links, clues, step), questions), reasons)
    linked = {name for run in runs for name in run if name is not None}
    of_order = {k: [n for n in names if clues[n].order == k and n not in linked] for k in (INPUT, REFERENCE, 0)}
    for name in of_order[REFERENCE]:
        reasons[name] = "is what the motion is to follow, or an error, and does not drive it"
        if clues[name].symbol:  # R of S, I and R
            reasons[name] = f"may be a reference or an error, by its letter: if it is a state, --chain {name}"
    for k, name in enumerate(of_order[0]):
        same = [other for other in of_order[0][:k] if frozenset((name, other)) in twins]
        if same:
            reasons[name] = f"moves as {same[0]} does"
        elif name in rough and not rough.issuperset(n for n in names if clues[n].order == 0):
            reasons[name] = "jumps from row to row as noise does"
        near = [other for other in of_order[0][:k] if alike.get(frozenset((name, other)), 0.0) > SAME]
        if near and name not in reasons:
            questions.append(f"{name} moves nearly as {near[0]} does: if both measure one point, leave one out")
    inputs = []
    for name in of_order[INPUT]:
        one = [other for other in of_order[INPUT] if alike.get(frozenset((name, other)), 0.0) > ONE_INPUT]
        nearest = min(one, key=lambda other: clues[other].rank, default=name)
        if clues[nearest].rank < clues[name].rank:
            reasons[name] = f"moves as {nearest} does, which is nearer to the motion: they are one input"
            continue
        inputs.append(name)
        like = [link for link in links if link.above == name and clues[link.below].order != REFERENCE]
        also = [f"; it moves as {'-' * (link.gain < 0.0)}{link.stands_for} too" for link in like[:1]]
        reasons[name] = clues[name].why + "".join(also)
        questions += _exchanged(name, links, clues)
    rest = [name for name in names if name not in linked and name not in reasons]
    chains = _chains([_placed(run, clues) for run in runs], rest, clues, first, bool(alike), reasons)
    for chain in chains:
        present = [(k, name) for k, name in enumerate(chain) if name is not None]
        for (k, low), above in zip(present, [*present[1:], None], strict=True):
            if low not in reasons:
                why = "nothing else fits it"
                if above is not None:
                    why = f"{above[1]} is its {'second ' * (above[0] - k == 2)}derivative"
                reasons[low] = clues[low].why or why
    if not inputs and chains and all(len(chain) == 3 and chain[0] and chain[2] for chain in chains):
        inputs = [n for n in of_order[0] if n not in reasons and clues[n].by_unit and all(n not in c for c in chains)]
        for name in inputs:
            reasons[name] = f"{clues[name].why}; the others have accelerations and it has none: as a base that moves"
    used = {name for chain in chains for name in chain} | set(inputs)
    ordered = sorted(chains, key=lambda chain: min(names.index(name) for name in chain if name is not None))
    undecided = tuple(name for name in names if name not in used)
    return Guess(tuple(ordered), tuple(inputs), undecided, reasons, tuple(questions))


def _with_base(
    names: Sequence[str], clues: Mapping[str, Clue], links: Sequence[Link], questions: list[str]
) -> Mapping[str, Clue]:
    """Clues with the acceleration of a base as an input; without another input it may be known by its sign alone.

    Above its resonance a mass stays behind, so that its motion against the base is the reverse of that of the base.
    """
    if any(clues[name].order == INPUT for name in names):
        return clues
    for link in links:
        below, above = clues[link.below], clues[link.above]
        places = [
            {word for word in clue.index.split("_") if not word.isdigit() and all(word not in table for table in TIERS)}
            for clue in (below, above)
        ]
        if (
            link.gain < 0.0
            and below.order in (0, 1)
            and above.order == 2
            and all(places)
            and not set.intersection(*places)
        ):
            why = f"moves as -{link.stands_for}, at another place: as a base does above the resonance"
            own = f"--{'vel' if below.order else 'disp'} {link.below} --acc {link.above} --scale {link.above}=-1"
            questions.append(f"if {link.above} belongs to {link.below} and is reversed: {own}")
            return {**clues, link.above: replace(above, order=INPUT, why=why, base=2)}
    return clues


def _exchanged(name: str, links: Sequence[Link], clues: Mapping[str, Clue]) -> list[str]:
    """Questions where an input fits a second derivative clearly better than an acceleration known only by name."""
    own = [link for link in links if link.above == name and link.order == 2 and not clues[name].by_unit]
    return [
        f"{name} is {link.stands_for} more closely than {other.above} is: are their names exchanged?"
        for link in own
        for other in links
        if (other.below, other.order) == (link.below, 2)
        and clues[other.above].order == 2
        and not clues[other.above].by_unit
        and link.fit > EXACTLY
        and CLEARLY * (1.0 - link.fit) < 1.0 - other.fit
    ]


def _agreeing(links: Sequence[Link], clues: Mapping[str, Clue], step: float) -> list[tuple[int, Link]]:
    """Links with a grade: -1 if names agree, 0 if unknown, 1 if they disagree; contradicted links are left out.

    Names of two places are linked only if gain, sign and delay (of rows of `step` seconds) say so.
    """
    counts = Counter(clue.order for clue in clues.values())

    def contradiction(link: Link) -> int:
        below, above = clues[link.below], clues[link.above]
        for clue in (below, above):
            if clue.order in (INPUT, REFERENCE, STATE) and not (clue.symbol and abs(abs(link.gain) - 1.0) < 0.1):
                return 2  # something proportional to a force, or that follows a reference
        if below.order is None or above.order is None:
            return 0 if link.usual or below.order != above.order else 2
        as_said = above.order - below.order == link.order
        if as_said and below.apart(above) and abs(link.delay) > LATE * step:
            return 2
        # the only one of its kind needs no index, but two places are not one
        together = below.index == above.index or 1 in (counts[below.order], counts[above.order])
        together = together and not below.apart(above)
        if together and as_said:
            return -1
        by_unit = below.by_unit and above.by_unit and not as_said
        return 2 if by_unit or link.gain < 0.0 or not link.usual else 1

    graded = [(contradiction(link), link) for link in links]
    return sorted(((grade, link) for grade, link in graded if grade < 2), key=lambda one: (one[0], one[1].order))


def _clear(graded: Sequence[tuple[int, Link]], questions: list[str]) -> list[Link]:
    """Links that have no rival of about the same fit; pairs of rivals are added to `questions`."""
    doubtful: list[Link] = []
    for grade, link in graded:
        rivals = [
            other
            for g, other in graded
            if g == grade
            and other.order == link.order
            and (other.below == link.below) != (other.above == link.above)
            and 1.0 - other.fit < CLEARLY * (1.0 - link.fit)
        ]
        doubtful += [link] if rivals else []
        questions += [
            f"{link.above} and {other.above} both move as {link.stands_for}: which one is it?"
            for other in rivals
            if link.below == other.below and link.above < other.above
        ]
    return [link for _, link in graded if link not in doubtful]


def _runs(links: Sequence[Link], reasons: dict[str, str]) -> list[list[str | None]]:
    """Runs of channels, each the derivative of the one before; a channel belongs to one run."""
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
    while start in up and start != end:
        start = up[start].above
    return start == end


def _placed(run: list[str | None], clues: Mapping[str, Clue]) -> tuple[str | None, ...]:
    """A run as a chain of second order, starting at the derivative that most clues of its channels imply."""
    votes = [order - k for k, name in enumerate(run) if name is not None and (order := clues[name].order) in (0, 1, 2)]
    shift = max(sorted(set(votes)), key=votes.count) if votes else 0
    shift = min(max(shift, 0), 3 - len(run))
    return (*[None] * shift, *run, *[None] * (3 - shift - len(run)))


def _chains(
    found: Sequence[tuple[str | None, ...]],
    rest: Sequence[str],
    clues: Mapping[str, Clue],
    first: Mapping[str, float],
    compared: bool,
    reasons: dict[str, str],
) -> list[tuple[str | None, ...]]:
    """The chains of links, completed by units and names, and new chains of the remaining channels."""
    # symbols such as v and w are ambiguous: if links could be found, they are velocities only with a link
    motion = [
        n for n in rest if clues[n].order in (0, 2) or (clues[n].order == 1 and not (compared and clues[n].symbol))
    ]
    states = [n for n in rest if clues[n].order == STATE and not found and not motion]
    # next to a motion known by unit or word, a channel without either is a trigger or the like, even if explained; a
    # single symbol that others explain may also be a controlled position
    explained = [n for n in rest if n in first and not clues[n].by_unit and clues[n].order != STATE]
    surer = found or any(not clues[n].symbol and n not in explained for n in motion)
    if not surer and (len(explained) > 1 or all(clues[name].order is None for name in explained)):
        states += explained
    for name in states:
        share = f": the channels explain {100 * min(first[name], 0.999):.1f} % of its changes" if name in first else ""
        reasons[name] = f"a state of first order{', by ' * bool(clues[name].why)}{clues[name].why}{share}"
    left = [name for name in motion if name not in states]
    counts = Counter(clues[name].order for name in left)
    alone = max(counts.values(), default=0) <= 1
    chains = [list(chain) for chain in found]
    firsts = [next(clues[name] for name in chain if name is not None) for chain in found]
    for name in left:
        clue, order = clues[name], int(clues[name].order or 0)
        of_kind = [  # no angle belongs to a length
            (chain, other)
            for chain, other in zip(chains, firsts, strict=True)
            if not {True, False} <= {clues[n].angle for n in (name, *chain) if n is not None}
        ]
        fits = [
            chain
            for chain, other in of_kind
            if chain[order] is None
            and not clue.apart(other)
            and (clue.index == other.index or (len(chains) == 1 and counts[order] == 1) or (alone and not found))
        ]
        if not fits and all(clue.index != other.index or clue.apart(other) for _, other in of_kind):
            fits = [[None, None, None]]
            chains += fits
            firsts.append(clue)
        if fits:
            fits[0][order] = name
    # a channel without a derivative is a coordinate only if there are no surer ones, otherwise another sensor, unless
    # it is at a place of its own; a velocity alone is a coordinate only by its unit
    sure = states or any(chain[0] is not None and chain != [chain[0], None, None] for chain in chains) or found
    by_unit = [[n if k != 1 or n is None or clues[n].by_unit else None for k, n in enumerate(c)] for c in chains]
    lone = next((k for k in (0, 2, 1) if any(chain[k] is not None for chain in by_unit)), 2)
    own = [all(one is other or one.apart(other) for other in firsts) for one in firsts]
    kept = [
        tuple(chain)
        for k, chain in enumerate(chains)
        if k < len(found)
        or (chain[0] is not None and any(chain[1:]))
        or (not sure and (chain[lone] is not None or (chain[2] is not None and own[k])))
    ]
    return [*kept, *((name,) for name in states)]
