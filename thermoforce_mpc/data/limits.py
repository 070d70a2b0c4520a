"""Plausibility limits of readings and limits of gaps between them, with their reasons; `RULES` has those of a signal.

The ranges are wide: they reject faults (a broken wire, a lost decimal point, K read as °C), not unusual readings.
Values outside are treated as not measured; nothing is clipped. Tables (`measurements.readings`) and running controllers
(`model.screening`, `controllers.monitoring`) ask the same three questions of a reading:

| question | answered by |
|---|---|
| may it be so high or low? | `outside` |
| may it have come there so fast? | `jumps`: too far from the last one believed, or out and back within hours |
| does it live? | `frozen`: unchanged for too long; `SignalRule.is_frozen`: or unchanged while what it follows moved |
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data.clock import DAY_S, HOUR_S, Array

SENSOR_STEP_K = 0.1
"""What zone sensors tell apart, K: thermostats and Home Assistant's records show tenths of a degree. No promise about a
reading is held to less."""

# Tolerance of levels outside [0, 1], from rounding of step means and solver solutions.
ROUNDING = 1e-6
LEVEL = (-ROUNDING, 1.0 + ROUNDING)
"""Actuation u, dimensionless."""

ZONE_C = (-30.0, 60.0)
"""Zone temperature, °C: from an unheated building in winter to a closed one in the sun; a lost wire is far outside."""

EFFECT_K = 300.0
"""Change of a zone by 8 h at full level, K, either way: 500 W/m² in a room that loses 2 W/(m²·K) lead to 250 K at
last. What goes further is a fault of the numbers, not a strong machine."""

ZONE_JUMP_K, ZONE_JUMP_K_PER_H = 15.0, 5.0
"""Largest change of the zone temperature since its last accepted reading, K plus K/h. In BOPTEST's `bestest_air`,
probed between off and full, the air changed by up to 11.7 K in 15 min. Since the limit grows with time, a sensor that
was moved or calibrated is accepted again within hours."""

OUTDOOR_C = (-60.0, 60.0)
"""Outdoor temperature, °C. The highest recorded is 56.7 °C (WMO, Death Valley 1913); no machine works below −60 °C."""

SOLAR_W_M2 = (-30.0, 1500.0)
"""Global horizontal irradiance, W/m². At night a pyranometer reads below zero, by up to 30 W/m² (ISO 9060:2018, class
C). Broken cloud exceeds the clear-sky 1100 W/m² for minutes; means over a step above 1500 have not been observed."""

RETURN_WATER_C = (-30.0, 150.0)
"""Return water of the emitters, °C: from brine to pressurised hot water."""

LOAD_RANGE = (-1.0, 3.0)
"""Heat, in the direction of the machine, in multiples of the identified model's largest heat: with a back-up heater and
an error of the fit above, and at most the machine's own heat reversed, in defrosting, below."""

POWER_RANGE = (-0.05, 3.0)
"""Electric power in multiples of the identified model's largest power. Below zero only meter noise."""

LOAD_W_PER_M2 = 500.0
"""Heat or power per floor area without a model, W/m²: design loads are about 100 to 200 W/m² in old buildings, and an
oversized machine has twice that."""

BRIDGED_GAP_H = 6.0
"""Longest weather gap filled by linear interpolation, h. Over a quarter of a daily wave the error is at most
1 − cos 45° = 29 % of the amplitude, over half a day all of it."""

BRIDGED_LEVEL_H = 2.0
"""Longest gap in u filled by linear interpolation, h: about as long as a thermostat or a probing holds a level."""

LEVELS_AROUND_H = 12.0
"""Time on either side of a longer gap in u over which known levels are averaged to fill it, h: a whole day in total, so
that the mean heat is about right for any schedule."""


