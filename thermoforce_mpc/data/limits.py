"""Plausibility limits of readings and limits of gaps between them, with their reasons; `RULES` has those of a signal.

The ranges are wide: they reject faults (a broken wire, a lost decimal point, K read as °C), not unusual readings.
Values outside are treated as not measured; nothing is clipped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
        spike: change from one reading to the next that is none if it comes back within hours (tables).
        jump: change since the last accepted reading that is possible, and what comes to it in an hour (running).
        expected: distance from its prediction within which a reading is always believed (running).
        stuck_h: time after which an unchanging reading is stuck, h; 0: never (tables, which know no more).
        frozen_h: the same where what it follows has moved by `moved` meanwhile (running): a forecast, a level, or the
            zone by the model; 0: never.
        always: whether every building reports it, so that a missing one is said.
    """

    kind: str
    unit: str
    range: tuple[float, float] = (-math.inf, math.inf)
    usual: tuple[float, float] = (-math.inf, math.inf)
    spike: float = math.inf
    jump: tuple[float, float] = (math.inf, 0.0)
    expected: float = math.inf
    stuck_h: float = 0.0
    frozen_h: float = 0.0
    moved: float = math.inf
    always: bool = False


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
