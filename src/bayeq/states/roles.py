"""Which channel plays which part: kinematic chains, each a coordinate and its time derivatives, and inputs."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from bayeq.errors import ChainError, InputError, require_text, require_texts
from bayeq.expressions import Expression, number
from bayeq.expressions.functions import TIME
from bayeq.expressions.implicit import product, total
from bayeq.expressions.parse import EARLIER, MOST_EARLIER
from bayeq.records.names import channel_name

MAX_ORDER = 4

# Longest name of a channel [characters], like that of a term.
LONGEST = 1000

# Prefix of the target of a static law.
STATIC = "="

# Suffix of the name of a channel for its next sample, the target of a map.
NEXT = "[+1]"

_MAP = re.compile(r"(?:~\w+\[-\d+\]:)*(?P<name>\w+):~\w+\[\+1\]")

# Name of a coordinate that is not measured; where that name is taken, with the first measured channel: x_a1, x_a2.
COORDINATE = "x"


@dataclass(frozen=True, slots=True)
class Chain:
    """A coordinate and its derivatives up to `order`.

    Examples
    --------
    >>> chain = parse_chain("x:v:")
    >>> chain.order, chain.names, chain.target, chain.states
    (2, ('x', 'v', 'ddx'), 'ddx', ('x', 'v'))
    >>> parse_chain("x").names
    ('x', 'dx')
    >>> parse_chain("::a").names
    ('x', 'dx', 'a')
    >>> parse_chain("x:~v:~a").names, parse_chain("~q::a").names
    (('x', 'v', 'a'), ('q', 'dq', 'a'))

    The target of a static law, which is no derivative, is a chain of order 0:

    >>> parse_chain("=F").order, parse_chain("=F").target, parse_chain("=F").states
    (0, 'F', ())

    For a map, whose equation gives the next sample, earlier samples of the channel take the place of derivatives:

    >>> chain_of_map("x", 1).names, str(chain_of_map("x", 1))
    (('x[-1]', 'x', 'x[+1]'), '~x[-1]:x:~x[+1]')
    """

    measured: tuple[str | None, ...]  # the channel that measures each derivative, from order 0 up; None where none does
    called: tuple[str | None, ...] = ()  # given names of derivatives that are not measured, None without one
    law: Expression | None = None  # rate of a hidden state, with constants that may be unknown
    found: bool = False  # whether the law was found from the terms of a dictionary, and not stated

    def with_law(self, law: Expression) -> Chain:
        """The chain with another law."""
        return replace(self, law=law)

    def with_found(self, parts: Iterable[tuple[float, Expression]]) -> Chain:
        """The chain of a hidden state with the law that was found, from pairs of coefficient and term."""
        law = Expression(total([product(number(factor), term.tree) for factor, term in parts]))
        return replace(self, law=law, found=True)

    @property
    def stated(self) -> bool:
        """Whether all of the law was given."""
        return self.law is not None and not self.found

    @property
    def hidden(self) -> bool:
        """Whether no channel measures the state or its rate."""
        return not any(self.measured)

    @property
    def order(self) -> int:
        """Order of the highest derivative, which the equation gives."""
        return len(self.measured) - 1

    @property
    def static(self) -> bool:
        """Whether the equation is a static law: its target is measured, and no derivative of anything."""
        return self.order == 0

    @property
    def discrete(self) -> bool:
        """Whether the equation is a map: its target is the next sample."""
        return self.target.endswith(NEXT)

    @property
    def lowest(self) -> int:
        """Order of the lowest measured derivative; 0 for a hidden state."""
        return next((k for k, name in enumerate(self.measured) if name is not None), 0)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the derivatives: that of the channel, the given one, or else x, ``dx``, ``ddx`` ..."""
        base = self.own_name(0) or COORDINATE
        return tuple(self.own_name(k) or "d" * k + base for k in range(len(self.measured)))

    def own_name(self, k: int) -> str | None:
        """Name of derivative k by its channel, or as given; None if it is made from the coordinate's name."""
        return self.measured[k] or (self.called[k] if self.called else None)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all derivatives but the highest."""
        return self.names[:-1]

    @property
    def target(self) -> str:
        """Name of the highest derivative."""
        return self.names[-1]

    def __str__(self) -> str:
        if self.static:
            return f"{STATIC}{self.measured[0]}"
        if self.hidden:
            return f"~{self.called[0]}{':' * self.order}"
        if self.order == 1 and self.measured[1] is None and not self.discrete:
            return str(self.measured[0])
        return ":".join(m or (f"~{self.own_name(k)}" if self.own_name(k) else "") for k, m in enumerate(self.measured))


def chain_of_map(name: str, earlier: int) -> Chain:
    """The chain of a channel whose equation gives the next sample, with some earlier ones as states."""
    back = [f"{name}[-{k}]" for k in range(earlier, 0, -1)]
    return Chain((*[None] * earlier, name, None), (*back, None, f"{name}{NEXT}"))


def parse_chain(text: str) -> Chain:
    """Read a chain such as ``x:v:a``, ``x::`` (only displacement measured), ``::a`` (only acceleration), ``x`` or
    ``x:xdot`` (first order).

    ``x:~v:~a`` is ``x::`` with names for what is not measured, instead of dx and ddx; ``~q::a`` is ``::a`` with the
    coordinate q instead of x. ``=F`` is the target of a static law. A ChainError refuses what is not of this form.
    """
    form = (
        "write it as x:v:a (second order), x:: (only x measured; x:~v:~a to name what is estimated), ::a (only a), x"
        " (first order) or x:xdot"
    )
    if found := _MAP.fullmatch(text.strip()):
        chain = chain_of_map(found["name"], min(text.count("[-"), MOST_EARLIER))
        if str(chain) == text.strip():
            return chain
    static = text.strip().startswith(STATIC)
    parts = [_named(part) for part in text.strip().removeprefix(STATIC).split(":")]
    if static and (len(parts) > 1 or parts[0][:1] in ("", "~")):
        raise ChainError(f"chain {text[:60]!r}: a static law has one measured target, as in =F")
    if len(parts) == 1 and not static:
        parts.append("")
    if len(parts) - 1 > MAX_ORDER:
        raise ChainError(f"chain {text[:60]!r} has order {len(parts) - 1}; at most {MAX_ORDER} is allowed; {form}")
    if not any(parts):
        raise ChainError(f"chain {text[:60]!r} names no channel; {form}")
    if len(parts) > 3 and not parts[-1]:
        raise ChainError(f"chain {text[:60]!r} has a colon too many; a law of order {len(parts) - 1} is x:v:a:~j")
    for part in parts:
        reserved = keyword.iskeyword(name := part.removeprefix("~"))
        if reserved or len(part) > LONGEST:
            remedy = f" (a column {name} is called {name}_)" if reserved else ""
            raise ChainError(f"chain {text[:60]!r}: {part[:40]!r} is not a channel name{remedy}; {form}")
    named = [part.removeprefix("~") for part in parts if part]
    if len(set(named)) < len(named):
        raise ChainError(f"chain {text[:60]!r} names a channel twice; {form}")
    measured = tuple(part if part and not part.startswith("~") else None for part in parts)
    if not any(measured) and (not 1 < len(parts) < 4 or any(parts[1:])):
        raise ChainError(f"chain {text[:60]!r} has no measured channel; {form}")
    called = tuple(part[1:] if part.startswith("~") else None for part in parts)
    chain = Chain(measured, called if any(called) else ())
    if COORDINATE in measured[1:]:
        chain = _named_by_channel(chain)
    if len(set(chain.names)) < len(chain.names):
        raise ChainError(
            f"chain {text[:60]!r}: derivatives that are not measured are called after the coordinate,"
            f" {', '.join(chain.names)}: rename the channel of that name"
        )
    return chain


def _named(part: str) -> str:
    """The name in a part of a chain, which may be a channel's header, with the ``~`` of one that is not measured."""
    mark = "~" if part.strip().startswith("~") else ""
    return mark + channel_name(part.strip().removeprefix("~"))


