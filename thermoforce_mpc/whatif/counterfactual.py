"""What another schedule would have done on a past day (paper, eq:effect).

The free response of a past day is known, measured minus forced by the levels applied, so nothing is forecast: the other
levels' forced response takes the place of theirs, and weather, sun and people stay as they were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, NORMAL_95, Array, Boundary, FreeForecast, Names, Record
from thermoforce_mpc.data.dataframes import seconds_at, table
from thermoforce_mpc.data.names import check_same_building, numbers
from thermoforce_mpc.data.series import WEATHER, bridged, interpolated
from thermoforce_mpc.data.superposition import control_free
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.model.forced_state import followed
from thermoforce_mpc.model.free_response.checks import LEVELS
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.energy import StretchEnergy
from thermoforce_mpc.whatif.step_response import step_response_of

if TYPE_CHECKING:
    import pandas as pd


TOLD = 0.4
"""An energy is told as a figure where its 90 % band is no wider than this share of it."""


@dataclass(frozen=True)
class Counterfactual:
    """A past stretch of N steps as it was and as it would have been.

    `time_s` (N,): start of each step, counted from `origin` where the record has time stamps. `u`, `u_other` (A, N):
    levels applied and other levels. `measured_C` (Z, N): temperature at the end of each step, NaN where it was not
    measured. `effect_K` (Z, N): what the other levels change; `sd_K` its standard deviation by the identification, NaN
    where the model's card has none (the errors of all steps are taken to have one sign, so it is rather too wide);
    `certified_low_K`, `certified_high_K`: proven bounds in any weather and state. `energy_kWh`, `energy_other_kWh`
    (M,): what the meter said, and by the law of the model's power with what that missed on this day; the law alone
    where the meter was not read; both without `beside_kWh` (M,), what other loads on the meter took, as hot water.
    `power_W`, `power_other_W` (M, N): by the law, NaN, as the energies, where a machine has none, or heats and cools
    and feeds several actuators.
    `energy_low_kWh`, `energy_high_kWh` (M,): 90 % band of the latter, with the error of the law on days of the record.
    Where levels followed the rooms' demand the record does not tell what they do to power by themselves: the band then
    reaches from what the law of power says to what the rooms' temperatures ask for. Where valves of one machine are
    asked to be held between off and full, and never were, it reaches to what emitters that stay cold take.
    """

    time_s: Array
    origin: Any
    names: Names
    u: Array
    u_other: Array
    measured_C: Array
    effect_K: Array
    sd_K: Array
    certified_low_K: Array
    certified_high_K: Array
    energy_kWh: Array
    energy_other_kWh: Array
    energy_low_kWh: Array
    energy_high_kWh: Array
    beside_kWh: Array
    power_W: Array
    power_other_W: Array

    @property
    def other_C(self) -> Array:
        """Temperature under the other levels at the end of each step (Z, N), °C."""
        return np.asarray(self.measured_C + self.effect_K)

    @property
    def half_K(self) -> Array:
        """Half width of the 90 % band of `other_C` (Z, N), K; NaN where the card has no uncertainty."""
        return np.asarray(NORMAL_95 * self.sd_K)

    def to_dataframe(self) -> pd.DataFrame:
        """One row per step, at its start: both levels; at its end both temperatures, 90 % band, effect, bounds."""
        columns = self.names.columns(u=self.u, T_zone_C=self.measured_C)
        parts = {
            "u_other": ("u", self.u_other),
            "T_other_C": ("T_zone_C", self.other_C),
            "T_other_low_C": ("T_zone_C", self.other_C - self.half_K),
            "T_other_high_C": ("T_zone_C", self.other_C + self.half_K),
            "effect_K": ("T_zone_C", self.effect_K),
            "certified_low_K": ("T_zone_C", self.certified_low_K),
            "certified_high_K": ("T_zone_C", self.certified_high_K),
        }
        for name, (like, rows) in parts.items():
            for k, values in enumerate(rows):
                columns[self.names.label(like, k).replace(like, name, 1)] = values
        return table(self.time_s, self.origin, **columns)


def counterfactual(
    model: ThermalModel, record: Record, u: Array | float, *, start: pd.Timestamp | str | float, hours: float = 24.0
) -> Counterfactual:
    """What the levels `u` would have changed in `record` from `start` on.

    Args:
        model: of this building.
        record: what was measured, a day or more before `start` and over the stretch in question.
        u: other levels in [0, 1] (A, N), (N,) for one actuator, or one level for all.
        start: time stamp, or seconds as in the record; the nearest boundary of the record counts.
        hours: length of the stretch where `u` is one level.

    Raises:
        DataError: another building, the stretch is not inside the record, a level was not measured in it, a zone never
            was, or `u` has another shape or leaves [0, 1].
    """
    return counterfactuals(model, record, [u], start=start, hours=hours)[0]


def counterfactuals(
    model: ThermalModel,
    record: Record,
    several: Sequence[Array | float],
    *,
    start: pd.Timestamp | str | float,
    hours: float = 24.0,
) -> list[Counterfactual]:
    """`counterfactual` of `several` levels over one stretch, whose past is worked out once."""
    check_kind(model, ThermalModel, "model")
    check_kind(record, Record, "record")
    check_same_building("the model", model.names, "the record", record.names)
    each = [numbers(one, "levels (u)") for one in several]
    if not math.isfinite(hours):
        raise DataError(f"hours is {hours}: give the length of the stretch")
    lengths = {one.shape[-1] if one.ndim else round(hours * HOUR_S / record.step_s) for one in each}
    if len(lengths) != 1:
        raise DataError(f"levels of {sorted(lengths)} steps: all are of one stretch")
    (n,) = lengths
    actuators = len(record.names.actuators)
    for one in each:
        if one.shape not in ((), (actuators, n), (n,) if actuators == 1 else ()):
            raise DataError(f"levels (u) have shape {one.shape}, expected ({actuators}, {n}), or one level")
    first = _boundary(record, start)
    if not 0 < first <= record.n_steps - n or n < 1:
        stamps = record.stamps()
        raise DataError(
            f"{n} steps from {start} on are not inside the record, which goes from {stamps[0]} to {stamps[-1]}"
        )
    for a, unknown in enumerate(~np.isfinite(record.u[:, first : first + n])):
        if unknown.any():
            raise DataError(
                f"{record.names.label('u', a)} was not measured in {unknown.sum()} of the {n} steps from {start} on: "
                "there is nothing to compare with; choose a stretch in which it was"
            )
    whole, _ = bridged(model.own_heat(record.slice(0, first + n)))
    context, energy = _known_from(model, whole, first), StretchEnergy(model, record, whole, first)
    measured_C = np.asarray(record.T_zone_C[:, first + 1 : first + n + 1])
    return [_under(levels, context, energy, measured_C) for levels in each]


def _under(levels: Array, context: PredictionContext, energy: StretchEnergy, measured_C: Array) -> Counterfactual:
    """The stretch of `energy`, in which zones read `measured_C` (Z, N), under other levels."""
    model, stretch, applied = energy.model, energy.stretch, energy.applied
    if levels.ndim == 0:
        levels = np.full(applied.shape, levels)
    effect = context.effect(levels, applied)
    levels = levels if levels.ndim == 2 else levels[None]
    low, high = _certified_bounds(model, levels - applied, stretch.step_s)
    energies = energy.under(levels, effect)
    return Counterfactual(
        time_s=stretch.time_s[:-1],
        origin=stretch.origin,
        names=stretch.names,
        u=applied,
        u_other=levels,
        measured_C=measured_C,
        effect_K=effect,
        sd_K=_identified_sd(model, levels - applied, stretch.step_s),
        certified_low_K=low,
        certified_high_K=high,
        energy_kWh=energies.was_kWh,
        energy_other_kWh=energies.other_kWh,
        energy_low_kWh=energies.low_kWh,
        energy_high_kWh=energies.high_kWh,
        beside_kWh=energy.beside_kWh,
        power_W=energies.power_W,
        power_other_W=energies.power_other_W,
    )


def _known_from(model: ThermalModel, whole: Record, first: int) -> PredictionContext:
    """The instant `first` of a record without gaps, with the free response that followed in the place of a forecast."""
    forced_K = followed(model.operator, None, whole).forced_K
    free_C = control_free(whole.T_zone_C, forced_K.sum(axis=(1, 3)))
    for zone, row in zip(whole.names.zones, free_C, strict=True):
        if not np.isfinite(row).any():
            raise DataError(f"the temperature of zone '{zone}' was never measured: nothing to compare with")
    filled = np.array([interpolated(row) for row in free_C])
    boundary = Boundary.measured(whole.slice(first, whole.n_steps))
    boundary.check(*WEATHER)
    return PredictionContext(
        operator=model.operator.resampled(whole.step_s),
        forced_K=forced_K[:, :, first],
        free=FreeForecast(LEVELS, np.repeat(filled[None, :, first + 1 :], LEVELS.size, axis=0), "as recorded"),
        features=feature_matrix(
            filled[:, first:-1], boundary.T_out_C[:-1], boundary.solar_W_m2[:-1], boundary.time_s[:-1]
        ),
        boundary=boundary,
        names=whole.names,
    )


def _boundary(record: Record, start: pd.Timestamp | str | float) -> int:
    """The boundary of the record nearest to `start`; raises `DataError` for a time that cannot be read."""
    if not isinstance(start, int | float | np.number):
        if record.origin is None:
            raise DataError(f"start is '{start}', but the record has no time stamps: give seconds")
        start = seconds_at(record.origin, start, "start")
    return record.nearest(start)


def _certified_bounds(model: ThermalModel, change: Array, step_s: float) -> tuple[Array, Array]:
    """Proven bounds of the effect of `change` (A, N) of the levels on all zones, each (Z, N), K."""
    n = change.shape[1]
    operator = model.operator.resampled(step_s)
    low, high = np.zeros((len(operator.zones), n)), np.zeros((len(operator.zones), n))
    proofs = operator.certificates(n_steps=n)
    for z, a, _ in operator.each():
        proof = proofs[operator.zones[z], operator.actuators[a]]
        least, most = np.array(proof.effect_low_K), np.array(proof.effect_high_K)
        more, less = np.maximum(change[a], 0.0), np.maximum(-change[a], 0.0)
        low[z] += np.convolve(more, least)[:n] - np.convolve(less, most)[:n]
        high[z] += np.convolve(more, most)[:n] - np.convolve(less, least)[:n]
    return low, high


def _identified_sd(model: ThermalModel, change: Array, step_s: float) -> Array:
    """Standard deviation (Z, N), K, of the effect of `change` (A, N): that of each step's own effect, all added up."""
    n = change.shape[1]
    operator = model.operator.resampled(step_s)
    out = np.zeros((len(operator.zones), n))
    lag_h = (np.arange(n) + 1.0) * step_s / HOUR_S
    for z, a, pair in operator.each():
        mean, sd = step_response_of(model, z, a)
        if not mean.size:
            return np.full(out.shape, np.nan)
        relative = sd[1:] / np.maximum(np.abs(mean[1:]), 1e-9)
        of_lag = np.interp(lag_h, STEP_RESPONSE_H, relative) * np.abs(pair.impulse(n))
        out[z] += np.convolve(np.abs(change[a]), of_lag)[:n]
    return out
