"""`Layout`: the state vector of a system, and its equations as a tape; `Series`: samples of its channels.

The states are, in this order: the derivatives of every chain but its highest; a discrepancy d of every equation; the
drift of every channel, where they drift; the lag of every channel that may be late; every input with its derivatives.
Between samples discrepancies, drifts and the highest derivatives of inputs are constant, and lags always.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.expressions import Binary, Call, Evaluator, Expression, Node, Number, Symbol, Tape, number
from bayeq.expressions.functions import TIME
from bayeq.expressions.implicit import solved
from bayeq.expressions.nodes import jumps_of, replaced
from bayeq.likelihood.signs import mean_of_jumps
from bayeq.states import Gain, Lag, Roles, rates

Course = Literal["smooth", "linear", "hold", "cubic", "band-limited"]

# How a state goes between samples: by the Taylor series of its derivatives, straight to the next sample, or held.
SMOOTH, STRAIGHT, HELD = 0, 1, 2


def input_states(name: str, width: int) -> list[str]:
    """Names of the derivatives of an input; they differ from names of inputs w and theta and of earlier samples."""
    return [f"{name}[[{k}]]" for k in range(1, width)]


class Candidates(NamedTuple):
    """Coefficients, by index: number k is that of term ``term[k]`` in the equation of chain ``chain[k]``."""

    chain: Ints  # (p,), number of the equation
    term: Ints  # (p,), number of the term; the number after the last term means the constant

    def take(self, index: NDArray[np.intp]) -> Candidates:
        """The coefficients at these positions."""
        return Candidates(self.chain[index], self.term[index])


#: No coefficient.
NOTHING = Candidates(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


class Stated(NamedTuple):
    """A normal prior on a weighted sum of coefficients, used as a measurement of it."""

    parts: tuple[tuple[int, int, float], ...]  # equation and term, as in `Candidates`, and factor of each coefficient
    mean: float  # in original units
    sd: float  # 0 for a tie: the sum equals `mean`


class Series(NamedTuple):
    """The samples of one record."""

    intervals: Floats  # (n - 1,), between samples [s]
    samples: Floats  # (n, M), of `Layout.channels`; NaN where there is none
    inputs: Floats  # (n, m, 4), the variables of `Layout.given`, interpolated by `bayeq.numerics.rk4.interpolant`
    spread: Floats  # (n, M), variance of the noise of each sample as a multiple of its channel's
    # (n, L, 2), deviation of each input from a straight line between samples: a fraction f of the interval after a
    # sample it is f (1 - f) (first + f second)
    bends: Floats


@dataclass(frozen=True, eq=False)
class Layout:
    """Positions of a system's states in the state vector, and the channels that measure them."""

    roles: Roles  # chains and inputs
    terms: tuple[Expression, ...]  # the P candidate terms, the same for every equation
    gains: tuple[Floats, ...]  # (K+1,), of each chain, see `bayeq.states.sensors`
    # number of derivatives of each input that are states: it is low-passed noise, see `bayeq.likelihood.low_pass`. 0
    # stands for a sequence of independent samples joined by straight lines, whose slope is a state all the same.
    smoothness: tuple[int, ...] = ()
    centres: tuple[float, ...] = ()  # mean of each input
    corners: tuple[float, ...] = ()  # of the spectrum of each input [rad/s]; not used for a random sequence
    # interpolation of each input between samples: "smooth", by its derivatives; "linear"; "hold"; or a straight line
    # plus the deviation from it of the "cubic" or "band-limited" interpolation of the samples
    courses: tuple[Course, ...] = ()
    drift: float = 0.0  # sampling interval as a share of the time in `Levels.drifts`; 0 if channels do not drift
    stated: tuple[Stated, ...] = ()  # priors on sums of coefficients
    # number of each channel that may be late, and the lag that has been removed from its samples
    late: tuple[tuple[int, Lag], ...] = ()
    uncertain: tuple[tuple[int, Gain], ...] = ()  # the same for channels whose factor may be off

    @property
    def discrete(self) -> bool:
        """Whether the equations are maps: these give next values instead of rates."""
        return self.roles.discrete

    @cached_property
    def has_constants(self) -> bool:
        """Whether terms hold constants of unknown value."""
        return any(term.unknowns for term in self.terms)

    @cached_property
    def chains(self) -> int:
        """C, the number of equations."""
        return len(self.roles.chains)

    @cached_property
    def motion(self) -> int:
        """Number of states that are derivatives of chains."""
        return len(self.roles.states)

    @cached_property
    def size(self) -> int:
        """S, the number of states."""
        return self.before_inputs + int(sum(self.widths))

    @cached_property
    def last(self) -> Ints:
        """Number of the state below each chain's highest derivative, (C,); for a static law that of chain c - 1."""
        return np.cumsum([chain.order for chain in self.roles.chains], dtype=np.int64) - 1

    @cached_property
    def discrepancy(self) -> Ints:
        """Number of the state that is each equation's discrepancy, (C,)."""
        return np.arange(self.motion, self.motion + self.chains, dtype=np.int64)

    @cached_property
    def drifts(self) -> Ints:
        """Number of the state that is each channel's drift, (M,), or (0,) if channels do not drift."""
        count = len(self.roles.channels) if self.drift else 0
        return np.arange(count, dtype=np.int64) + self.motion + self.chains

    @cached_property
    def lags(self) -> Ints:
        """Number of the state that is the remaining lag of each channel of `late`."""
        return np.arange(len(self.late), dtype=np.int64) + self.motion + self.chains + len(self.drifts)

    @cached_property
    def before_inputs(self) -> int:
        """Number of states before those of the inputs."""
        return self.motion + self.chains + len(self.drifts) + len(self.late)

    @cached_property
    def widths(self) -> Ints:
        """Number of states of each input, (L,)."""
        return 1 + np.maximum(np.array(self.smoothness, dtype=np.int64), 1)

    @cached_property
    def driven(self) -> Ints:
        """Number of the state that is each input, (L,)."""
        return self.before_inputs + np.cumsum(self.widths) - self.widths

    @cached_property
    def slope(self) -> Ints:
        """Number of the state that is each input's highest derivative, (L,)."""
        return self.driven + self.widths - 1

    @cached_property
    def given(self) -> tuple[str, ...]:
        """Variables of terms that are not states: t, if terms may use it."""
        return (TIME,) if self.roles.timed else ()

    @cached_property
    def jumps(self) -> tuple[Call, ...]:
        """Signs and floors with which the terms jump, (J,), see `bayeq.expressions.nodes.jumps_of`; none in maps."""
        if self.discrete:
            return ()
        found = {jump for term in self.terms for jump in jumps_of(term.tree)}
        return tuple(sorted(found, key=lambda jump: Expression(jump).text))

    @cached_property
    def jump_widths(self) -> tuple[str, ...]:
        """Names of the inputs that hold the width of each jump (`bayeq.likelihood.blur`)."""
        return tuple(f"w[{j}]" for j in range(len(self.jumps)))

    def jumps_in(self, chosen: Candidates) -> Bools:
        """Which of the jumps occur in the given candidates, (J,)."""
        own = {jump for j in chosen.term if j < len(self.terms) for jump in jumps_of(self.terms[j].tree)}
        return np.array([jump in own for jump in self.jumps], dtype=np.bool_)

    @cached_property
    def rates(self) -> tuple[tuple[float, ...], ...]:
        """For each chain, the factors from each derivative's channel to the rate of the state below it."""
        return tuple(tuple(rates(c, g.tolist())) for c, g in zip(self.roles.chains, self.gains, strict=True))

    @cached_property
    def factors(self) -> Floats:
        """Rate of the state below the highest derivative of each chain for a target of 1, (C,); 0 for static laws."""
        return np.array([rates[-1] if rates else 0.0 for rates in self.rates])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the states; states that are not channels have names that no channel can have."""
        extra = [f"d[{c}]" for c in range(self.chains)] + [f"b[{i}]" for i in range(len(self.drifts))]
        extra += [f"l[{i}]" for i in range(len(self.late))]
        for name, width in zip(self.roles.inputs, self.widths, strict=True):
            extra += [name, *input_states(name, width)]
        return (*self.roles.states, *extra)

    @cached_property
    def channels(self) -> tuple[tuple[str, int], ...]:
        """Name and kind of each channel: number of the state it measures, or -1 - c for the target of equation c."""
        out = []
        for c, chain in enumerate(self.roles.chains):
            first = int(self.last[c]) - chain.order + 1
            for k, name in enumerate(chain.measured):
                if name is not None:
                    out.append((name, first + k if k < chain.order else -1 - c))
        out += [(name, int(i)) for name, i in zip(self.roles.inputs, self.driven, strict=True)]
        return tuple(out)

    @property
    def first_input(self) -> int:
        """Number of the first input's channel; those of the other inputs follow."""
        return len(self.channels) - len(self.roles.inputs)

    @cached_property
    def kinds(self) -> Ints:
        """The kind of each of `channels`, (M,)."""
        return np.array([kind for _, kind in self.channels], dtype=np.int64)

    @cached_property
    def everything(self) -> Candidates:
        """The terms and the constant of each equation, one equation after the other."""
        width = len(self.terms) + 1
        index = np.arange(self.chains * width, dtype=np.int64)
        return Candidates(index // width, index % width)

    @cached_property
    def blurred(self) -> tuple[Expression, ...]:
        """The terms with each jump replaced by its mean (`bayeq.likelihood.signs`)."""
        widths: dict[Node, Node] = {jump: Symbol(name) for jump, name in zip(self.jumps, self.jump_widths, strict=True)}
        return tuple(Expression(mean_of_jumps(term.tree, widths)) for term in self.terms)

    @cached_property
    def implicit(self) -> bool:
        """Whether terms hold targets (`bayeq.expressions.implicit`)."""
        return any(term.names.intersection(self.roles.targets) for term in self.terms)

    def solved(self, chosen: Candidates, terms: Sequence[Expression]) -> tuple[list[Node], list[list[Node]]]:
        """Expressions of the targets without discrepancies, and of (I - A)^-1, the inverse of the mass matrix."""
        summed: list[list[tuple[Node, Expression]]] = [[] for _ in range(self.chains)]
        for k, (c, j) in enumerate(zip(chosen.chain.tolist(), chosen.term.tolist(), strict=True)):
            term = terms[j] if j < len(terms) else Expression(number(1))
            summed[c].append((Symbol(f"theta[{k}]"), term))
        return solved(summed, self.roles.targets)

    def targets_along(
        self, columns: Mapping[str, Floats], chosen: Candidates, theta: Floats, terms: Sequence[Expression]
    ) -> tuple[Floats, Floats]:
        """`solved` along a path, (n, C) and (n, C, C), evaluated with these columns of its variables."""
        free, inverted = self.solved(chosen, terms)
        values = {f"theta[{j}]": value for j, value in enumerate(theta.tolist())}
        evaluate = Evaluator({**columns, **values})
        shared = np.array([[evaluate(Expression(node)) for node in row] for row in inverted])
        return np.stack([evaluate(Expression(node)) for node in free], axis=1), np.moveaxis(shared, 2, 0).copy()

    def tape(self, chosen: Candidates) -> Tape:
        """Tape of rates of states (in maps next values), targets, terms; if implicit bare targets, (I - A)^-1 too."""
        key = chosen.chain.tobytes(), chosen.term.tobytes()
        if key not in self._tapes:
            self._tapes[key] = self._compiled(chosen)
        return self._tapes[key]

    @cached_property
    def _tapes(self) -> dict[tuple[bytes, bytes], Tape]:
        return {}

    def _compiled(self, chosen: Candidates) -> Tape:
        parameters = [f"theta[{j}]" for j in range(len(chosen.chain))]
        targets: list[Node] = [Symbol(f"d[{c}]") for c in range(self.chains)]
        terms: list[Node] = [self.blurred[j].tree if j < len(self.terms) else number(1) for j in chosen.term]
        further: list[Node] = []
        if self.implicit:
            free, inverted = self.solved(chosen, self.blurred)
            targets = [Binary("+", one, d) for one, d in zip(free, targets, strict=True)]
            values: dict[Node, Node] = dict(zip(map(Symbol, self.roles.targets), free, strict=True))
            terms = [replaced(term, values) for term in terms]
            further = [*free, *(entry for row in inverted for entry in row)]
        else:
            for name, c, term in zip(parameters, chosen.chain, terms, strict=True):
                targets[c] = Binary("+", targets[c], Binary("*", Symbol(name), term))
        out: list[Node] = []
        for chain, factors, target in zip(self.roles.chains, self.rates, targets, strict=True):
            for factor, node in zip(factors, [*map(Symbol, chain.states[1:]), target][: chain.order], strict=True):
                out.append(node if factor == 1.0 else Binary("*", number(factor), node))
        out += [Number(0)] * (self.before_inputs - self.motion)
        for name, width in zip(self.roles.inputs, self.widths, strict=True):
            out += [*map(Symbol, input_states(name, width)), Number(0)]
        return Tape.compile(
            map(Expression, [*out, *targets, *terms, *further]),
            [*self.names, *self.given, *self.jump_widths, *parameters],
        )

    @cached_property
    def rising(self) -> Bools:
        """Whether the rate of a state is the next state, (S,): for inputs and all but their highest derivatives."""
        out = np.zeros(self.size, dtype=np.bool_)
        for first, slope in zip(self.driven, self.slope, strict=True):
            out[first:slope] = True
        return out

    @cached_property
    def straight(self) -> Ints:
        """How each state goes between samples, (S,), see `bayeq.likelihood.steps.Steps`."""
        out = np.full(self.size, SMOOTH, dtype=np.int64)
        out[self.driven] = [{"smooth": SMOOTH, "hold": HELD}.get(course, STRAIGHT) for course in self.courses]
        return out

    @cached_property
    def terms_tape(self) -> Tape:
        """Tape of the candidate terms and the constant in states, t, widths of jumps, and targets if implicit."""
        trees: Sequence[Node] = [*(term.tree for term in self.blurred), Number(1)]
        further = self.roles.targets if self.implicit else ()
        return Tape.compile(map(Expression, trees), [*self.names, *self.given, *self.jump_widths, *further])
