"""What a reading of a building can be, and how long a gap between readings may be: the numbers and their reasons.

Ranges are wide: they are there for readings that no building gives (a broken wire, a lost decimal point, kelvin read as
°C), not for unusual ones. What lies outside is taken as not measured; nothing is clipped.
"""

from __future__ import annotations

# How far beyond [0, 1] a level may be: means over a step and solutions of a solver are, by rounding.
ROUNDING = 1e-6
LEVEL = (-ROUNDING, 1.0 + ROUNDING)
"""Actuation u, dimensionless."""

ZONE_C = (-30.0, 60.0)
"""Zone temperature, °C. An unheated building follows the outdoors, and a closed one in the sun stays below 60 °C;
beyond that machines and people have left. An open Pt100 or a lost wire reads far outside."""

ZONE_JUMP_K, ZONE_JUMP_K_PER_H = 5.0, 5.0
"""How far the zone temperature may have moved since it was last believed, K and K per hour since. ASHRAE 55-2020 (table
of drifts and ramps) allows 1.1 K in a quarter of an hour and 2.2 K in an hour for comfort; a light
EnergyPlus zone of ours, switched at random between off and full, moved by at most 2.1 and 5.1 K; and airing in winter
takes a room's air down by a few kelvin within minutes. As the room grows with time, a
sensor that was moved or calibrated is believed again after some hours at most."""

OUTDOOR_C = (-60.0, 60.0)
"""Outdoor temperature, °C. The highest ever recorded is 56.7 °C (WMO, Death Valley 1913); below −60 °C there are
single settlements, and no machine of ours."""

SOLAR_W_M2 = (-30.0, 1500.0)
"""Global horizontal irradiance, W/m². A pyranometer reads below zero at night: ISO 9060:2018 allows 30 W/m² of zero
offset in its class C. The sun gives 1361 W/m² above the air; broken cloud adds to a clear sky's 1100 for minutes, and
means over a control step have not been seen above 1500."""

RETURN_WATER_C = (-30.0, 150.0)
"""Return water of the emitters, °C: from brine to pressurised hot water."""

LOAD_RANGE = (-1.0, 3.0)
"""Heat, in the direction of the machine, in multiples of the most that the identified model knows it to give. Beyond
the model there may be a back-up heater, colder or milder days than those seen, and an error of the fit: twice again
the machine leaves room for these. Below zero is what defrosting takes: at most the machine, reversed."""

POWER_RANGE = (-0.05, 3.0)
"""Electric power, in multiples of the most that the identified model knows. Below zero only a meter's noise."""

LOAD_W_PER_M2 = 500.0
"""Heat or power per floor area where no model is known, W/m². Design loads are some 100 to 200 W/m² in old buildings;
twice that is an oversized machine, and a charge of everything at once stays below 500."""

BRIDGED_GAP_H = 6.0
"""Longest time between two readings of the weather that a straight line bridges, h. It is a quarter of a day: a line
between the ends of a quarter of a daily wave is off by at most 1 − cos 45° = 29 % of the amplitude, one over half a day
by all of it. Longer gaps take the readings of the same hour of the nearest day."""

LEVELS_AROUND_H = 12.0
"""How far on either side of a gap in u the known levels are averaged to fill it, h: a day in all, so that the heat that
the building got is about right whatever the schedule."""
