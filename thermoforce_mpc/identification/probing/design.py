"""Design of the excitation: choice of the most informative candidate (D-optimal, Fedorov 1972).

The parameters are time constants and gains of the forced response; weather response, drift and initial state are
marginalised. With the sensitivities S of the temperature to the parameters, the covariance C
of the rest and the parameters' prior covariance P, the criterion is log det(I + P^½ Sᵀ C⁻¹ S P^½) over the record so
far and the hours the candidate adds: twice the information gain, in nats. It needs priors only, no building data.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Record, steps_in
from thermoforce_mpc.data.series import lagged
from thermoforce_mpc.identification.estimation.regression import poles, unit_responses
from thermoforce_mpc.identification.probing.excitation import Draws, Excitation
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs

# Step of the derivative with respect to ln τ: it is straight over 2 %, and rounding is far smaller.
_STEP = 0.02
# Assumed mean level that holds the zone temperature, until the record is long enough. Of the order of draws only; by
# judgement.
_HOLDING_SHARE = 0.3
# Record length, steps, from which its mean level is used instead: half a day, which has a night or a noon.
_KNOWN_FROM = 48
# Distance of the rows, h: the response to an action takes hours. By judgement.
_ROW_H = 1.0
# The house that probing expects, one heated through its floor, where effects are the last to show: time constants, h,
# of emitter, room against structure and structure against outdoors; [slope K/h, G_2 K, rate G_3/τ_3 K/h]; relative
# standard deviation of the time constants, and standard deviations of the gains.
_TAU_H, _GAINS = np.array([0.6, 3.5, 50.0]), np.array([0.0, 2.0, 0.5])
_TAU_SD, _GAIN_SD = 0.25, np.array([0.1, 2.0, 0.5])
# Time constants of the free part, h: the house's and that of soil and neighbours; standard deviations of what its modes
# gain from each input (per K, 100 W/m² and unit of the daily waves), of its level and of its modes at the start, K.
_FREE_H = (*_TAU_H[1:], 400.0)
_FREE_SD = dict(zip(INPUTS, (0.3, 0.01, 50.0, 0.01, 0.01, 0.3, 0.3, 0.01), strict=True))
_START_SD_K = (3.0, 20.0, 50.0, 50.0)
# Disturbances: standard deviations, K, and time constants, h: doors and people, a day's habits, weather that was not
# measured; noise of a reading, K.
_DISTURBANCES, _READING_SD_K = ((0.02, 0.5), (0.2, 3.0), (2.0, 50.0)), 0.01


def choose(
    history: Record,
    ahead: Boundary,
    excitation: Excitation,
    candidates: list[Draws],
    *,
    centre_C: float,
    sign: float,
    acts: NDArray[np.bool_] | None = None,
) -> tuple[Draws, Array]:
    """Return the best candidate for the hours of `ahead`, and the levels (n,) that are expected of it.

    Args:
        history: the record so far, one instant or more.
        ahead: weather of the next hours, at the step of the record.
        excitation: current state of the excitation.
        candidates: candidates to choose from.
        centre_C: centre of the excursions, °C.
        sign: +1 heating, −1 cooling.
        acts: steps (n,) in which levels are drawn, all by default; in the others the zone is held, their level is NaN.
    """
    past, n, step_s = history.n_steps, ahead.n_steps, ahead.step_s
    time_s, T_out_C, solar_W_m2 = (
        np.concatenate([getattr(history, name), getattr(ahead, name)[1:]])
        for name in ("time_s", "T_out_C", "solar_W_m2")
    )
    whitener, rows = _whitener(time_s, T_out_C, solar_W_m2, step_s)
    holding = float(history.u[0].mean()) if past >= _KNOWN_FROM else _HOLDING_SHARE
    start_K = sign * (centre_C - float(history.T_zone_C[0, -1]))
    acts = np.ones(n, dtype=bool) if acts is None else acts
    unit = expected_rise_K(np.eye(1, n)[0], step_s)
    drawn = [_simulated_levels(excitation.resumed(each), acts, unit, start_K, holding) for each in candidates]
    held = [np.where(acts, levels, holding) for levels in drawn]
    worth = [_criterion(np.concatenate([history.u[0], levels]), step_s, whitener, rows) for levels in held]
    best = int(np.argmax(worth))
    return candidates[best], drawn[best]


def information(history: Record) -> float:
    """Return the criterion of a record, nats."""
    whitened = _whitener(history.time_s, history.T_out_C, history.solar_W_m2, history.step_s)
    return _criterion(history.u[0], history.step_s, *whitened)


def expected_rise_K(levels: Array, step_s: float, tau_h: Array = _TAU_H) -> Array:
    """Change of the zone that `levels` (n,) make in a building as the priors expect it, shape (n + 1,), K."""
    return np.asarray(_units(levels, step_s, tau_h) @ _GAINS)


def _whitener(time_s: Array, T_out_C: Array, solar_W_m2: Array, step_s: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the lower Cholesky factor of C over hourly rows (fewer in more than a month), which the levels do not
    change, and those rows.
    """
    from scipy.linalg import cholesky

    stride = steps_in(_ROW_H * HOUR_S, step_s)
    time_s, rows = time_s[::stride], np.arange(time_s[::stride].size)
    # All temperatures are assumed to be measured.
    weather = dict(zip(INPUTS, weather_inputs(time_s, T_out_C[::stride], solar_W_m2[::stride]).T, strict=True))
    hourly_s = stride * step_s
    del weather["constant"]
    slow = poles(np.log(_FREE_H), hourly_s)
    columns = [_FREE_SD[name] * lagged(values, pole) for name, values in weather.items() for pole in slow]
    fading = np.append(poles(np.log(_TAU_H[:1]), hourly_s), slow) ** rows[:, None]
    unknown = np.column_stack([*columns, np.full(rows.size, _FREE_SD["constant"]), fading * _START_SD_K])
    apart_h = np.abs(time_s[:, None] - time_s) / HOUR_S
    disturbed = sum(sd**2 * np.exp(-apart_h / hours) for sd, hours in _DISTURBANCES)
    C = unknown @ unknown.T + disturbed + _READING_SD_K**2 * np.eye(rows.size)
    return cholesky(C, lower=True), rows * stride


