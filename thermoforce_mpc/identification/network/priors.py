"""Priors of a room's parameters, per m² of its floor."""

from __future__ import annotations

from typing import NamedTuple

DISTURBANCE_H = (1.0, 6.0, 48.0)
"""Time constants of the disturbances, h."""


class Prior(NamedTuple):
    """Log-normal: median, and standard deviation of the logarithm."""

    median: float
    log_sd: float


# Per m² of floor. Capacities Wh/K: air, furniture and the first centimetre of surfaces; EN ISO 13790 table 12 has 22
# (very light) to 103 (very heavy) for the structure, to which the envelope's outer half adds; an emitter holds from 1
# (convector) to 30 (screed). Conductances W/K: EN ISO 13790 has 9.1 W/m²K to about 3 m² of structure, in series with
# the surfaces' 3.45; windows, air change and walls lose 0.5 to 4 in all. Heat of an actuator at full level, W; sun, m²
# of aperture; gains, W.
ROOM_PRIORS: dict[str, Prior] = {
    "C_room": Prior(18.0, 0.5),
    "C_structure": Prior(60.0, 0.6),
    "H_structure": Prior(10.0, 0.6),
    "H_outdoors": Prior(1.0, 0.7),
    "C_envelope": Prior(15.0, 1.0),
    "H_envelope": Prior(2.0, 0.9),
    "H_envelope_outdoors": Prior(1.0, 0.9),
    "H_neighbours": Prior(0.1, 1.5),
    "sun": Prior(0.04, 1.0),
    "sun_structure": Prior(0.04, 1.0),
    "gains": Prior(4.0, 0.7),
}
EMITTER_PRIORS: dict[str, Prior] = {
    "heat": Prior(60.0, 0.7),
    "C_emitter": Prior(6.0, 1.2),
    "H_emitter": Prior(6.0, 0.8),
    "heat_structure": Prior(0.15, 1.0),
}
# Metered heat over floor area says the heat of full level but for the meter and the area.
METERED_LOG_SD = 0.15
# Of all measured neighbours, between which the medians are divided: inside walls and floors of 1 to 2 m² and, without
# both films, 1.4 to 4 W/m²K (EN ISO 6946); air through a door or two, 5 W/K closed and up to 100 open (Brown and
# Solvason 1962).
WALLS = Prior(3.5, 1.0)
DOORS = Prior(1.5, 1.0)
# Standard deviations: disturbances W/m², process noise of room and structure K per √h, a reading K.
NOISE: dict[str, Prior] = {
    **{f"disturbance_{hours:g}h": Prior(2.0, 0.8) for hours in DISTURBANCE_H},
    "room_noise": Prior(0.06, 0.8),
    "structure_noise": Prior(0.04, 0.8),
    "reading": Prior(0.03, 0.7),
}
# Sun through one facade, m² of aperture, more or less than by that on the horizontal; on a sensor in full sun, K.
FACADE_SD, SENSOR_SD_K = 0.02, 3.0
# Sun by the side of the house and daily wave of the gains, W/m²; by their signed weight in `INPUTS`.
WAVES: dict[str, float] = {"solar_cosine": 0.02, "solar_sine": 0.02, "daily_cosine": 1.5, "daily_sine": 1.5}
