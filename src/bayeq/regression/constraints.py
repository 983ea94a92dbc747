"""Known relations between the coefficients of an equation, as a user writes them: ``u == 1``, ``0 <= x**3 <= 5``.

The name of a candidate term stands for its coefficient, in original units. Equalities are linear and take terms out of
the regression before inference (`bayeq.regression.equalities`), signs and bounds are part of the prior
(`bayeq.inference.signs`).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import ExpressionError, InputError, UnknownNameError
from bayeq.expressions import FUNCTIONS, Binary, Evaluator, Expression, Negate, Node, Unknown, parse
from bayeq.expressions.functions import CONSTANTS
from bayeq.inference.prior import Prior, common, half_lines, limited, signs_of
from bayeq.regression.equalities import Equalities, Linear
from bayeq.states import Chain
from bayeq.states.derive import LARGEST

# Suffix of a conserved sum of states in an answer's list of constraints.
CONSERVED = " is conserved"

_RELATIONS = "==|<=|>=|!=|<|>|=|~"

_BOUND = "an inequality bounds one coefficient by numbers, as in 'v <= 0' or '0 <= x**3 <= 5'; no sums"


@dataclass(frozen=True, eq=False)
class Constraints:
    """Known relations between the coefficients of one equation, with limits and prior distributions of these."""

    equalities: Equalities  # linear equations between coefficients
    # (P, 2), least and largest value of each coefficient, infinite where there is none; a sign is a limit of 0
    limits: Floats
    # coefficients with a known normal distribution: term, mean and standard deviation
    stated: tuple[tuple[int, float, float], ...] = ()

    @property
    def binding(self) -> bool:
        """Whether there is a limit or an equality."""
        return bool(np.isfinite(self.limits).any()) or len(self.equalities.eliminated) > 0

    @property
    def concerned(self) -> Bools:
        """Terms with a limit, an equality or a known distribution, (P,)."""
        out = limited(self.limits)
        out[self.equalities.eliminated] = True
        out[self.equalities.kept[(self.equalities.slopes != 0.0).any(axis=0)]] = True
        out[[j for j, _, _ in self.stated]] = True
        return out

    @property
    def forced(self) -> Bools:
        """Terms that must be in every equation that may have them, because their limits exclude zero, (P,)."""
        return (self.limits[:, 0] > 0.0) | (self.limits[:, 1] < 0.0)

    @property
    def bounds(self) -> Floats | None:
        """`limits` (P, 2) of coefficients of which more than the sign is known, infinite for others; None if none."""
        bounded = (signs_of(self.limits) == 0)[:, None]
        return np.where(bounded, self.limits, [-np.inf, np.inf]) if (bounded & np.isfinite(self.limits)).any() else None

    def among(self, allowed: Bools) -> Constraints:
        """The constraints with terms not `allowed`, (P,), set to zero, and without equalities between these alone."""
        if allowed.all():
            return self
        names, known = self.equalities.names, self.equalities.equations
        equations = [
            (Linear(factors, -value), "constraints") for factors, value in known if allowed[list(factors)].any()
        ]
        equations += [(Linear({int(j): 1.0}, 0.0), f"term {names[j]}") for j in np.flatnonzero(~allowed)]
        kept = tuple(one for one in self.stated if allowed[one[0]])
        limits = np.where(allowed[:, None], self.limits, [-np.inf, np.inf])
        return replace(self, equalities=Equalities.solving(names, equations), limits=limits, stated=kept)

    def prior(self, prior: Prior, unit: Floats | float = 1.0) -> Prior:
        """The prior of the F terms that the equalities keep, from a prior of all P terms, with the limits as bounds.

        A coefficient times `unit`, (F,), is its value in units of the regression. An InputError refuses limits that
        contradict each other or the equalities, or that concern a sum of several coefficients.
        """
        names, kept = self.equalities.names, self.equalities.kept
        prior.validate(len(names))
        limits, inclusion = self.limits.copy(), np.asarray(prior.prior_inclusion, dtype=np.float64)
        if prior.signs is not None:
            for j, (low, high) in enumerate(half_lines(np.asarray(prior.signs))):
                _narrow(limits, j, low, high, names, "the prior")
        for factors, value in self.equalities.equations:
            e, *others = factors
            low, high = limits[e]
            if not np.isfinite([low, high]).any():
                continue
            if not others:
                if not low <= value <= high:
                    raise InputError(
                        f"constraints: one says that {names[e]} is {value:g}, another that it is {_said(low, high)}"
                    )
            elif len(others) == 1:
                ends = (value - limits[e]) / factors[others[0]]
                _narrow(limits, others[0], min(ends), max(ends), names, "the constraints")
            else:
                raise InputError(
                    f"constraints: the sign of {names[e]} would be that of a sum of coefficients, for an equation gives"
                    f" {names[e]} by others; write another term first in that equation"
                )
        left = limits[kept]
        inside = (left[:, 0] <= 0.0) & (left[:, 1] >= 0.0)
        if inclusion.ndim or not inside.all():
            inclusion = np.broadcast_to(inclusion, len(names))[kept]
            inclusion = np.where(inside | (inclusion == 0.0), inclusion, 1.0)
        left = left * np.broadcast_to(unit, len(kept))[:, None]
        if prior.bounds is not None:
            left = common(left, np.asarray(prior.bounds, dtype=np.float64)[kept])
        return replace(
            prior,
            prior_inclusion=inclusion if inclusion.ndim else prior.prior_inclusion,
            signs=None,
            bounds=left if np.isfinite(left).any() else None,
        )


def _said(low: float, high: float) -> str:
    """Limits in words."""
    if math.isfinite(low) and math.isfinite(high):
        return f"between {low:g} and {high:g}"
    return f"at least {low:g}" if math.isfinite(low) else f"at most {high:g}"


def _narrow(limits: Floats, j: int, low: float, high: float, names: Sequence[str], where: str) -> None:
    """Intersect the limits of a coefficient with further ones; + 0.0 turns -0.0 into 0.0."""
    low, high = max(limits[j, 0], low) + 0.0, min(limits[j, 1], high) + 0.0
    if low == high == 0.0:
        raise InputError(
            f"{where}: {names[j]} cannot have both signs; write '{names[j]} == 0', or leave it out of the dictionary"
        )
    if not low < high:
        raise InputError(
            f"{where}: {names[j]} would be at least {low:g} and at most {high:g}: correct one of these, or write"
            f" '{names[j]} == {low:g}'"
        )
    limits[j] = low, high


def parse_constraints(
    texts: str | Sequence[str],
    terms: Sequence[Expression],
    targets: Sequence[str],
    dropped: Mapping[str, str] | None = None,
    allowed: Bools | None = None,
) -> tuple[Constraints, ...]:
    """Read the constraints of each target; nothing in them is evaluated as code.

    ``"u == 1"``, ``"x*abs(x) == 0.5*x**3"``, ``"x + 2*v == 3"``: linear equations between coefficients; ``"v <= 0"``,
    ``"x**3 > 0"``: the sign of one (``<`` and ``<=`` mean the same); ``"0 <= x**3 <= 5"``: bounds of one;
    ``"u ~ 0.1 +- 0.001"``: one that was measured before, with its standard deviation. ``"a: v <= 0"`` and
    ``"0 <= a: x**3 <= 5"`` concern the equation of target a only, others concern every equation.

    `dropped` are candidates that were left out, each with the reason; `allowed`, (C, P), the candidates of each
    equation, by default all. An InputError refuses malformed text, a term that is not a candidate, or not one of the
    equation that is named, and equations, signs or bounds that contradict each other.

    Examples
    --------
    >>> terms = [parse(t) for t in ("x", "v", "u")]
    >>> (found,) = parse_constraints(["u == 1", "2*x == v", "v <= 0"], terms, ["a"])
    >>> found.equalities.kept.tolist(), found.limits[1].tolist()
    ([1], [-inf, 0.0])
    """
    texts = [texts] if isinstance(texts, str) else list(texts)
    reader = _Reader(terms, dropped or {}) if texts else _Reader((), {})
    names = tuple(term.text for term in terms)
    equations: dict[str, list[tuple[Linear, str]]] = {target: [] for target in targets}
    limits = {target: np.tile([-np.inf, np.inf], (len(terms), 1)) for target in targets}
    stated: dict[str, list[tuple[int, float, float]]] = {target: [] for target in targets}
    for text in texts:
        if not isinstance(text, str):
            raise InputError(f"a constraint is text such as 'u == 1', not {text!r}")
        if _is_tie(text):
            continue
        where = _where(text)
        target, body = _addressed(text, targets, where)
        for left, relation, right in _sides(body, where):
            if relation == "~":
                known = _stated(reader.read(left, where), right, where)
                _among(allowed, targets, target, known[:1], names, where)
                for t in [target] if target else targets:
                    stated[t].append(known)
                continue
            difference = reader.read(left, where).plus(reader.read(right, where), -1.0)
            if relation != "==" or difference.constant != 0.0:  # else a coefficient that is 0 may be in an equality
                _among(allowed, targets, target, difference.slopes, names, where)
            for t in [target] if target else targets:
                if relation == "==":
                    equations[t].append((difference, where))
                else:
                    _narrow(limits[t], *_bound(difference, relation, where), names, where)
    found = tuple(Constraints(Equalities.solving(names, equations[t]), limits[t], tuple(stated[t])) for t in targets)
    for constraints in found:
        constraints.prior(Prior())  # contradictions are reported at once
    return found


def _where(text: str) -> str:
    return f"constraint {text if len(text) <= 60 else text[:57] + '...'!r}"


def _among(
    allowed: Bools | None,
    targets: Sequence[str],
    target: str | None,
    terms: Iterable[int],
    names: Sequence[str],
    where: str,
) -> None:
    """Raise an InputError for a constraint on a term that is no candidate of the equation `target`."""
    if allowed is None or target is None:
        return
    for j in terms:
        if not allowed[list(targets).index(target), j]:
            raise InputError(f"{where}: {names[j]} is no candidate of {target}: add it there, or drop the constraint")


def parse_ties(
    texts: str | Sequence[str],
    terms: Sequence[Expression],
    targets: Sequence[str],
    dropped: Mapping[str, str] | None = None,
    allowed: Bools | None = None,
) -> tuple[tuple[str, tuple[tuple[int, int, float], ...], float], ...]:
    """Read ties between the coefficients of several equations, ``"a1: x1-x2 == 2*(a2: x2-x1)"``.

    Returns for each tie its text; equation, term and factor of each coefficient; and the value of their sum. An
    InputError refuses malformed text, or a term that is not a candidate; `dropped` and `allowed` as in
    `parse_constraints`.
    """
    texts, names = [texts] if isinstance(texts, str) else list(texts), [term.text for term in terms]
    reader, out = _Reader(terms, dropped or {}), []
    for text in filter(_is_tie, texts):
        where = _where(text)
        sides = text.split("==")
        if len(sides) != 2:
            raise InputError(f"{where}: write a tie as 'a1: x1-x2 == 2*(a2: x2-x1)'")
        parts: list[tuple[int, int, float]] = []
        total = 0.0
        for side, sign in zip(sides, (1.0, -1.0), strict=True):
            factor, target, body = _side_of(side, where)
            if target not in targets:
                raise UnknownNameError("equation", target, targets, where=where)
            linear = reader.read(body, where).times(sign * factor)
            _among(allowed, targets, target, linear.slopes, names, where)
            parts += [(list(targets).index(target), j, slope) for j, slope in linear.slopes.items()]
            total -= linear.constant
        if len(parts) < 2:
            raise InputError(f"{where}: a tie needs a coefficient on each side")
        out.append((text, tuple(parts), total))
    return tuple(out)


def parse_conserved(text: str, chains: Sequence[Chain]) -> dict[int, float]:
    """A sum of states that is conserved, ``"S + I + R"`` or ``"2*S + I"``: factors by the number of the equation; an
    InputError refuses malformed text, or a state that is not the only one of its chain."""
    where, states = f"conserve {text!r}", [chain.states[0] for chain in chains if chain.order == 1]
    plain = " + ".join(part.strip() for part in re.split("[,;]", text.partition("=")[0]))
    if plain != text.strip() and re.search("[=,;]", text):
        raise InputError(f"{where}: write the sum alone: {plain}")
    linear = _Reader([parse(name, [name]) for name in states], {}, "state of first order").read(text, where)
    if linear.constant != 0.0 or len(linear.slopes) < 2:
        raise InputError(f"{where}: name at least two states of first order, as in 'S + I + R'")
    number = [c for c, chain in enumerate(chains) if chain.order == 1]
    return {number[j]: factor for j, factor in linear.slopes.items()}


def _side_of(text: str, where: str) -> tuple[float, str, str]:
    """Factor, target and body of a side such as ``2*(a2: x2-x1)``."""
    found = re.fullmatch(r"(?s)(?:([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*\*)?\s*(.*)", text.strip())
    assert found is not None
    number, rest = found[1], found[2]
    if rest.count("(") != rest.count(")"):
        raise InputError(f"{where}: a bracket is missing: write a tie as 'a1: x1-x2 == 2*(a2: x2-x1)'")
    if re.match(r"[-+]?[0-9.]+\s*\(", rest):
        raise InputError(f"{where}: a * is missing: write a tie as 'a1: x1-x2 == 2*(a2: x2-x1)'")
    inside = rest[1:-1] if rest.startswith("(") and rest.endswith(")") else rest
    target, colon, body = (part.strip() for part in inside.partition(":"))
    try:
        factor = 1.0 if number is None else float(number)
    except ValueError:
        colon = ""
    if not (colon and body) or not 0.0 < abs(factor) <= LARGEST:
        raise InputError(f"{where}: write a tie as 'a1: x1-x2 == 2*(a2: x2-x1)'")
    return factor, target, body


def _is_tie(text: str) -> bool:
    """Whether a constraint names two equations."""
    return isinstance(text, str) and re.sub(r"\{[^{}]*\}", "", text).count(":") > 1  # without colons of ranges


def _addressed(text: str, targets: Sequence[str], where: str) -> tuple[str | None, str]:
    """The target in front of the colon, if there is one, and the rest."""
    front, colon, body = text.partition(":")
    if not colon or "{" in front:  # the colon of a range
        return None, text
    bound, relation, target = re.fullmatch(r"(?s)(?:(.*)([<>]=?))?(.*)", front).groups(default="")  # type: ignore[union-attr]
    if target.strip() not in targets:
        raise UnknownNameError("equation", target.strip(), targets, where=where)
    return target.strip(), bound + relation + body


def _sides(text: str, where: str) -> list[tuple[str, str, str]]:
    """Left side, relation and right side of each relation; two relations where a coefficient has two bounds."""
    # comparisons in brackets are conditions of the function where
    depth = np.cumsum([(c == "(") - (c == ")") for c in text]) if text else np.zeros(0)
    found = [m for m in re.finditer(_RELATIONS, text) if depth[m.start()] <= 0]
    ends = [0, *(edge for m in found for edge in m.span()), len(text)]
    parts = [text[a:b].strip() for a, b in itertools.pairwise(ends)]
    relations = parts[1::2]
    twice = (
        len(relations) == 2
        and len({one[0] for one in relations} & {"<", ">"}) == 1
        and relations[0][0] == relations[1][0]
    )
    if not (len(relations) == 1 or twice) or relations[0] in ("=", "!=") or not all(parts):
        raise InputError(f"{where}: write one ==, <=, >= or ~ between two sides, as in 'u == 1' or 'v <= 0'")
    return [(parts[k - 1], parts[k], parts[k + 1]) for k in range(1, len(parts), 2)]


def _stated(left: Linear, right: str, where: str) -> tuple[int, float, float]:
    """The one term of a side, and the mean and standard deviation that were measured for its coefficient."""
    form = f"{where}: write what is known of a coefficient as 'u ~ 0.1 +- 0.001'"
    parts = [part.strip() for part in re.split(r"\+-|\+/-|±", right)]
    try:
        mean, sd = map(float, parts)
    except ValueError:
        raise InputError(form) from None
    if left.constant != 0.0 or len(left.slopes) != 1 or not (abs(mean) <= LARGEST and 0.0 < sd <= LARGEST):
        raise InputError(f"{form}: one term, a number, and a standard deviation above 0")
    ((j, slope),) = left.slopes.items()
    return j, mean / slope, sd / abs(slope)


def _bound(difference: Linear, relation: str, where: str) -> tuple[int, float, float]:
    """The one term of a difference, with its lower and upper bound."""
    if len(difference.slopes) != 1:
        raise InputError(f"{where}: {_BOUND}")
    ((j, slope),) = difference.slopes.items()
    end = -difference.constant / slope
    return (j, end, math.inf) if (slope > 0.0) == relation.startswith(">") else (j, -math.inf, end)


class _Reader:
    """Reads text as linear combinations of the coefficients of candidate terms."""

    def __init__(self, terms: Sequence[Expression], dropped: Mapping[str, str], kind: str = "candidate term") -> None:
        self.kind = kind
        self.names = [term.text for term in terms]
        self.channels = {name for term in terms for name in term.names}
        self.dropped = list(dropped.items())
        # candidates by their tree as written, and by their factors in any order; those left out count down from -1
        self.trees: dict[Node, int] = {}
        self.products: dict[frozenset[tuple[Node, float]], int] = {}
        for j, term in enumerate(terms):
            self._enter(term.named(), j)
        for k, (name, _) in enumerate(self.dropped):
            self._enter(self._parsed(name), -1 - k)

    def _enter(self, term: Expression, j: int) -> None:
        self.trees.setdefault(term.tree, j)
        number, factors = _product(term.tree)
        if number == 1.0:
            self.products.setdefault(frozenset(factors.items()), j)

    def read(self, text: str, where: str) -> Linear:
        try:
            tree = self._parsed(text).tree
        except ExpressionError as error:
            raise ExpressionError(f"{where}: {error}") from error
        out = self._linear(tree, where)
        if not all(abs(number) <= LARGEST for number in (out.constant, *out.slopes.values())):  # false for NaN
            raise InputError(f"{where}: a number is not finite, or beyond {LARGEST:g}; give channels in larger units")
        return out

    def _parsed(self, text: str) -> Expression:
        """A side of a relation; a channel of the terms may have the name of a constant, or of a function."""
        others = {name for name in re.findall(r"[^\W\d]\w*", text) if name not in CONSTANTS and name not in FUNCTIONS}
        return parse(text, self.channels | others).named()

    def _linear(self, node: Node, where: str) -> Linear:
        if _is_number(node):
            return Linear({}, _number(node))
        j = self.trees.get(node)
        if j is not None:
            return self._term(j, 1.0, where)
        if isinstance(node, Negate):
            return self._linear(node.operand, where).times(-1.0)
        if isinstance(node, Binary) and node.op in "+-":
            j = self.trees.get(Binary("-", node.right, node.left)) if node.op == "-" else None
            if j is not None:
                return self._term(j, -1.0, where)
            right = self._linear(node.right, where)
            return self._linear(node.left, where).plus(right, 1.0 if node.op == "+" else -1.0)
        if isinstance(node, Unknown):
            name = node.name
            raise InputError(
                f"{where}: {{{name}}} is a constant inside a term: write its range there, {{{name}: low..high}}"
            )
        number, factors = _product(node)
        j = self.products.get(frozenset(factors.items()))
        if j is not None:
            return self._term(j, number, where)
        if list(factors.values()) == [1.0]:
            (only,) = factors
            if isinstance(only, Negate) or (isinstance(only, Binary) and only.op in "+-"):
                return self._linear(only, where).times(number)
        raise UnknownNameError(self.kind, Expression(node).text, self.names, where=where)

    def _term(self, j: int, number: float, where: str) -> Linear:
        if j < 0:
            name, reason = self.dropped[-1 - j]
            raise InputError(f"{where}: term {name} was left out of the dictionary: {reason}")
        return Linear({j: number} if number != 0.0 else {}, 0.0)


def _is_number(node: Node) -> bool:
    return not Expression(node).names and not Expression(node).unknowns


def _number(node: Node) -> float:
    return float(Evaluator({})(Expression(node)))


def _product(node: Node) -> tuple[float, dict[Node, float]]:
    """A term as a number times powers of factors: ``v*x/2`` is 0.5 and {v: 1, x: 1}."""
    if _is_number(node):
        return _number(node), {}
    if isinstance(node, Negate):
        number, factors = _product(node.operand)
        return -number, factors
    if isinstance(node, Binary) and node.op in "*/":
        number, factors = _product(node.left)
        other, more = _product(node.right)
        power = 1.0 if node.op == "*" else -1.0
        for base, exponent in more.items():
            factors[base] = factors.get(base, 0.0) + power * exponent
        with np.errstate(all="ignore"):
            number = float(np.multiply(number, np.power(other, power)))
        return number, {base: exponent for base, exponent in factors.items() if exponent != 0.0}
    if isinstance(node, Binary) and node.op == "**" and _is_number(node.right):
        power = _number(node.right)
        number, factors = _product(node.left)
        if number == 1.0 and len(factors) == 1 and power.is_integer() and power != 0.0:
            return 1.0, {base: exponent * power for base, exponent in factors.items()}
    return 1.0, {node: 1.0}
