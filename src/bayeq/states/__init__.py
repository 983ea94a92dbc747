"""States: from measured channels to coordinates and their derivatives."""

from bayeq.states.derive import Smooth
from bayeq.states.hidden import with_laws
from bayeq.states.kinematic.chain_smoother import ChainSmoothing
from bayeq.states.motion import Motion, MotionRows, estimate_motion, measured_apart
from bayeq.states.prepare import corrected
from bayeq.states.roles import Chain, Roles, parse_chain, parse_chains
from bayeq.states.sensors import Gain, Lag, Sensors, Tails, check_sensors, force_of_blows, known_sensors, rates

__all__ = [
    "Chain", "ChainSmoothing", "Gain", "Lag", "Motion", "MotionRows", "Roles", "Sensors", "Smooth", "Tails",
    "check_sensors", "corrected", "estimate_motion", "force_of_blows", "known_sensors", "measured_apart",
    "parse_chain", "parse_chains", "rates", "with_laws",
]  # fmt: skip
