"""Which channel plays which part: the kinematic chains and the inputs of a system."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from bayeq.errors import ChainError, InputError, require_text, require_texts
from bayeq.expressions import Expression
from bayeq.expressions.functions import TIME
from bayeq.states.chain import Chain, parse_chains

__all__ = ["Roles"]


@dataclass(frozen=True, slots=True)
class Roles:
    """Chains and inputs of a system.

    Parameters
    ----------
    chains : tuple of Chain
        One per equation.
    inputs : tuple of str
        Channels of forces and other inputs.
    timed : bool
        Whether terms may use t, the time [s].

    Examples
    --------
    >>> roles = Roles.parse(displacement="x", velocity="v", acceleration="a", force="u")
    >>> roles.targets, roles.states, roles.inputs
    (('a',), ('x', 'v'), ('u',))
    """

    chains: tuple[Chain, ...]
    inputs: tuple[str, ...] = ()
    timed: bool = False

    @classmethod
    def parse(
        cls,
        chains: str | Sequence[str] | None = None,
        displacement: str | None = None,
        velocity: str | None = None,
        acceleration: str | None = None,
        force: str | None = None,
        inputs: Sequence[str] = (),
    ) -> Roles:
        """Read the roles as a user writes them.

        Raises
        ------
        ChainError
            No coordinate, chains beside single channels, or text that is not a chain.
        InputError
            An input that is named twice.
        """
        for role, channel in (("displacement", displacement), ("velocity", velocity), ("acceleration", acceleration)):
            require_text(channel, role, optional=True)
        require_text(force, "force", optional=True)
        require_texts(inputs, "inputs")
        if chains is not None:
            require_texts(chains, "chains")
        inputs = [inputs] if isinstance(inputs, str) else inputs
        named = ((force,) if force is not None else ()) + tuple(inputs)
        if len(set(named)) < len(named):
            raise InputError(f"an input is named twice: {', '.join(named)}")
        if chains is None:
            parsed = _oscillator(displacement, velocity, acceleration, named)
        elif displacement or velocity or acceleration:
            raise ChainError("give either chains or displacement, velocity and acceleration, not both")
        else:
            parsed = parse_chains([chains] if isinstance(chains, str) else list(chains), named)
        roles = cls(parsed, named)
        for name in named:
            if name in roles.measured:
                raise ChainError(f"channel {name!r} is both an input and part of a chain")
        return roles

    @property
    def targets(self) -> tuple[str, ...]:
        """The highest derivative of each chain."""
        return tuple(chain.target for chain in self.chains)

    @property
    def states(self) -> tuple[str, ...]:
        """All other derivatives, chain by chain."""
        return tuple(name for chain in self.chains for name in chain.states)

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels of the chains."""
        return tuple(name for chain in self.chains for name in chain.measured if name is not None)

    @property
    def channels(self) -> tuple[str, ...]:
        """All channels: those of the chains, then the inputs."""
        return (*self.measured, *self.inputs)

    @property
    def names(self) -> tuple[str, ...]:
        """All channels and derivatives."""
        return (*self.states, *self.targets, *self.inputs)

    @property
    def drivers(self) -> tuple[str, ...]:
        """What terms may use beside the states: the inputs, and t where it is used."""
        return (*self.inputs, TIME) if self.timed else self.inputs

    def for_terms(self, terms: Iterable[Expression]) -> Roles:
        """The same with the time as a variable where terms use it, unless a channel has its name."""
        return replace(self, timed=TIME not in self.names and any(TIME in term.names for term in terms))

    def with_chains(self, chains: Sequence[Chain]) -> Roles:
        """The same inputs with other chains."""
        return replace(self, chains=tuple(chains))


def _oscillator(
    displacement: str | None, velocity: str | None, acceleration: str | None, inputs: Sequence[str]
) -> tuple[Chain, ...]:
    """The chain of one second-order coordinate from the names of its channels."""
    if displacement is None and acceleration is None:
        raise ChainError(
            "no coordinate given: name the displacement (and, where measured, velocity and acceleration), or a chain"
            " such as x:v:a"
        )
    for role, channel in (("displacement", displacement), ("velocity", velocity), ("acceleration", acceleration)):
        if channel is not None and (not channel.strip() or ":" in channel):
            raise ChainError(
                f"{role} {channel[:60]!r} is not a channel's name; name one, or give a chain such as x:v:a instead"
            )
    return parse_chains([":".join(name or "" for name in (displacement, velocity, acceleration))], inputs)
