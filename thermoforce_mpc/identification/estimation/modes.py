"""Physical parameters of the modes: time constants in h, initial slope in K/h, steady gains in K.

Besides the time constants, the forced response of order r has r parameters: the initial slope of the step response and
the steady gains of all modes but the fastest. All are nonnegative (times the sign), as the operator requires.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.recursions import filtered
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

# Largest factor between the outermost time constants and their prior means.
_REACH = 10.0
# Priors for a heater of unknown heat: a heater sized for its house heats the structure by about 0.5 K/h.
_WEAK_RATE_K_PER_H = (0.5, 0.5)
_WEAK_GAIN_K = (2.0, 2.0)
# Share of a zone's heat, mean and standard deviation, that spreads over the whole building within days instead of
# staying in the zone's own structure.
_SPREAD = (0.5, 0.35)
# Relative standard deviation of the coupling of room and structure of a zone that is a small part of its building:
# walls to its neighbours take heat as its own structure does.
_NEIGHBOURS_COUPLING_SD = 1.0
# Initial slope: near zero behind a delay mode (slab), else that of the first mode.
_DELAYED_SLOPE_K_PER_H = (0.0, 0.1)
_DIRECT_SLOPE_K_PER_H = (0.5, 0.7)
# Initial slopes of direct heat, by which the default is replaced where they predict better: a radiator or convector
# sized for its room, and a fan coil of 1 to 10 kW on the air and furniture of a room.
DIRECT_SLOPES_K_PER_H = ((5.0, 7.0), (50.0, 40.0))
# Least standard deviation of a gain, K or K/h, also if the fit gives zero.
_LEAST_GAIN_SD = 1e-3


@dataclass(frozen=True)
class ModePriors:
    """Gaussian priors of one order r, positive in the direction of the actuator's sign.

    `log_tau` (r,) and `log_tau_sd`: ln(τ/h). `gain_mean` and `gain_sd` (r,): [slope K/h, G_2 … G_r K]. For the slowest
    of several modes the prior is on the rate G_r/τ_r, `slowest_rate` (mean, sd) K/h, instead of the gain.
    """

    log_tau: Array
    log_tau_sd: float
    gain_mean: Array
    gain_sd: Array
    slowest_rate: tuple[float, float]

    @property
    def order(self) -> int:
        """Number of modes."""
        return int(self.log_tau.size)

    def bounds_h(self) -> Array:
        """Return the bounds of each time constant, shape (r, 2), h; neighbours meet at their geometric mean."""
        tau = np.exp(self.log_tau)
        inner = np.sqrt(tau[:-1] * tau[1:])
        edges = np.concatenate([[tau[0] / _REACH], inner, [tau[-1] * _REACH]])
        return np.stack([edges[:-1], edges[1:]], axis=1)

    def gains_at(self, log_tau: Array) -> tuple[Array, Array]:
        """Return prior mean and standard deviation (r,) of [slope, G_2 … G_r] for these time constants."""
        mean, sd = self.gain_mean.copy(), self.gain_sd.copy()
        if self.order > 1:
            tau = float(np.exp(log_tau[-1]))
            mean[-1], sd[-1] = self.slowest_rate[0] * tau, self.slowest_rate[1] * tau
        return mean, sd


def mode_priors(
    order: int,
    config: IdentificationConfig,
    heat_input: HeatInput,
    floor_area_m2: float | None,
    share: float = 1.0,
) -> ModePriors:
    """Return priors from floor area (m²) and heat input, or weak ones if either is unknown.

    `share`: the zone's floor area over that of all zones, with which it exchanges heat.
    """
    rate, gain = _WEAK_RATE_K_PER_H, _WEAK_GAIN_K
    if heat_input.heat is not None and floor_area_m2 is not None:
        watts = heat_input.reference_W / floor_area_m2
        per_hour = watts / config.heat_capacity_Wh_m2K
        above_structure = watts / config.room_coupling_W_m2K
        rate = (per_hour, per_hour * config.heat_capacity_sd)
        coupling_sd = np.hypot(config.room_coupling_sd, _NEIGHBOURS_COUPLING_SD * (1.0 - share))
        gain = (above_structure, above_structure * float(coupling_sd))
    lost = _SPREAD[0] * (1.0 - share), _SPREAD[1] * (1.0 - share)
    rate = (rate[0] * (1.0 - lost[0]), float(np.hypot(rate[1] * (1.0 - lost[0]), rate[0] * lost[1])))
    slope = config.start_slope_K_per_h or (_DELAYED_SLOPE_K_PER_H if order == 3 else _DIRECT_SLOPE_K_PER_H)
    middle = [gain] * (order - 2)
    gain_priors = [slope, *middle, (0.0, 0.0)][:order] if order > 1 else [slope]
    return ModePriors(
        log_tau=np.log(config.time_constants(order)),
        log_tau_sd=config.time_constant_log_sd,
        gain_mean=np.array([mean for mean, _ in gain_priors]),
        gain_sd=np.array([sd for _, sd in gain_priors]),
        slowest_rate=rate,
    )


def neighbour_rate(
    config: IdentificationConfig, heat_input: HeatInput, floor_area_m2: float | None, share: float
) -> tuple[float, float]:
    """Prior (mean, sd), K/h, of the slowest mode's rate in other zones; arguments as for `mode_priors`.

    What leaves the zone warms the whole building; how it divides among the others is as uncertain as its amount.
    """
    alone, _ = mode_priors(3, config, heat_input, floor_area_m2).slowest_rate
    spread = _SPREAD[0] * alone * share
    return spread, spread


def centred_priors(log_tau: Array, gains: Array, relative_sd: float) -> ModePriors:
    """Return priors centred on a fit, `log_tau` (r,) and `gains` (r,) [slope K/h, G_2 … G_r K], with `relative_sd`."""
    gain_sd = np.maximum(relative_sd * np.abs(gains), _LEAST_GAIN_SD)
    rate = float(gains[-1] / np.exp(log_tau[-1]))
    return ModePriors(
        log_tau=np.asarray(log_tau, dtype=np.float64),
        log_tau_sd=relative_sd,
        gain_mean=np.asarray(gains, dtype=np.float64),
        gain_sd=gain_sd,
        slowest_rate=(rate, max(relative_sd * rate, _LEAST_GAIN_SD)),
    )


def poles(log_tau: Array, step_s: float) -> Array:
    """Return the poles exp(−step/τ), shape (r,)."""
    return np.asarray(np.exp(-step_s / HOUR_S / np.exp(log_tau)))


def unit_responses(log_tau: Array, step_s: float, drive: Array, rows: NDArray[np.intp] | None = None) -> Array:
    """Return the forced response to `drive` (n,) per unit of [slope, G_2 … G_r], shape (n + 1, r), K.

    Row t is the state before step t, starting from zero; only `rows`, increasing, where they are given.
    """
    rows = np.arange(drive.size + 1) if rows is None else rows
    signals = np.ascontiguousarray(drive, dtype=np.float64)[:, None]
    first, nothing = np.zeros(log_tau.size, dtype=np.intp), np.zeros(log_tau.size)
    own, lead = lags_of_gains(log_tau)
    return np.asarray(filtered(signals, first, poles(log_tau, step_s), nothing, own, first, lead, rows))


def lags_of_gains(log_tau: Array) -> tuple[Array, Array]:
    """What a unit of each of [slope, G_2 … G_r] is of lags of gain 1: of its own mode and of the first, (r,) each."""
    tau = np.exp(log_tau)
    own, lead = np.ones(tau.size), -tau[0] / tau
    own[0], lead[0] = tau[0], 0.0
    return own, lead


def to_operator(
    log_tau: Array,
    gains: Array,
    *,
    step_s: float,
    bounds_h: Array,
    sign: int,
    gamma: float,
    hidden: int,
    heat_input: HeatInput,
    feature_mean: Array,
    feature_scale: Array,
) -> OperatorParameters:
    """Return the linear operator (m = 1) with these time constants and nonnegative [slope, G_2 … G_r]."""
    tau, a = np.exp(log_tau), poles(log_tau, step_s)
    steady = np.concatenate([[tau[0] * (gains[0] - (gains[1:] / tau[1:]).sum())], gains[1:]])
    bounds = np.exp(-step_s / HOUR_S / bounds_h)
    return linear_operator(
        a,
        sign * steady * (1.0 - a),
        step_s=step_s,
        pole_bounds=np.stack([np.minimum(bounds[:, 0], a), np.maximum(bounds[:, 1], a)], axis=1),
        sign=sign,
        gamma=gamma,
        hidden=hidden,
        heat_input=heat_input,
        feature_mean=feature_mean,
        feature_scale=feature_scale,
    )