def parse_chains(texts: Sequence[str], inputs: Sequence[str] = ()) -> tuple[Chain, ...]:
    """Read several chains and check that no name occurs in two of them.

    A coordinate that is not measured is called x. Where two chains, or a chain and another channel, would share that
    name, such coordinates are called after the lowest measured channel of their chain. A ChainError refuses no chains,
    one that cannot be read, and a name that occurs twice.

    Examples
    --------
    >>> [chain.names for chain in parse_chains(["::a1", "::a2"])]
    [('x_a1', 'dx_a1', 'a1'), ('x_a2', 'dx_a2', 'a2')]
    """
    if not texts:
        raise ChainError("no chain given: name the coordinate and its measured derivatives, as in x:v:a")
    chains = [parse_chain(text) for text in texts]
    if sum(COORDINATE in chain.names for chain in chains) + (COORDINATE in inputs) > 1:
        chains = [_named_by_channel(chain) for chain in chains]
    seen: dict[str, Chain] = {}
    for chain in chains:
        for name in chain.names:
            if name in seen:
                where = f" and in chain {str(chain)!r}" if str(chain) != str(seen[name]) else " twice: leave one out"
                raise ChainError(f"{name!r} occurs in chain {str(seen[name])!r}{where}")
            seen[name] = chain
    return tuple(chains)


