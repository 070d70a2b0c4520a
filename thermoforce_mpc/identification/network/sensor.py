"""Whether the sun shines on a zone sensor, from records of a building in operation.

Sun on a sensor enters its reading at once and leaves it behind the next cloud, while a room follows the sun through its
surfaces and structure. The room's network, with the sun through each facade as heat, is fitted without and with sun on
the sensor: for each facade and lag of the sensor one number more, K in full sun. What that gains in posterior, less
what one number more costs, and less what is known beforehand (few sensors stand in the sun, and rooms answer it faster
than a few nodes do), are the odds. Where the slope of the posterior shows no gain, nothing is searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Layout, Record
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import resolution_K
from thermoforce_mpc.identification.network.building import NetworkInputs, room_run
from thermoforce_mpc.identification.network.estimate import RoomRun, estimate_room, gain_of_one_more, searched
from thermoforce_mpc.identification.network.room import SENSOR_SD_K
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.sun_on_sensor import FULL_SUN_W_M2, SunOnSensor, facade_W_m2, off_sensors, sensor_lag, sun_at

# What is tried: facades of the sensor and of windows, °, and lags of sensors, s, at a site of this latitude, °. Set on
# ideal sensors and sensors in the sun of drawn houses (2026-11-25).
_AZIMUTHS_DEG, _WINDOWS_DEG = (90.0, 135.0, 180.0, 225.0, 270.0), (90.0, 180.0, 270.0)
_LAGS_S, _LATITUDE_DEG = (120.0, 900.0), 50.0
# The most that a sensor shows in full sun, K, and the variance that a search of it begins with, of that of the prior.
# By judgement: more is no sensor in a room.
_MOST_K, _SPREAD = 8.0, 0.05
# The least gain that is more than what searches leave, nats: ten times that at which they end (`_LEAST_GAIN` of
# `network.estimate`).
_LEAST_GAIN = 1e-3
# Share of sensors that stand in the sun, beforehand, and the probability by slopes below which none is searched for.
# With these ideal sensors of six drawn houses and the heat pump come to 0.03 at most, sensors with 2.5 K in full sun to
# 1.00 (2026-11-28).
_IN_THE_SUN, _HOPELESS = 0.1, 0.02
# Share of the largest irradiance from which it is day: clouds move the middle of the light, not that of the day. By
# judgement.
_DAYLIGHT = 0.02


@dataclass(frozen=True)
class _Explanation:
    """Sun from `azimuth_deg` with `lag_s`: `full_K` in full sun, half the negative log posterior `value`, and the
    room's parameters there, in prior standard deviations.
    """

    azimuth_deg: float
    lag_s: float
    full_K: float
    value: float
    at: Array

    def sd_K(self, without: float) -> float:
        """Standard deviation of `full_K`, where `value` is that `without`, if it were 0.

        The mean of a Gaussian that gains g over 0 lies √(2 g) standard deviations from it.
        """
        gained = max(without - self.value, _LEAST_GAIN)
        return float(np.clip(abs(self.full_K) / np.sqrt(2.0 * gained), 1e-3, SENSOR_SD_K))

    def gained(self, without: float) -> float:
        """Log evidence that it gains over none, with half a Gaussian as its prior: the sun only adds."""
        from scipy.special import log_ndtr

        sd_K = self.sd_K(without)
        positive = float(log_ndtr(self.full_K / sd_K) - log_ndtr(0.0))
        likely = without - self.value + np.log(sd_K / SENSOR_SD_K) + positive
        return float(likely) if self.full_K <= _MOST_K else -np.inf


def sun_on_sensor(
    runs: Sequence[Record], zone: int, layout: Layout, heat_inputs: Sequence[HeatInput], config: IdentificationConfig
) -> SunOnSensor | None:
    """Return the likeliest sun in the readings of a zone sensor, with its probability; None where the data cannot say.

    That is so without sun or an actuator, and where one signed level heats and cools: such levels are means of what the
    building's own loops deliver to a room set-point, and within a step the temperature jumps in a way that no
    explanation has.

    Args:
        runs: records of the building, prepared (`estimation.records`).
        zone: whose sensor.
        layout: what acts where.
        heat_inputs: v of each actuator (A,).
        config: whether neighbours count.
    """
    from scipy.linalg import block_diag

    home = layout.actuators_of(zone)
    if not home or any(heat_inputs[a].u_min < 0.0 for a in home) or (noon_s := _noon_s(runs)) is None:
        return None
    actuators = NetworkInputs(layout, heat_inputs, [()] * len(heat_inputs), config.cross_effects)
    grid_K = resolution_K([run.part(zone, [home[0]], [layout.machine_of[home[0]]]) for run in runs])
    lit = [_with_windows(room_run(run, zone, actuators, grid_K), run, noon_s) for run in runs]
    room = replace(actuators.room(zone), facades=len(_WINDOWS_DEG))
    sunlit, shone = replace(room, sensor=True), {}
    for azimuth_deg in _AZIMUTHS_DEG:
        facades = [facade_W_m2(run.time_s, run.solar_W_m2, _LATITUDE_DEG, noon_s, (azimuth_deg,)) for run in runs]
        for lag_s in _LAGS_S:
            parts = [
                sensor_lag(f[:, 0] / FULL_SUN_W_M2, run.time_s, lag_s) for f, run in zip(facades, runs, strict=True)
            ]
            shone[azimuth_deg, lag_s] = [replace(run, on_sensor=part) for run, part in zip(lit, parts, strict=True)]
    fit = estimate_room(room, lit, most_starts=1)
    start = np.append(fit.scaled, 0.0)
    explanations = [
        _Explanation(*where, at * SENSOR_SD_K, fit.value - gain, fit.scaled)
        for where, seen in shone.items()
        for gain, at in [gain_of_one_more(sunlit, seen, start, fit.spread)]
    ]
    if _probability(explanations, fit.value) < _HOPELESS:
        return _found(explanations, fit.value, noon_s)
    fit = estimate_room(room, lit)
    without, start, spread = fit.value, np.append(fit.scaled, 0.0), block_diag(fit.spread, _SPREAD)
    explanations = []
    for where, seen in shone.items():
        found = searched(sunlit, seen, start, spread)
        full_K = float(found.x[-1] * SENSOR_SD_K)
        explanations.append(_Explanation(*where, full_K, float(found.fun), found.x[:-1]))
    best = max(explanations, key=lambda explanation: explanation.gained(without))
    # The search with sun may have found a better room, which owes nothing to the sun.
    without = min(without, float(searched(room, lit, best.at, fit.spread).fun))
    return _found(explanations, without, noon_s)


def _probability(explanations: Sequence[_Explanation], without: float) -> float:
    """Probability that the sensor stands in the sun, all explanations together."""
    from scipy.special import expit

    gained = np.logaddexp.reduce([explanation.gained(without) for explanation in explanations])
    beforehand = np.log(_IN_THE_SUN / (1.0 - _IN_THE_SUN))
    return float(expit(gained - np.log(len(explanations)) + beforehand))


def _found(explanations: Sequence[_Explanation], without: float, noon_s: float) -> SunOnSensor:
    best = explanations[int(np.argmax([explanation.gained(without) for explanation in explanations]))]
    probability = _probability(explanations, without)
    # With a probability of less than one, the mean is less and the spread more than those of a sensor in the sun.
    variance = probability * best.sd_K(without) ** 2 + probability * (1.0 - probability) * best.full_K**2
    size = probability * best.full_K, float(np.sqrt(variance))
    return SunOnSensor(*size, probability, best.azimuth_deg, best.lag_s, _LATITUDE_DEG, noon_s)


def _with_windows(run: RoomRun, record: Record, noon_s: float) -> RoomRun:
    """The run with the sun on the windows' facades in each step as inputs, W/m²."""
    at_boundaries = facade_W_m2(record.time_s, record.solar_W_m2, _LATITUDE_DEG, noon_s, _WINDOWS_DEG)
    of_steps = np.concatenate([step_means(at_boundaries.T).T, at_boundaries[-1:]])
    return replace(run, inputs=np.ascontiguousarray(np.column_stack([run.inputs, of_steps])))


