"""Plausibility limits of readings and limits of gaps between them, with their reasons.

The ranges are wide: they reject faults (a broken wire, a lost decimal point, K read as °C), not unusual readings.
Values outside are treated as not measured; nothing is clipped.
"""

from __future__ import annotations

# Tolerance of levels outside [0, 1], from rounding of step means and solver solutions.
ROUNDING = 1e-6
LEVEL = (-ROUNDING, 1.0 + ROUNDING)
"""Actuation u, dimensionless."""

ZONE_C = (-30.0, 60.0)
"""Zone temperature, °C. An unheated building follows the outdoor temperature, and a closed one in the sun stays below
60 °C. An open Pt100 or a lost wire reads far outside."""

ZONE_JUMP_K, ZONE_JUMP_K_PER_H = 15.0, 5.0
"""Largest change of the zone temperature since its last accepted reading, K plus K/h. The air of a room follows its fan
coil within minutes: in BOPTEST's `bestest_air`, probed between off and full, it changed by up to 11.7 K in 15 min (a
light EnergyPlus zone by 2.1 K). Since the limit grows with time, a sensor that was moved or calibrated is accepted
again within hours."""

OUTDOOR_C = (-60.0, 60.0)
"""Outdoor temperature, °C. The highest recorded is 56.7 °C (WMO, Death Valley 1913); below −60 °C there are only single
settlements, outside the range of the machines."""

SOLAR_W_M2 = (-30.0, 1500.0)
"""Global horizontal irradiance, W/m². A pyranometer reads below zero at night: ISO 9060:2018 allows 30 W/m² of zero
offset in its class C. The solar constant is 1361 W/m²; broken cloud exceeds the clear-sky 1100 W/m² for minutes, and
means over a control step above 1500 W/m² have not been observed."""

RETURN_WATER_C = (-30.0, 150.0)
"""Return water of the emitters, °C: from brine to pressurised hot water."""

LOAD_RANGE = (-1.0, 3.0)
"""Heat, in the direction of the machine, in multiples of the identified model's largest heat. The upper limit leaves
room for a back-up heater, outdoor temperatures outside the data and an error of the fit. Negative heat occurs in
defrosting, at most the machine's own heat reversed."""

POWER_RANGE = (-0.05, 3.0)
"""Electric power in multiples of the identified model's largest power. Below zero only meter noise."""

LOAD_W_PER_M2 = 500.0
"""Heat or power per floor area without a model, W/m². Design loads are about 100 to 200 W/m² in old buildings; an
oversized machine has twice that, and all loads together stay below 500."""

BRIDGED_GAP_H = 6.0
"""Longest weather gap filled by linear interpolation, h. Over a quarter of a daily wave the error is at most
1 − cos 45° = 29 % of the amplitude, over half a day all of it. Longer gaps take the readings of the same hour of the
nearest day."""

BRIDGED_LEVEL_H = 2.0
"""Longest gap in u filled by linear interpolation, h: the level that both ends show, else between them, since it may
have changed anywhere in the gap. About as long as a thermostat or a draw of the probing holds a level."""

LEVELS_AROUND_H = 12.0
"""Time on either side of a longer gap in u over which known levels are averaged to fill it, h: a whole day in total, so
that the mean heat is about right for any schedule."""