def _named_by_channel(chain: Chain) -> Chain:
    """The chain with a coordinate named after the lowest measured channel, unless it has a name."""
    if chain.own_name(0) is not None:
        return chain
    others = chain.called[1:] or (None,) * chain.order
    return Chain(chain.measured, (f"{COORDINATE}_{chain.measured[chain.lowest]}", *others))


@dataclass(frozen=True, slots=True)
class Roles:
    """Chains and inputs of a system.

    Examples
    --------
    >>> roles = Roles.parse(displacement="x", velocity="v", acceleration="a", force="u")
    >>> roles.targets, roles.states, roles.inputs
    (('a',), ('x', 'v'), ('u',))
    """

    chains: tuple[Chain, ...]  # one per equation
    inputs: tuple[str, ...] = ()  # channels of forces and other inputs
    timed: bool = False  # whether terms may use t, the time [s]

    @classmethod
    def parse(
        cls,
        chains: str | Sequence[str] | None = None,
        displacement: str | None = None,
        velocity: str | None = None,
        acceleration: str | None = None,
        force: str | None = None,
        inputs: Sequence[str] = (),
        target: str | Sequence[str] | None = None,
        discrete: bool = False,
    ) -> Roles:
        """Read the roles as a user writes them; where they are `discrete` each chain is a channel of a map.

        A ChainError refuses no coordinate or target, chains beside single channels, and text that is not a chain; an
        InputError an input that is named twice.
        """
        single = {"displacement": displacement, "velocity": velocity, "acceleration": acceleration}
        for role, channel in (*single.items(), ("force", force)):
            require_text(channel, role, optional=True)
        require_texts(inputs, "inputs")
        if chains is not None:
            require_texts(chains, "chains")
        inputs = [inputs] if isinstance(inputs, str) else inputs
        listed = ([] if force is None else [force]) + list(inputs)
        named = tuple(name if EARLIER.fullmatch(name) else channel_name(name) for name in listed)
        if len(set(named)) < len(named):
            raise InputError(f"an input is named twice: {', '.join(named)}")
        static = _static(target, named)
        if chains is None and (any(name is not None for name in single.values()) or not static):
            chains = _oscillator(single)
        elif any(single.values()):
            raise ChainError("give either chains or displacement, velocity and acceleration, not both")
        parsed = parse_chains([*([chains] if isinstance(chains, str) else chains or ()), *static], named)
        if not named and all(chain.static for chain in parsed):
            raise ChainError(
                f"{parsed[0].target!r} is to follow from nothing: name the channels that it is a function of (inputs=,"
                " --input)"
            )
        roles = cls(parsed, named)
        for name in named:
            if name in roles.measured:
                raise ChainError(f"channel {name!r} is both an input and part of a chain")
        if not discrete:
            return roles
        for chain in parsed:
            if chain.order != 1 or chain.measured[1] is not None or chain.called:
                raise ChainError(
                    f"chain {str(chain)!r}: a map is of single channels, each a chain: --chain x, chains='x'"
                )
        return roles.with_chains([chain_of_map(str(chain.measured[0]), 0) for chain in parsed])

    @property
    def discrete(self) -> bool:
        """Whether the equations are maps."""
        return any(chain.discrete for chain in self.chains)

    @property
    def hidden(self) -> tuple[Chain, ...]:
        """Chains that no channel measures, which stand last."""
        return tuple(chain for chain in self.chains if chain.hidden)

    @property
    def seen(self) -> Roles:
        """The roles without hidden states."""
        return self.with_chains([chain for chain in self.chains if not chain.hidden])

    @property
    def targets(self) -> tuple[str, ...]:
        """The highest derivative of each chain."""
        return tuple(chain.target for chain in self.chains)

    @property
    def sought(self) -> tuple[str, ...]:
        """Targets of the equations that are not stated, which stand first."""
        return tuple(chain.target for chain in self.chains if not chain.stated)

    @property
    def states(self) -> tuple[str, ...]:
        """All other derivatives, chain by chain."""
        return tuple(name for chain in self.chains for name in chain.states)

    @property
    def measured(self) -> tuple[str, ...]:
        """Measured channels of the chains."""
        return tuple(name for chain in self.chains for name in chain.measured if name is not None)

    @property
    def compared(self) -> tuple[str, ...]:
        """Channels of chains with more than one channel: the factors of these can be estimated from each other."""
        chains = ([name for name in chain.measured if name is not None] for chain in self.chains)
        return tuple(name for names in chains if len(names) > 1 for name in names)

    @property
    def channels(self) -> tuple[str, ...]:
        """All channels: those of the chains, then the inputs."""
        return (*self.measured, *self.inputs)

    @property
    def names(self) -> tuple[str, ...]:
        """All channels and derivatives."""
        return (*self.states, *self.targets, *self.inputs)

    @property
    def variables(self) -> tuple[str, ...]:
        """Arguments of the laws: the states, or the inputs where there are only static laws."""
        return self.states or self.inputs

    @property
    def drivers(self) -> tuple[str, ...]:
        """Variables of terms other than the states: the inputs, and t where terms use it."""
        return (*self.inputs, TIME) if self.timed else self.inputs

    def for_terms(self, terms: Iterable[Expression]) -> Roles:
        """The roles with t, the time, as a variable if terms use it, unless a channel has that name.

        Roles of maps also get the earlier samples that terms use. An InputError refuses a map with the time, or with
        samples that are too early.
        """
        names = {name for term in terms for name in term.names}
        timed = TIME not in self.names and TIME in names
        if not self.discrete:
            return replace(self, timed=timed)
        if timed:
            raise InputError("a term uses t, the time: a map has none; give a channel of row numbers as an input")
        back = {name: int(found["back"]) for name in names if (found := EARLIER.fullmatch(name))}
        late = next((name for name, k in back.items() if k > MOST_EARLIER), None)
        if late is not None:
            raise InputError(f"{late} is too early: a map has at most {MOST_EARLIER} earlier samples")
        chains = []
        for chain in self.chains:
            name = str(chain.measured[-2])
            own = [k for text, k in back.items() if text.partition("[")[0] == name]
            chains.append(chain_of_map(name, max([chain.order - 1, *own])))
        given = {*self.inputs, *(name for chain in chains for name in chain.states)}
        inputs = [name for name in sorted(back) if name not in given]
        return replace(self, chains=tuple(chains), inputs=(*self.inputs, *inputs))

    def with_chains(self, chains: Sequence[Chain]) -> Roles:
        """The same inputs with other chains."""
        return replace(self, chains=tuple(chains))


def _static(target: str | Sequence[str] | None, inputs: Sequence[str]) -> list[str]:
    """Chains of static laws, one for each target; a text may give several targets, divided by commas."""
    if target is None:
        return []
    require_texts(target, "target")
    texts = target.split(",") if isinstance(target, str) else target
    names = [channel_name(text.strip()) for text in texts]
    for name in names:
        if not name:
            raise ChainError("target '' is not a channel's name; name what the law gives, as in target='F'")
        if name in inputs:
            raise ChainError(f"channel {name!r} is both a target and an input; leave it out of the inputs")
    return [f"{STATIC}{name}" for name in names]


def _oscillator(single: Mapping[str, str | None]) -> str:
    """The chain of one second-order coordinate from the names of its channels."""
    if all(channel is None for channel in single.values()):
        raise ChainError(
            "no coordinate given: name the displacement (and, where measured, velocity and acceleration), or a chain"
            " such as x:v:a"
        )
    for role, channel in single.items():
        if channel is not None and (not channel.strip() or ":" in channel):
            raise ChainError(
                f"{role} {channel[:60]!r} is not a channel's name; name one, or give a chain such as x:v:a instead"
            )
    return ":".join(name or "" for name in single.values())
