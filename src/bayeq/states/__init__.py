"""States: from measured channels to coordinates and their derivatives."""

from bayeq.states.derive import Smooth, derive_states, require_in_range, require_steps, require_varying
from bayeq.states.hidden import with_laws
from bayeq.states.kinematic.chain_smoother import ChainSmoothing
from bayeq.states.motion import (
    Motion,
    MotionRows,
    estimate_motion,
    measured_apart,
    with_columns,
    with_hidden,
    with_paths,
)
from bayeq.states.prepare import corrected
from bayeq.states.roles import Chain, Roles, parse_chain, parse_chains
from bayeq.states.sensors import (
    Gain,
    Lag,
    Sensors,
    Tails,
    check_sensors,
    force_of_blows,
    known_sensors,
    rates,
    unit_gains,
)

__all__ = [
    "Chain", "ChainSmoothing", "Gain", "Lag", "Motion", "MotionRows", "Roles", "Sensors", "Smooth", "Tails",
    "check_sensors", "corrected", "derive_states", "estimate_motion", "force_of_blows", "known_sensors",
    "measured_apart", "parse_chain", "parse_chains", "rates", "require_in_range", "require_steps", "require_varying",
    "unit_gains", "with_columns", "with_hidden", "with_laws", "with_paths",
]  # fmt: skip
