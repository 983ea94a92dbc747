"""States: from measured channels to coordinates and their derivatives."""

from bayeq.states.chain import Chain, parse_chain, parse_chains
from bayeq.states.derive import Smooth, States, derive_states

__all__ = ["Chain", "Smooth", "States", "derive_states", "parse_chain", "parse_chains"]
