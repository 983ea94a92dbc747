"""States: from measured channels to coordinates and their derivatives."""

from bayeq.states.chain import Chain, parse_chain, parse_chains
from bayeq.states.derive import FEW_ROWS, Smooth, States, derive_all, derive_states
from bayeq.states.derived_channels import measured_apart
from bayeq.states.kinematic.chain_smoother import ChainSmoothing

__all__ = [
    "FEW_ROWS",
    "Chain",
    "ChainSmoothing",
    "Smooth",
    "States",
    "derive_all",
    "derive_states",
    "measured_apart",
    "parse_chain",
    "parse_chains",
]
