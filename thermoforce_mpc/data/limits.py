"""Plausibility limits of readings and limits of gaps between them, with their reasons.

The ranges are wide: they reject faults (a broken wire, a lost decimal point, K read as °C), not unusual readings.
Values outside are treated as not measured; nothing is clipped.
"""

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
