"""Effects of one actuator while the others act: the operator against pairs of runs of an emulated house of rooms.

All valves follow drawn levels, and again with those of one valve drawn anew (paper eq:effect, per pair of zone and
actuator). Both runs start in the same state under the same weather, so their difference is the effect.

While a machine is at its limit valves take heat from each other, which no effect of a valve says: plans keep within
the limit instead. So effects are those in the house with a machine that no levels bring there (`within_limits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.rooms.plant import HouseOfRooms

STEP_S, HORIZON_H = 900.0, 24.0
# True effects below this, K, have no sign that counts; pairs whose RMS stays below it are not scored.
_LEAST_K = 0.05
# Drawn levels, their holding times, steps, and days from one pair of runs to the next.
_LEVELS, _HOLD_STEPS, _APART_DAYS = (0.0, 0.3, 0.6), (4, 8, 16), 1.0
# How many times as large a machine is that is never at its limit: valves of a drawn house take 1.6 times its heat.
_LARGER = 5.0


@dataclass(frozen=True)
class PairScore:
    """One pair: RMS of the true effect and RMSE of the predicted one, K; share of steps with the right sign."""

    zone: str
    actuator: str
    own: bool
    effect_rms_K: float
    rmse_K: float
    sign_right: float

    @property
    def relative(self) -> float:
        """RMSE over RMS; NaN where the effect is too small to be scored."""
        return self.rmse_K / self.effect_rms_K if self.effect_rms_K >= _LEAST_K else float("nan")


def within_limits(plant: HouseOfRooms) -> HouseOfRooms:
    """The same house with a machine that no levels bring to its limit, and that cycles below the same heat."""
    pump = plant.house.heat_pump
    larger = replace(pump, capacity_W=_LARGER * pump.capacity_W, lowest_level=pump.lowest_level / _LARGER)
    return HouseOfRooms(replace(plant.house, heat_pump=larger))


def score_pairs(
    plant: HouseOfRooms, model: ThermalModel, start_s: float, windows: int = 6, seed: int = 7
) -> list[PairScore]:
    """Score every pair over `windows` days from `start_s`.

    Args:
        plant: the house, after identification, or another one with the same names; it is reset.
        model: what was identified on it.
        start_s: start of the first day, after a week of native control, s.
        windows: number of days, each with one run per actuator beside the base run.
        seed: seed of the levels.
    """
    rng = np.random.default_rng(seed)
    Z, A, _ = model.operator.shape
    n = round(HORIZON_H * HOUR_S / STEP_S)
    predictor = Predictor(model.operator, [build_free_response("rc", rc=free) for free in model.free])
    true, predicted = np.zeros((windows, A, Z, n)), np.zeros((windows, A, Z, n))
    for window in range(windows):
        plant.reset(start_s + window * _APART_DAYS * DAY_S, 7 * DAY_S)
        begin = plant.snapshot()
        observation = Observation(plant.past(STEP_S), plant.forecast(n * STEP_S, STEP_S))
        context = predictor.context(observation)
        base = np.stack([_levels(rng, n) for _ in range(A)])
        T_base = _followed(plant, base)
        for a in range(A):
            plant.restore(begin)
            other = base.copy()
            other[a] = _levels(rng, n)
            true[window, a] = _followed(plant, other) - T_base
            predicted[window, a] = context.effect(other, base)
    return [_score(model, z, a, true[:, a, z].ravel(), predicted[:, a, z].ravel()) for a in range(A) for z in range(Z)]


def _score(model: ThermalModel, z: int, a: int, true: Array, predicted: Array) -> PairScore:
    counts = np.abs(true) > _LEAST_K
    right = np.sign(predicted[counts]) == np.sign(true[counts])
    return PairScore(
        model.operator.zones[z],
        model.operator.actuators[a],
        model.operator.home[a] == z,
        rms(true),
        rms(predicted - true),
        float(right.mean()) if counts.any() else float("nan"),
    )


def _followed(plant: HouseOfRooms, levels: Array) -> Array:
    """Zone temperatures (Z, n) at the end of each step under `levels` (A, n), °C."""
    return np.stack([plant.advance(tuple(u), STEP_S).T_zone_C for u in levels.T], axis=-1)


def _levels(rng: np.random.Generator, n: int) -> Array:
    """Levels (n,) drawn from `_LEVELS`, each held for a while."""
    out: list[float] = []
    while len(out) < n:
        out += [float(rng.choice(_LEVELS))] * int(rng.choice(_HOLD_STEPS))
    return np.array(out[:n])


def worst(scores: Sequence[PairScore], own: bool) -> float:
    """Largest relative error of own or of cross pairs; NaN where none is scored."""
    found = [s.relative for s in scores if s.own is own and np.isfinite(s.relative)]
    return max(found, default=float("nan"))