def _noon_s(runs: Sequence[Record]) -> float | None:
    """Mean solar noon on the records' clock, s, the middle of their hours of daylight; None without irradiance."""
    solar, time_s = (np.concatenate(x) for x in zip(*((r.solar_W_m2, r.time_s) for r in runs), strict=True))
    daylight = solar > _DAYLIGHT * solar.max(initial=0.0)
    if not daylight.any():
        return None
    # Angles of the true solar time at a site whose noon is at 12 h, so that the equation of time is taken off.
    angle = sun_at(time_s, 0.0, 0.5 * DAY_S).hour_angle
    centre = np.angle(np.exp(1j * angle[daylight]).sum())
    return float((0.5 + centre / (2.0 * np.pi)) * DAY_S)


def without_sun(
    runs: Sequence[Record], layout: Layout, heat_inputs: Sequence[HeatInput], config: IdentificationConfig
) -> tuple[list[Record], dict[int, SunOnSensor]]:
    """The runs without the sun on their zone sensors where it is likely, and the likeliest sun by zone."""
    found: dict[int, SunOnSensor] = {}
    if not runs or not config.sun_on_sensor:
        return list(runs), found
    zones = range(len(layout.floor_area_m2))
    for zone in zones:
        likeliest = sun_on_sensor(runs, zone, layout, heat_inputs, config)
        if likeliest is not None:
            found[zone] = likeliest
    sun = [found[zone] if zone in found and found[zone].likely else None for zone in zones]
    return [off_sensors(run, sun) for run in runs], found