def _criterion(u: Array, step_s: float, whitener: Array, rows: NDArray[np.intp]) -> float:
    from scipy.linalg import solve_triangular

    sensitivities = solve_triangular(whitener, _sensitivities(u, step_s)[rows], lower=True)
    return float(np.linalg.slogdet(np.eye(sensitivities.shape[1]) + sensitivities.T @ sensitivities)[1])


def _sensitivities(u: Array, step_s: float) -> Array:
    """Return dF/d(gains, ln τ) times the priors' standard deviations, shape (n + 1, 2r), K."""
    slower = []
    for shift in np.exp(_STEP * np.eye(_TAU_H.size)):
        up, down = (expected_rise_K(u, step_s, tau_h) for tau_h in (_TAU_H * shift, _TAU_H / shift))
        slower.append((up - down) / (2.0 * _STEP) * _TAU_SD)
    gains = _units(u, step_s, _TAU_H) * _GAIN_SD
    return np.concatenate([gains, np.stack(slower, axis=1)], axis=1)


def _units(u: Array, step_s: float, tau_h: Array) -> Array:
    """Response per unit of `_GAINS` (n + 1, r): the slowest mode's gain is its rate times its time constant."""
    return unit_responses(np.log(tau_h), step_s, u) * np.append(np.ones(tau_h.size - 1), tau_h[-1])


def _simulated_levels(
    excitation: Excitation, acts: NDArray[np.bool_], unit: Array, start_K: float, holding: float
) -> Array:
    """Return the levels of an excitation simulated on the prior mean with constant weather, (n,); NaN where none
    `acts` (n,). `unit` (n + 1,): rise by a first step at full level, K.
    """
    n = acts.size
    levels, rise = np.full(n, np.nan), np.zeros(n + 1)
    for t in range(n):
        if not acts[t]:
            excitation.left = 0
            continue
        levels[t] = excitation.next(start_K - rise[t])
        rise[t + 1 :] += (levels[t] - holding) * unit[1 : n + 1 - t]
    return levels
