"""What another schedule would have done on a past day (paper, eq:effect), and what a model says of its record.

The free response of a past day is known, measured minus forced by the levels applied, so nothing is forecast: the other
levels' forced response takes the place of theirs, and weather, sun and people stay as they were.

What a model says of its own record stands first: rollouts, the step response to full actuation, and their picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    NORMAL_95,
    Array,
    Boundary,
    FreeForecast,
    Names,
    Observation,
    Record,
    energy_kWh,
    steps_in,
)
from thermoforce_mpc.data.dataframes import seconds_at, table
from thermoforce_mpc.data.names import check_same_building, numbers
from thermoforce_mpc.data.series import WEATHER, bridged, interpolated, lagged, rms
from thermoforce_mpc.data.superposition import control_free
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.model.forced_state import followed
from thermoforce_mpc.model.free_response.checks import LEVELS
from thermoforce_mpc.model.free_response.rc import RcFreeResponse
from thermoforce_mpc.model.machine.change import Share
from thermoforce_mpc.model.machine.other_load import own_W
from thermoforce_mpc.model.operator.parameters import OperatorParameters, feature_matrix
from thermoforce_mpc.model.predictor import PredictionContext, Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.dates import label_dates, on_dates
from thermoforce_mpc.whatif.water import EMITTERS, VALVES_SD, emitted, of_water, others_by

if TYPE_CHECKING:
    from matplotlib.axes import Axes


PLOT_NAME = "identification.png"
# Start of the first rollout and length of each, h.
_ROLLOUT_H = 12.0


@dataclass(frozen=True)
class Rollouts:
    """Predictions of a record: `predicted_C` (Z, n + 1) °C, NaN before the first rollout, and their RMSE (Z,), K."""

    predicted_C: Array
    rmse_K: Array


def rollouts(model: ThermalModel, record: Record) -> Rollouts | None:
    """Predict a record by consecutive rollouts of 12 h, each from the record before it with the measured weather.

    Sun that the model found on a sensor is taken off the record. Gaps in the record's weather and levels are bridged.
    Returns None if a zone has no linear free part (identified from pairs only) or the record is too short.
    """
    n = steps_in(_ROLLOUT_H * HOUR_S, record.step_s)
    free_models = [free for free in model.free if free is not None]
    if len(free_models) < len(model.free) or record.n_steps < 2 * n:
        return None
    record, _ = bridged(model.in_rooms(record))
    predictor = Predictor(model.operator, [RcFreeResponse(free) for free in free_models])
    predicted = np.full(record.T_zone_C.shape, np.nan)
    for start in range(n, record.n_steps, n):
        stop = min(start + n, record.n_steps)
        context = predictor.context(Observation(record.slice(0, start), Boundary.measured(record.slice(start, stop))))
        predicted[:, start + 1 : stop + 1] = context.predict(record.u[:, start:stop]).total_C
    error = predicted - record.T_zone_C
    return Rollouts(predicted, np.sqrt(np.nanmean(error**2, axis=1)))


def plot_identification(path: Path, model: ThermalModel, record: Record) -> None:
    """Write the figure: record and rollouts of each zone, levels, and the step responses with their 90 % bands.

    The step responses are a matrix, zones by actuators; an empty cell is a pair without an effect.
    """
    from matplotlib.figure import Figure

    zones, actuators, _ = model.operator.shape
    figure = Figure(figsize=(max(9.0, 3.0 * actuators), 5.0 + 3.0 * zones), layout="constrained")
    upper, lower = list(figure.subfigures(2, 1, squeeze=False, height_ratios=[3 * zones + 1, 3 * zones])[:, 0])
    courses = upper.subplots(zones + 1, 1, height_ratios=[3] * zones + [1], squeeze=False, sharex=True)[:, 0]
    at = on_dates(record.time_s, record.origin)
    predictions, rooms = rollouts(model, record), model.in_rooms(record)
    measured = "measured" if rooms is record else "measured, without the sun on the sensor"
    for z, axes in enumerate(courses[:-1]):
        title = "Measured and predicted zone temperature" if zones == 1 else model.operator.zones[z]
        axes.set_title(title, loc="left", pad=22.0)  # above the legend
        axes.plot(at, rooms.T_zone_C[z], color="black", linewidth=1.2, label=measured)
        if predictions is not None:
            label = f"rollouts of {_ROLLOUT_H:g} h, measured weather; RMSE {predictions.rmse_K[z]:.2f} K"
            axes.plot(at, predictions.predicted_C[z], color="tab:red", linewidth=1.2, label=label)
        axes.set_ylabel("zone temperature, °C" if zones == 1 else "°C")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, frameon=False, borderaxespad=0.2)
    for a, name in enumerate(model.operator.actuators):
        courses[-1].stairs(record.u[a], at, color=f"C{a}", fill=actuators == 1, alpha=0.5, label=name)
    if actuators > 1:
        courses[-1].legend(loc="upper left", ncols=actuators, frameon=False, fontsize="small")
    courses[-1].set_ylabel("level u")
    courses[-1].set_ylim(1.05 * float(np.nanmin(record.u, initial=0.0)), 1.05)
    label_dates(courses[-1], at, record.origin)
    cells = lower.subplots(zones, actuators, squeeze=False, sharex=True)
    for z, a, pair in model.operator.each():
        _plot_answer(cells[z, a], model, z, a, pair)
    for z in range(zones):
        for a in range(actuators):
            if model.operator.pairs[z][a] is None:
                cells[z, a].set_title(f"{model.operator.actuators[a]} on {model.operator.zones[z]}", loc="left")
                cells[z, a].text(0.5, 0.5, "no effect", ha="center", transform=cells[z, a].transAxes)
        cells[z, 0].set_ylabel("change of the zone temperature, K" if zones == 1 else "change, K")
    for axes in cells[-1]:
        axes.set_xlabel("hours since the step")
    figure.savefig(path, dpi=120, metadata={"Software": None})


def _plot_answer(axes: Axes, model: ThermalModel, z: int, a: int, pair: OperatorParameters) -> None:
    """Step response of a pair to full level."""
    operator = model.operator
    hours, answer = step_answer(pair)
    full = f" ({text})" if (text := full_level_of(pair)) else ""
    if model.names.single:
        axes.set_title(f"Step response to full level{full}", loc="left")
    else:
        axes.set_title(f"{operator.actuators[a]} on {operator.zones[z]}{full}", loc="left")
    axes.axhline(0.0, color="black", linewidth=0.5)
    axes.plot(hours, answer, color="tab:red", label="expected")
    mean, sd = step_response_of(model, z, a)
    if mean.size:
        at = np.array([0.0, *STEP_RESPONSE_H])
        low, high = mean - NORMAL_95 * sd, mean + NORMAL_95 * sd
        axes.fill_between(at, low, high, color="tab:red", alpha=0.2, linewidth=0, label="90 % band")
        axes.plot(at, mean, "o", color="tab:red", markersize=3)
    if model.names.single:
        axes.legend(loc="best", frameon=False)


def step_answer(pair: OperatorParameters) -> tuple[Array, Array]:
    """Return hours since a step to full level and the expected answer of a pair, K, from 0 to the last of
    `STEP_RESPONSE_H`.
    """
    steps = round(STEP_RESPONSE_H[-1] * HOUR_S / pair.step_s)
    hours = np.arange(steps + 1) * pair.step_s / HOUR_S
    return np.asarray(hours, dtype=np.float64), np.concatenate([[0.0], np.cumsum(pair.impulse(steps))])


def full_level_of(pair: OperatorParameters) -> str:
    """Return the heat of full level in words; empty where it is not known."""
    return "" if pair.heat_input.law is None else f"{pair.heat_input.reference_W / 1000:.1f} kW"


def step_response_of(model: ThermalModel, z: int, a: int) -> tuple[Array, Array]:
    """Return the step response of a pair at 0 h and `STEP_RESPONSE_H` and its standard deviation, K; empty: unknown."""
    card, suffix = model.card_of(z, a)
    means = [card.uncertainty.get(f"step_response_{h}h_K{suffix}") for h in STEP_RESPONSE_H]
    sds = [card.uncertainty.get(f"step_response_{h}h_sd_K{suffix}") for h in STEP_RESPONSE_H]
    if any(value is None for value in (*means, *sds)):
        return np.empty(0), np.empty(0)
    sign = model.operator.of_actuator(a).sign if model.operator.home[a] == z else 1
    return sign * np.array([0.0, *means], dtype=np.float64), np.array([0.0, *sds], dtype=np.float64)


# Least share of a day's steps with energy and outdoor temperature for it to count, and with sun, where that is metered:
# a sensor may be silent at night.
_LEAST_MEASURED, _LEAST_SUN = 0.9, 0.25
# Time constants of the weather's low passes, h; 0: the day's own mean.
LAGS_H: tuple[float, ...] = (0.0, 12.0, 24.0, 48.0)


@dataclass(frozen=True)
class Days:
    """Whole days of a record; `left_out` have gaps.

    `number` (n,): day since the record's time 0. `energy_kWh` (n,): of all machines, or the heat that was moved.
    `T_out_C`, `solar_W_m2` (lags, n): daily means of °C and W/m² through a low pass of each of `LAGS_H`. `T_zone_C` (Z,
    n): daily means, °C. `weekend` (n,): False throughout where the record has no date.
    """

    number: NDArray[np.int64]
    energy_kWh: Array
    T_out_C: Array
    solar_W_m2: Array
    T_zone_C: Array
    weekend: NDArray[np.bool_]
    left_out: int

    @property
    def n(self) -> int:
        """Number of days."""
        return int(self.number.size)


def days_of(record: Record, meter: str, name: str, past: Record | None = None) -> Days:
    """The whole days of `record`, midnight to midnight; the energy is that of `meter`, 'power_W' or 'heat_W'.

    `past`: what was recorded just before, from which the weather's low passes start. Raises `DataError`, with `name`,
    where the step does not divide a day or no whole day is there.
    """
    per_day = DAY_S / record.step_s
    if abs(per_day - round(per_day)) > 1e-6:
        raise DataError(f"{name}: a step of {record.step_s:g} s does not divide a day; resample the record")
    k = round(per_day)
    low_out, low_sun = _low_passes(record, past)
    first = int(np.ceil(record.time_s[0] / DAY_S - 1e-9))
    last = int(np.floor(record.time_s[-1] / DAY_S + 1e-9))
    offset = record.nearest(first * DAY_S)
    # Heat that is taken out of a zone is negative in a record: cold that was used is energy like heat.
    total = (record.power_W if meter == "power_W" else np.abs(record.heat_W)).sum(axis=0)
    total = np.where(np.isfinite(total), total, np.nan)
    measured = np.isfinite(total) & np.isfinite(record.T_out_C[:-1])
    sunny = np.isfinite(record.solar_W_m2[:-1])
    least_sun = _LEAST_SUN if sunny.any() else 0.0
    rows: list[tuple[int, float, Array, Array, Array]] = []
    left_out = 0
    for day in range(first, last):
        at = slice(offset + (day - first) * k, offset + (day - first + 1) * k)
        if measured[at].mean() < _LEAST_MEASURED or sunny[at].mean() < least_sun:
            left_out += 1
            continue
        energy = energy_kWh(float(np.nanmean(total[at])), DAY_S)
        zone = np.array([np.nanmean(row[at]) if np.isfinite(row[at]).any() else np.nan for row in record.T_zone_C])
        rows.append((day, energy, low_out[:, at].mean(axis=1), low_sun[:, at].mean(axis=1), zone))
    if not rows:
        raise DataError(
            f"{name}: no whole day from midnight to midnight has energy, outdoor temperature and, where it is metered, "
            f"sun ({left_out} have gaps)"
        )
    number, energies, outs, suns, zones = zip(*rows, strict=True)
    weekend = np.zeros(len(rows), dtype=bool)
    if record.origin is not None:
        import pandas as pd

        # At noon, since days begin an hour before or after midnight where the clock has moved since 1 January.
        weekend = np.array([(record.origin + pd.Timedelta(days=day, hours=12)).weekday() >= 5 for day in number])
    return Days(
        np.array(number), np.array(energies), np.array(outs).T, np.array(suns).T, np.array(zones).T, weekend, left_out
    )  # fmt: skip


def _low_passes(record: Record, past: Record | None) -> tuple[Array, Array]:
    """Outdoor temperature and irradiance through each low pass, (lags, n + 1)."""
    filtered = []
    for name in ("T_out_C", "solar_W_m2"):
        values = interpolated(getattr(record, name))
        before = np.empty(0)
        if past is not None and 0.0 <= record.time_s[0] - past.time_s[-1] <= DAY_S and past.step_s == record.step_s:
            before = interpolated(getattr(past, name))
        joined = np.concatenate([before, values])
        rows = []
        for lag in LAGS_H:
            if lag == 0.0:
                rows.append(values)
                continue
            pole = float(np.exp(-record.step_s / HOUR_S / lag))
            start = float(joined[: steps_in(DAY_S, record.step_s)].mean())
            rows.append(lagged(joined, pole, start)[1 + before.size :])
        filtered.append(np.array(rows))
    return filtered[0], filtered[1]


TOLD = 0.4
"""An energy is told as a figure where its 90 % band is no wider than this share of it."""
# Error of a change of power, as a share, up to which its law alone counts.
_EXACT = 0.1
# A level is held between off and full where it lies between these and stays within a range for an hour; a record in
# which a valve did so in a smaller share of the time that it was open does not tell what it takes then. Emitters of
# valves that only open and close are warm while they are open: valves held at 0.2 to 0.7 took 1.2 to 2.2 times the
# energy that the record's law says (`house:3rooms:101`, 28 November 2026); the band reaches to `_HELD` times.
_PART, _WITHIN, _SEEN, _HELD = (0.1, 0.9), 0.15, 0.05, 2.5
# What a level takes more per K by which a day of other levels makes its room colder, as a share, where water of several
# valves carries it, beside what its emitter takes, and its standard deviation: with 0.03 days without heat at night, or
# with levels of three hours later, come out right in the mean in eight houses (3.9 and 2.3 % root mean square; 5.0 and
# 2.2 % with 0, 9.4 and 4.0 % with 0.08; seeds 33021 and 33022 of `bench effects --mode operation`, 30 November 2026).
_COLDER = (0.03, 0.04)
# A valve that was open less than this share of a record says little of its heat: standard deviation of that, as a
# share. Where such valves of four drawn houses (seeds 33021, 33022) open every other hour with all others, laws say 12
# to 23 % too little.
_RARE, _RARE_SD = 0.05, 0.4
# Least days of a record that tell how far its law is off on one, and what it is with fewer. By judgement.
_LEAST_DAYS, _FEW_DAYS_SD = 6, 0.1


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
    context, stretch = _known_from(model, whole, first), whole.slice(first, first + n)
    emitters = _of_emitters(model, whole, first)

    @cache
    def told(m: int) -> _Told:
        rare = np.nanmean(record.u[model.layout.fed_by(m)], axis=1) < _RARE
        return _Told(model.power_change(m, record), *_beside_law(model, m, record, stretch), rare)

    measured_C = np.asarray(record.T_zone_C[:, first + 1 : first + n + 1])
    return [_under(model, record, levels, context, stretch, emitters, measured_C, told) for levels in each]


@dataclass(frozen=True)
class _Told:
    """What a record tells of the power of a machine: how much of a change by its law, see `_beside_law`, and which of
    its actuators (a,) hardly acted.
    """

    share: Share
    metered: float
    usual: float
    errors: float
    rare: NDArray[np.bool_]


def _under(
    model: ThermalModel,
    record: Record,
    levels: Array,
    context: PredictionContext,
    stretch: Record,
    emitters: Callable[[Array], tuple[Array, Array]],
    measured_C: Array,
    told: Callable[[int], _Told],
) -> Counterfactual:
    """A stretch under other levels."""
    applied = np.clip(stretch.u, model.operator.u_min[:, None], 1.0)
    if levels.ndim == 0:
        levels = np.full(applied.shape, levels)
    effect = context.effect(levels, applied)
    levels = levels if levels.ndim == 2 else levels[None]
    low, high = _certified_bounds(model, levels - applied, record.step_s)
    power_W, power_other_W = (
        model.powers_by_law(applied, stretch.T_out_C[:-1]),
        model.powers_by_law(levels, stretch.T_out_C[:-1]),
    )
    was, other = (energy_kWh(power.sum(axis=1), record.step_s) for power in (power_W, power_other_W))
    more, more_sd = emitters(levels)
    each = zip(was, other * more, other * more_sd, strict=True)
    energies = [_energy(model, m, told, stretch, levels, effect, *one) for m, one in enumerate(each)]
    was, other, energy_low, energy_high = np.array(energies).T
    unseen = [_never_held(model, m, record, levels) for m in range(len(model.machines))]
    energy_high = np.where(unseen, np.fmax(energy_high, _HELD * other), energy_high)
    return Counterfactual(
        time_s=stretch.time_s[:-1],
        origin=record.origin,
        names=record.names,
        u=applied,
        u_other=levels,
        measured_C=measured_C,
        effect_K=effect,
        sd_K=_identified_sd(model, levels - applied, record.step_s),
        certified_low_K=low,
        certified_high_K=high,
        energy_kWh=was,
        energy_other_kWh=other,
        energy_low_kWh=energy_low,
        energy_high_kWh=energy_high,
        beside_kWh=_beside_kWh(model, stretch),
        power_W=power_W,
        power_other_W=power_other_W,
    )


def _energy(
    model: ThermalModel,
    m: int,
    told: Callable[[int], _Told],
    stretch: Record,
    u: Array,
    effect_K: Array,
    was: float,
    other: float,
    emitters_sd: float,
) -> tuple[float, float, float, float]:
    """Energy of machine `m` as it was and under levels `u` (A, N) with its 90 % band, kWh.

    `was`, `other`: by the law of power, the latter with what emitters take more, known to `emitters_sd`; `effect_K` (Z,
    N): what the levels change. What the meter said more or less than the law of the stretch it says of the other levels
    too. Rooms that are colder take more from the water.
    """
    if not np.isfinite(other):
        return was, other, np.nan, np.nan
    of_record = told(m)
    metered, usual, errors, share = of_record.metered, of_record.usual, of_record.errors, of_record.share
    known = bool(np.isfinite(metered)) and was > 0.0
    # What the law lacks on all days goes with levels, and others may not have it; what it lacks on this one is weather.
    ratio = metered / was / usual if known else 1.0
    shift = metered - was * usual if known else 0.0
    fed = list(model.layout.fed_by(m))
    homes = [model.operator.home[a] for a in fed]
    weights: Array = u[fed] * (np.array(model.layout.weights) * of_water(model))[fed, None]
    warmer_K = float((weights * effect_K[homes]).sum() / max(float(weights.sum()), 1e-9))
    less, less_sd = _COLDER
    colder = float(np.clip(1.0 - less * warmer_K, 0.0, None))
    by_law, said = (other + shift) * colder, other * ratio * colder
    was = metered if known else was
    differs = others_by(stretch.u[fed], u[fed])
    several = VALVES_SD if weights.any() else 0.0
    opened: Array = (weights * np.maximum(u[fed] - stretch.u[fed], 0.0))[of_record.rare]
    of_rare = _RARE_SD * float(opened.sum() / max(float(weights.sum()), 1e-9))
    of_change, of_levels = share.sd * abs(said - was), float(np.hypot(several, errors)) * differs * said
    of_rooms = less_sd * warmer_K * other * ratio
    sd = float(np.linalg.norm([of_change, of_levels, of_rare * said, of_rooms, emitters_sd * ratio]))
    ends = [was + (said - was) * share.mean + sign * NORMAL_95 * sd for sign in (-1.0, 1.0)]
    ends += [said, by_law, said * usual]
    if share.spread > _EXACT:  # levels that follow the demand stand for it in the law
        over_K = stretch.T_zone_C[homes, 1:] - stretch.T_out_C[1:]
        asked = np.nanmean(over_K + effect_K[homes]) / max(float(np.nanmean(over_K)), 1.0)
        ends.append(was * max(float(asked), 0.0))
    return was, said, max(min(ends), 0.0), max(ends)


def _of_emitters(model: ThermalModel, whole: Record, first: int) -> Callable[[Array], tuple[Array, Array]]:
    """How much more machines (M,) take under other levels (A, N) from step `first` of a record on than their laws say
    beside the levels applied, and its standard deviation: emitters whose valves are less open take more from the water.
    """
    valves, stretch = of_water(model)[:, None] > 0.0, whole.slice(first, whole.n_steps)
    if not valves.any():
        none = np.ones(len(model.machines)), np.zeros(len(model.machines))
        return lambda other: none
    applied = np.clip(stretch.u, model.operator.u_min[:, None], 1.0)

    def of_heat(level: Array, heat: Array) -> Array:
        both = np.where(valves, heat, level), level
        W, by_level_W = (model.powers_by_law(u, stretch.T_out_C[:-1]).sum(axis=1) for u in both)
        return np.divide(W, by_level_W, out=np.ones(len(by_level_W)), where=by_level_W > 0.0)

    def more(emitters: float) -> Callable[[Array], Array]:
        past, warmth = emitted(whole.u[:, :first], whole.step_s, emitters)
        heat, _ = emitted(applied, whole.step_s, emitters, warmth)
        usual = (whole.u[:, :first].sum() + applied.sum()) / max(float(past.sum() + heat.sum()), 1e-9)
        as_it_was = of_heat(applied, usual * heat)

        def under(other: Array) -> Array:
            return of_heat(other, usual * emitted(other, whole.step_s, emitters, warmth)[0]) / as_it_was

        return under

    median, log_sd = EMITTERS
    likely, better = more(median), more(median * float(np.exp(log_sd)))

    def of_levels(other: Array) -> tuple[Array, Array]:
        mean = likely(other)
        return mean, np.abs(better(other) - mean)

    return of_levels


def _beside_law(model: ThermalModel, m: int, record: Record, stretch: Record) -> tuple[float, float, float]:
    """What the meter said of a stretch, kWh, NaN where it was not read; what it says of all days, as a multiple of the
    law, and the standard deviation of single days around it, as a share.
    """
    power = model.power[m]
    assert power is not None  # it has a law
    law_W = model.power_by_law_of(m, record)
    metered_W = own_W(record.power_W[m : m + 1], [power.foreign], record, of_days=True)[0]
    first = record.nearest(float(stretch.time_s[0]))
    part = metered_W[first : first + stretch.n_steps]
    read = np.isfinite(part).mean() >= _LEAST_MEASURED
    metered = energy_kWh(float(np.nanmean(part)), stretch.n_steps * record.step_s) if read else float("nan")
    n = steps_in(DAY_S, record.step_s)
    both = np.isfinite(law_W) & np.isfinite(metered_W)
    starts = [k for k in range(0, record.n_steps - n + 1, n) if both[k : k + n].mean() >= _LEAST_MEASURED]
    law, meter = (np.array([one[k : k + n][both[k : k + n]].mean() for k in starts]) for one in (law_W, metered_W))
    if len(starts) < _LEAST_DAYS or not law.sum() > 0.0 or not meter.sum() > 0.0:
        return metered, 1.0, _FEW_DAYS_SD
    usual = float(meter.sum() / law.sum())
    return metered, usual, float(rms(meter - usual * law) / meter.mean())


def _beside_kWh(model: ThermalModel, stretch: Record) -> Array:
    """What other loads on the meters of machines (M,) took in a stretch, kWh."""
    loads = [None if power is None else power.foreign for power in model.power]
    each = [0.0 if one is None else float(one(stretch.time_s[:-1], stretch.T_out_C[:-1]).sum()) for one in loads]
    return energy_kWh(np.array(each), stretch.step_s)


def _never_held(model: ThermalModel, m: int, record: Record, levels: Array) -> bool:
    """Whether valves of machine `m` are asked to be held between off and full, and hardly were in `record`."""
    fed = list(model.layout.fed_by(m))
    if len(fed) < 2:
        return False
    return any(held_between(levels[a], record.step_s) > _SEEN > held_between(record.u[a], record.step_s) for a in fed)


def held_between(u: Array, step_s: float) -> float:
    """In which share of the hours of `u` (n,), in which the level is not off, it is held between off and full."""
    n = min(max(2, round(HOUR_S / step_s)), u.size)
    hours = np.lib.stride_tricks.sliding_window_view(u, n)
    acting = np.nanmean(hours, axis=1) if np.isfinite(hours).any() else np.zeros(len(hours))
    held = (acting > _PART[0]) & (acting < _PART[1]) & (np.ptp(hours, axis=1) < _WITHIN)
    return float(held.sum() / max(np.count_nonzero(acting > _PART[0]), 1))


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