@dataclass(frozen=True)
class SignalRule:
    """What a reading of one signal may be, in its `unit`: the same for tables and for a running controller.

    Attributes:
        kind: what it is, for units that may be taken for one another.
        unit: inside.
        range: possible values; what is outside is not measured.
        usual: of a median or, of levels, a maximum; outside a wrong unit is likely.
        spike: change from one reading to the next that is none if it comes back within 6 h, and at least `times_usual`
            the 97th percentile of changes: air that is heated and cooled at full power moves by 10 K in a step.
        jump: change since the last accepted reading that is possible, and what comes to it in an hour.
        expected: distance from its prediction within which a reading is always believed, where there is a model.
        stuck_h: time after which an unchanging reading is stuck where nothing is known of what it follows, h; 0: never.
        frozen_h: the same where what it follows has moved by `moved` meanwhile: a forecast, a level, or the zone by the
            model; 0: never.
        always: whether every building reports it, so that a missing one is said.
    """

    kind: str
    unit: str
    range: tuple[float, float] = (-math.inf, math.inf)
    usual: tuple[float, float] = (-math.inf, math.inf)
    spike: float = math.inf
    times_usual: float = 3.0
    jump: tuple[float, float] = (math.inf, 0.0)
    expected: float = math.inf
    stuck_h: float = 0.0
    frozen_h: float = 0.0
    moved: float = math.inf
    always: bool = False

    def reach(self, since_s: float) -> float:
        """Largest plausible change over `since_s` s, in the unit."""
        at_once, per_h = self.jump
        return at_once + per_h * since_s / HOUR_S

    @property
    def in_words(self) -> str:
        """What a jump is."""
        return f"more than {min(self.spike, self.reach(0.0)):g} {self.unit} from those before and after"

    def is_frozen(self, hours: float, moved: float = math.nan, frozen_h: float | None = None) -> bool:
        """Whether a reading that has been the same for `hours` is no longer one.

        `moved`: by how much what it follows has moved meanwhile; NaN: not known. `frozen_h`: in the place of its own.
        """
        if math.isnan(moved):
            return 0.0 < self.stuck_h < hours
        frozen_h = self.frozen_h if frozen_h is None else frozen_h
        return frozen_h > 0.0 and hours >= frozen_h - 1e-6 and moved >= self.moved


RULES = {
    "T_zone_C": SignalRule(
        "temperature", "°C", ZONE_C, (5.0, 40.0), spike=5.0, jump=(ZONE_JUMP_K, ZONE_JUMP_K_PER_H), expected=1.0,
        stuck_h=48.0, frozen_h=1.0, always=True,
    ),
    "T_out_C": SignalRule(
        "temperature", "°C", OUTDOOR_C, (-30.0, 45.0), spike=10.0, stuck_h=24.0, frozen_h=3.0, moved=2.0, always=True
    ),
    # Nights of 18 h and more read the zero offset of the sensor, so below that a day and more must be alike.
    "solar_W_m2": SignalRule(
        "irradiance", "W/m²", SOLAR_W_M2, (0.0, 1200.0), stuck_h=6.0, frozen_h=3.0, moved=100.0, always=True
    ),
    "u": SignalRule("level", "", LEVEL, (0.05, 1.0)),
    "power_W": SignalRule("power", "W", frozen_h=3.0, moved=0.25),  # of full level
    "heat_W": SignalRule("power", "W", frozen_h=3.0, moved=0.25),
    "T_return_C": SignalRule("temperature", "°C", RETURN_WATER_C, (5.0, 90.0)),
}  # fmt: skip
"""By the name of the signal in a `Record`. Ranges of power and heat are those of the machine (`model/screening.py`)."""

# Power that a meter of a building can tell, W: what a map may say of one.
POWER_W = (-1e9, 1e9)
# Longest excursion that is a spike, s; whoever moved a sensor and left it there meant it.
EXCURSION_S = 6 * HOUR_S
# Largest zero offset of a pyranometer, W/m² (ISO 9060:2018, class C), and what is no reading but the dark itself.
_ZERO_OFFSET_W_M2, _DARK_W_M2 = 30.0, 1.0
# Changes between readings of which one that is a spike is no usual one, in percent.
_USUAL_CHANGES = 97.0


@overload
def outside(values: float, allowed: tuple[float, float]) -> bool: ...


@overload
def outside(values: Array, allowed: tuple[float, float]) -> NDArray[np.bool_]: ...


def outside(values: float | Array, allowed: tuple[float, float]) -> bool | NDArray[np.bool_]:
    """Which values are infinite or outside the range; NaN is not."""
    low, high = allowed
    return (values < low) | (values > high) | (abs(values) == math.inf)


