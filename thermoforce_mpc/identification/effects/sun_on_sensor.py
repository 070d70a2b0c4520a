"""Whether the sun shines on the zone sensor, from records of heating and weather.

Sun on a sensor enters its reading at once and leaves it behind the next cloud, while a room follows the sun through its
surfaces and structure. The records are explained twice: by the modes of the free and the forced response and the sun
that warms the surfaces within half an hour, and by these and the irradiance on one facade, which enters the reading
with the lag of a sensor. Both are linear with Gaussian priors, so that their evidence is exact; it is summed over the
time constants and disturbances, and over facade, latitude and lag. Air, floor and sensors of 0.5 K are thereby weighed
by what they hide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import expit, log_ndtr

from thermoforce_mpc.data import DAY_S, Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import other_actuators, others_of
from thermoforce_mpc.identification.estimation.columns import free_prior, free_time_constants, other_prior, start_sd
from thermoforce_mpc.identification.estimation.disturbance import Disturbance
from thermoforce_mpc.identification.estimation.modes import wide_priors
from thermoforce_mpc.identification.estimation.records import resolution_K
from thermoforce_mpc.identification.estimation.regression import OtherActuator, RegressionData, run_regression
from thermoforce_mpc.identification.estimation.whitened import Blocks, blocks_of, whitened_columns
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.sun_on_sensor import FULL_SUN_W_M2, SunOnSensor, facade_W_m2, lagged, sun_at

# What is tried: facades, latitudes °, lags of sensors s; time constants of the building h; disturbances as a share of
# the assumed ones.
_AZIMUTHS_DEG = (90.0, 135.0, 180.0, 225.0, 270.0)
_LATITUDES_DEG = (40.0, 50.0, 60.0)
_LAGS_S = (120.0, 540.0, 1080.0)
_TIME_CONSTANTS_H = tuple(product((0.1, 0.25, 0.6), (2.0, 4.0), (50.0,)))
_ORDER = 3
_SCALES = (0.1, 0.3, 1.0)
# Prior standard deviation of the reading in full sun, and the most that a sensor shows, K.
_FULL_SD_K, _MOST_K = 3.0, 8.0
# Surfaces in the sun through the windows of east, south and west: their time constant, s, latitude, °, and the prior of
# what they do to the room in full sun, K.
_SURFACES_S, _SURFACES_LATITUDE_DEG, _SURFACES_SD_K = 1800.0, 50.0, 0.5
_SURFACES = 3
# Share of the largest irradiance from which it is day: clouds move the middle of the light, not that of the day.
_DAYLIGHT = 0.02
# Least noise of readings, K: a sensor without any would make every explanation certain.
_LEAST_NOISE_K = 0.02


@dataclass(frozen=True)
class _Explanation:
    """The records under one set of time constants and disturbances.

    `without`: log evidence without sun on the sensor; `gained` (k,): log evidence that each candidate adds;
    `full_K`, `sd_K` (k,): its posterior.
    """

    without: float
    gained: Array
    full_K: Array
    sd_K: Array

    @property
    def odds(self) -> float:
        """Log odds of sun on the sensor, at even odds before."""
        return float(np.logaddexp.reduce(self.gained) - np.log(self.gained.size))

    @property
    def evidence(self) -> float:
        """Log evidence with or without."""
        return float(self.without + np.logaddexp(0.0, self.odds))


def sun_on_sensor(
    runs: Sequence[Record],
    heat_input: HeatInput,
    config: IdentificationConfig,
    resolution_K: float = 0.0,
    others: Sequence[OtherActuator] = (),
) -> SunOnSensor | None:
    """Return the likeliest sun in the readings of a zone sensor, with its probability; None where the data cannot say.

    That is so without sun, and where one signed level heats and cools: such levels are means of what the building's own
    loops deliver to a room set-point, and within a step the temperature jumps in a way that no explanation has.

    Args:
        runs: records of the zone; the first level is that of its own actuator, the rest are those of `others`.
        heat_input: what the own actuator delivers.
        resolution_K: of the sensor, K; 0 for a fine one.
        others: the other actuators of the building.
    """
    noon_s = None if heat_input.lowest < 0.0 else _noon_s(runs)
    if noon_s is None:
        return None
    regressions = [run_regression(run, heat_input, config, others) for run in runs]
    sites = [(latitude, lag_s) for latitude in _LATITUDES_DEG for lag_s in _LAGS_S]
    signals = [
        np.column_stack([_signals(run, noon_s, sites)[e.rows], e.target])
        for run, e in zip(runs, regressions, strict=True)
    ]
    noise_K = float(np.hypot(max(config.sensor_sd_K, _LEAST_NOISE_K), resolution_K / np.sqrt(12.0)))
    explanations = []
    for scale in _SCALES:
        disturbed = [_with_disturbance(e, scale, noise_K) for e in regressions]
        white = np.concatenate([e.disturbance.whitened(s) for e, s in zip(disturbed, signals, strict=True)])
        size = -sum(e.disturbance.log_determinant for e in disturbed)
        blocks = blocks_of(disturbed, _ORDER, 1)
        explanations += [_explain(regressions, blocks, white, np.log(hours), size) for hours in _TIME_CONSTANTS_H]
    best = max(explanations, key=lambda explanation: explanation.evidence)
    place = int(np.argmax(best.gained))
    (latitude, lag_s), azimuth = sites[place // len(_AZIMUTHS_DEG)], _AZIMUTHS_DEG[place % len(_AZIMUTHS_DEG)]
    probability = float(expit(best.odds))
    full_K = float(best.full_K[place])
    # With a probability of less than one, the mean is less and the spread more than those of a sensor in the sun.
    sd_K = np.sqrt(probability * best.sd_K[place] ** 2 + probability * (1.0 - probability) * full_K**2)
    return SunOnSensor(probability * full_K, float(sd_K), probability, azimuth, lag_s, latitude, noon_s)


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


def _signals(run: Record, noon_s: float, sites: Sequence[tuple[float, float]]) -> Array:
    """Sun on the surfaces (3) and on the sensor (sites times azimuths) in full suns, at all boundaries."""
    time_s, solar = run.time_s, run.solar_W_m2
    facades = {
        latitude: facade_W_m2(time_s, solar, latitude, noon_s, _AZIMUTHS_DEG) / FULL_SUN_W_M2
        for latitude in _LATITUDES_DEG
    }
    parts = [lagged(facades[_SURFACES_LATITUDE_DEG][:, ::2], time_s, _SURFACES_S)]
    parts += [lagged(facades[latitude], time_s, lag_s) for latitude, lag_s in sites]
    return np.concatenate(parts, axis=1)


def _with_disturbance(regression: RegressionData, scale: float, noise_K: float) -> RegressionData:
    assumed = regression.disturbance
    return replace(regression, disturbance=Disturbance(assumed.time_s, scale * assumed.sd_K, assumed.hours, noise_K))


def _explain(
    regressions: Sequence[RegressionData], blocks: Blocks, signals: Array, log_tau: Array, size: float
) -> _Explanation:
    """Evidence of the records for these time constants.

    `signals`, whitened: surfaces, sensor and target; `size`: log density of the whitening.
    """
    mean, sd = _priors(regressions, log_tau)
    columns = np.zeros((signals.shape[0], sd.size - _SURFACES))
    whitened_columns(blocks, log_tau, columns)
    p = sd.size
    rows = np.concatenate([columns, signals], axis=1)
    # Normal equations with the priors; without the known columns, what is left of sensor and target follows from them.
    normal = rows.T @ rows
    normal[np.arange(p), np.arange(p)] += sd**-2.0
    normal[:p, -1] += mean / sd**2
    triangle = np.linalg.cholesky(normal[:p, :p])
    cross = solve_triangular(triangle, normal[:p, p:], lower=True, check_finite=False)
    reduced = normal[p:, -1] - cross.T @ cross[:, -1]
    reduced[-1] += float(((mean / sd) ** 2).sum())
    precision = np.diag(normal)[p:-1] - (cross[:, :-1] ** 2).sum(axis=0) + _FULL_SD_K**-2.0
    full_K, sd_K = reduced[:-1] / precision, precision**-0.5
    gained = 0.5 * full_K**2 * precision - 0.5 * np.log(precision * _FULL_SD_K**2)
    gained += np.log(2.0) + log_ndtr(full_K / sd_K)  # the sun only adds
    without = size - 0.5 * float(reduced[-1]) - float(np.log(np.diag(triangle)).sum() + np.log(sd).sum())
    return _Explanation(without, np.where(full_K <= _MOST_K, gained, -np.inf), full_K, sd_K)


def _priors(regressions: Sequence[RegressionData], log_tau: Array) -> tuple[Array, Array]:
    """Prior mean and standard deviation of all columns but those of the sensor."""
    modes = free_time_constants(log_tau).size
    free_mean, free_sd, _ = free_prior(modes)
    own_mean, own_sd = wide_priors(_ORDER).gains_at(log_tau)
    other_mean, other_sd = other_prior(regressions[0], log_tau)
    starts = np.tile(start_sd(modes + 1), len(regressions))
    mean = [own_mean, other_mean, free_mean, np.zeros(starts.size + _SURFACES)]
    return np.concatenate(mean), np.concatenate([own_sd, other_sd, free_sd, starts, np.full(_SURFACES, _SURFACES_SD_K)])


def without_sun(
    runs: Sequence[Record], layout: Layout, heat_inputs: Sequence[HeatInput], config: IdentificationConfig
) -> tuple[list[Record], dict[int, SunOnSensor]]:
    """The runs without the sun on their zone sensors, and what was found of it by zone."""
    found: dict[int, SunOnSensor] = {}
    if not runs or not config.sun_on_sensor:
        return list(runs), found
    for zone in range(len(layout.floor_area_m2)):
        for a in layout.actuators_of(zone)[:1]:
            order = [a, *others_of(layout, a, config)]
            parts = [run.part(zone, order, [layout.machine_of[a]]) for run in runs]
            others = other_actuators(layout, heat_inputs, a, config)
            likeliest = sun_on_sensor(parts, heat_inputs[a], config, resolution_K(parts), others)
            if likeliest is not None and likeliest.likely:
                found[zone] = likeliest
    corrected = []
    for run in runs:
        T_zone_C = np.array(run.T_zone_C)
        for zone, sun in found.items():
            T_zone_C[zone] -= sun.part_K(run.time_s, run.solar_W_m2)
        corrected.append(replace(run, T_zone_C=T_zone_C))
    return corrected, found
