"""Reserve inside the comfort bound for what a plan cannot see in a fast zone.

A plan knows the zone at the ends of its steps. In a zone that an hour at full level moves by more than 0.6 K, on/off
blocks let it swing in between, the model's error of the next hour is felt at once, and a coarse sensor hides both.
"""

from __future__ import annotations

import math

from controllers.actuation.actuator import Actuation
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Effect of an hour at full level from which a zone is fast, K: a slab gives a few tenths, radiators and air several.
_FAST_K = 0.6
# Mean share of on-time that is assumed for the swing.
_SHARE = 0.35
# Share of the held-out error one hour ahead: half of it is felt below the bound.
_ERROR_SHARE = 0.5
# Most that is reserved, K: what a thermostat keeps above its bound. Beyond, comfort costs more than a thermostat's.
_MOST_K = 0.3


def is_fast(operator: OperatorParameters) -> bool:
    """Whether an hour at full level moves the zone by more than 0.6 K."""
    return _hour_K(operator) > _FAST_K


def _hour_K(operator: OperatorParameters) -> float:
    """Effect of an hour at full level, K (of one step, if that is longer)."""
    steps = max(1, round(HOUR_S / operator.step_s))
    return abs(float(operator.impulse(steps).sum())) * min(1.0, HOUR_S / operator.step_s)


def reserve_K(operator: OperatorParameters, actuation: Actuation, card: ModelCard) -> float:
    """Reserve inside the bound that actuation protects, K.

    The standard deviation of the sensor's rounding; in a fast zone also half the swing of on/off blocks and half the
    held-out error of the next hour.
    """
    rounding_K = card.uncertainty.get("sensor_resolution_K", 0.0) / math.sqrt(12.0)
    if not is_fast(operator):
        return min(rounding_K, _MOST_K)
    verdict = card.competence
    errors = [score.model_K for score in verdict.horizons if score.hours == 1.0] if verdict else []
    found = _swing_K(operator, actuation) + _ERROR_SHARE * sum(errors) + rounding_K
    return min(found, _MOST_K) if math.isfinite(found) else _MOST_K


def _swing_K(operator: OperatorParameters, actuation: Actuation) -> float:
    """Half the swing of the zone under on/off blocks, K: on and off for as long as the minimum times ask."""
    if actuation.modulates:
        return 0.0
    c, step_s = actuation.config, operator.step_s
    cycle_s = max(2 * c.block_s, c.min_on_s / _SHARE, c.min_off_s / (1.0 - _SHARE))
    return 0.5 * abs(float(operator.impulse(1)[0])) * _SHARE * (1.0 - _SHARE) * cycle_s / step_s