def jumps(time_s: Array, values: Array, rule: SignalRule) -> NDArray[np.bool_]:
    """Which readings (n,) came too far too fast: out and back within 6 h, or far from the last believed; NaN is not."""
    wrong = np.zeros(values.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(values))
    changes = np.abs(np.diff(values[known]))
    if not changes.size or not (changes > min(rule.spike, rule.reach(0.0))).any():
        return wrong
    most = max(rule.spike, rule.times_usual * float(np.percentile(changes, _USUAL_CHANGES)))
    wrong[known] = _excursions(time_s[known], values[known], most)
    known = known[~wrong[known]]
    at_s, believed = float(time_s[known[0]]), float(values[known[0]])
    for i in known:
        if abs(values[i] - believed) > rule.reach(float(time_s[i]) - at_s):
            wrong[i] = True
        else:
            at_s, believed = float(time_s[i]), float(values[i])
    return wrong


def frozen(time_s: Array, values: Array, rule: SignalRule) -> NDArray[np.bool_]:
    """Which readings (n,), finite, belong to a stretch of one value that lasts too long for a sensor that lives.

    The sun's sensor reads its zero offset in the dark, for a day at most.
    """
    if not rule.stuck_h > 0.0 or values.size < 2:
        return np.zeros(values.size, dtype=bool)
    most_s = rule.stuck_h * HOUR_S
    stuck = _unchanged(time_s, values, most_s)
    if rule.kind == "irradiance":
        dim = np.abs(values) <= _ZERO_OFFSET_W_M2
        stuck &= ~dim | _unchanged(time_s, values, max(most_s, DAY_S))
        stuck &= np.abs(values) > _DARK_W_M2
    return stuck


def _excursions(time_s: Array, values: Array, most: float) -> NDArray[np.bool_]:
    """Which readings (n,) lie between a jump of more than `most` and one back within 6 h."""
    away = np.zeros(values.size, dtype=bool)
    steps = np.diff(values)
    rows = np.flatnonzero(np.abs(steps) > most)
    k = 0
    while k + 1 < rows.size:
        out, back = int(rows[k]), int(rows[k + 1])
        returned = abs(values[back + 1] - values[out]) <= most and steps[out] * steps[back] < 0.0
        if returned and time_s[back + 1] - time_s[out] <= EXCURSION_S:
            away[out + 1 : back + 1] = True
            k += 1
        k += 1
    return away


def _unchanged(time_s: Array, values: Array, most_s: float) -> NDArray[np.bool_]:
    """Which readings (n,) belong to a stretch of one value that lasts longer than `most_s`."""
    # A gap that is long beside that tells nothing of what lies in it.
    changes = (np.diff(values) != 0.0) | (np.diff(time_s) > 0.25 * most_s)
    begins = np.concatenate([[0], np.flatnonzero(changes) + 1])
    ends = np.concatenate([begins[1:] - 1, [values.size - 1]])
    return np.repeat((time_s[ends] - time_s[begins]) > most_s, ends - begins + 1)


# What stands for "no reading": 85 and -127 of a DS18B20, nines, the limits of 16 bits, also in tenths and hundredths.
_CODES = np.array(
    [85.0, -127.0, -99.0, -99.9, -999.0, -999.9, -9999.0, 999.0, 9999.0, 99999.0]
    + [limit * part for limit in (-32768.0, 32767.0, 65535.0) for part in (1.0, 0.1, 0.01)]
)
_LARGEST = 1e30


def codes_of_none(values: Array) -> NDArray[np.bool_]:
    """Which values (n,) are what a sensor or logger writes where it has none: few, far from all others."""
    coded = np.isin(np.round(values, 2), np.round(_CODES, 2)) | (np.abs(values) > _LARGEST)
    others = np.unique(values[~coded])
    if not coded.any() or coded.mean() > 0.5 or others.size < 3:  # a valve that is shut, or open by 85 %
        return np.zeros(values.size, dtype=bool)
    low, high = others[0], others[-1]
    far = 0.5 * (high - low)
    return coded & ((values < low - far) | (values > high + far))
