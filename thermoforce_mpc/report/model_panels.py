"""What a run's model says: step responses, and what other levels would have done (paper, counterfactual query)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.regression import BAND, STEP_RESPONSE_H
from thermoforce_mpc.loop.closed_loop import RunResult, Sample
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.report.courses import RESOLUTION
from thermoforce_mpc.report.page import Json, exactly, rows_packed
from thermoforce_mpc.whatif.counterfactual import Counterfactual, counterfactual
from thermoforce_mpc.whatif.identified import full_level_of, step_answer, step_response_of


def answers_json(model: ThermalModel | None) -> list[list[Json | None]] | None:
    """Of each zone and actuator the answer to full level, K, and its 90 % band; None where there is no effect."""
    if model is None:
        return None
    zones, actuators, _ = model.operator.shape
    matrix: list[list[Json | None]] = [[None] * actuators for _ in range(zones)]
    for z, a, pair in model.operator.each():
        hours, answer = step_answer(pair)
        every = max(1, hours.size // 200)
        cell: Json = {"hours": _rounded(hours[::every]), "K": _rounded(answer[::every]), "full": full_level_of(pair)}
        mean, sd = step_response_of(model, z, a)
        if mean.size:
            band = {"mean": mean, "low": mean - BAND * sd, "high": mean + BAND * sd}
            cell |= {"at": [0, *STEP_RESPONSE_H], **{name: _rounded(values) for name, values in band.items()}}
        matrix[z][a] = cell
    return matrix


def _rounded(values: Array) -> Sequence[float]:
    return [round(float(value), 4) for value in values]


# A day is compared every `EVERY_H`, over `LENGTH_H`; the day before the first one is needed for the forced state.
EVERY_H, LENGTH_H, BEFORE_H = 6.0, 24.0, 24.0
# The forced state is that of the levels of so many days before.
MOST_PAST_DAYS = 10.0
# Bytes in the page, before base64 adds a third: of long runs and many zones fewer instants.
MOST_BYTES = 250_000
# Levels of all actuators that are compared.
LEVELS = {"off": 0.0, "half": 0.5, "full": 1.0}


def other_levels_json(result: RunResult, model: ThermalModel | None, layout: Layout) -> Json | None:
    """The day after every sixth hour as it would have been with all actuators off, at half and at full level.

    Where some actuators exclude each other there is only 'off'. None without a model of this building, or where
    the run is too short or too little was measured.
    """
    if model is None or model.names != result.names:
        return None
    levels = {"off": 0.0} if layout.exclusive else LEVELS

    def at(level: float, time_s: float) -> Counterfactual:
        start = round((time_s - record.time_s[0]) / record.step_s)
        stop = start + round(LENGTH_H * HOUR_S / record.step_s)
        recent = record.slice(max(0, start - round(MOST_PAST_DAYS * DAY_S / record.step_s)), stop)
        return counterfactual(model, recent, level, start=time_s, hours=LENGTH_H)

    def packed_rows(of_instants: list[Array]) -> list[Json]:
        return rows_packed(np.concatenate(of_instants, axis=-1), RESOLUTION["T"])

    try:
        record = record_of_run(result)
        instants = _instants(record, len(levels))
        days = [[at(level, time_s) for time_s in instants] for level in levels.values()]
    except DataError:  # a zone that was never measured, or a clock with gaps: there is nothing to compare with
        return None
    if not instants:
        return None
    return {
        "levels": list(levels),
        "time_s": exactly(np.array(instants)),
        "step_s": record.step_s,
        "n": days[0][0].effect_K.shape[-1],
        "T_other_C": [packed_rows([day.other_C for day in row]) for row in days],
        "sd_K": [packed_rows([day.sd_K for day in row]) for row in days],
        "energy_kWh": [[float(day.energy_other_kWh.sum()) for day in row] for row in days],
        "energy_applied_kWh": [float(day.energy_kWh.sum()) for day in days[0]],
    }


def _instants(record: Record, levels: int) -> list[float]:
    """Start of each day that is compared, s; none in a run shorter than a step."""
    if not record.n_steps:
        return []
    per_instant = 2 * 2 * levels * len(record.names.zones) * LENGTH_H * HOUR_S / record.step_s
    most = max(1, int(MOST_BYTES / per_instant))
    every = max(round(EVERY_H * HOUR_S / record.step_s), 1)
    first, n = round(BEFORE_H * HOUR_S / record.step_s), round(LENGTH_H * HOUR_S / record.step_s)
    at = np.arange(max(first, 1), record.n_steps - n + 1, every)
    # Hours whose levels nobody measured have nothing to compare with.
    at = np.array([i for i in at if np.isfinite(record.u[:, i : i + n]).all()], dtype=np.intp)
    return [float(record.time_s[i]) for i in at[:: -(-at.size // most) or 1]]


def record_of_run(result: RunResult) -> Record:
    """The record of a run's whole steps: temperatures at their ends, means in between; raises `DataError`."""
    start, step_s = result.start, 0.0
    ends: list[Sample] = []
    means: dict[str, list[Array]] = {"u_measured": [], "power_W": [], "heat_W": []}
    for step in result.steps:
        step_s = step_s or step.boundary.step_s
        weights = [sample.duration_s for sample in step.samples]
        if sum(weights) < step_s - 1e-3:  # the last step may be cut short
            continue
        ends.append(step.samples[-1])
        for name, values in means.items():
            values.append(np.average([getattr(sample, name) for sample in step.samples], axis=0, weights=weights))
    columns = {name: np.array(values).T for name, values in means.items()}
    return Record(
        time_s=np.array([start.time_s, *(end.start_s + end.duration_s for end in ends)]),
        T_zone_C=np.array([start.T_zone_C, *(end.T_zone_C for end in ends)]).T,
        T_out_C=np.array([start.T_out_C, *(end.T_out_C for end in ends)]),
        solar_W_m2=np.array([start.solar_W_m2, *(end.solar_W_m2 for end in ends)]),
        u=columns["u_measured"],
        power_W=columns["power_W"],
        heat_W=columns["heat_W"],
        names=result.names,
    )
