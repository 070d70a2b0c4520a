"""What the page of a run shows, as arrays: courses with their costs, decisions and plans step by step, and its model.

The model's panels: step responses, and what other levels would have done (paper, counterfactual query).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, NORMAL_95, Array, Layout, PlanStatus, Record, energy_kWh, steps_in
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.loop.closed_loop import RunResult, Sample, StepRecord, in_force
from thermoforce_mpc.loop.inputs import price_paid
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.report.page import Json, exactly, packed, rows_packed, smooth
from thermoforce_mpc.whatif.counterfactual import Counterfactual, counterfactuals
from thermoforce_mpc.whatif.step_response import full_level_of, step_answer, step_response_of

# Bytes of the courses of all runs of a page, before base64 adds a third; of more, consecutive blocks are averaged.
_MOST_COURSES_BYTES = 800_000
# Coarsest roundings: K, W, level, W/m², price and cost per kWh and m².
RESOLUTION = {"T": 0.002, "W": 5.0, "u": 1e-4, "sun": 0.1, "price": 1e-4, "cost": 1e-4, "Kh": 0.002}
# Of each sample as it is.
_SAMPLED = (
    "start_s", "duration_s", "T_out_C", "solar_W_m2", "T_zone_C", "lower_C", "upper_C", "power_W", "price_per_kWh",
)  # fmt: skip


@dataclass(frozen=True)
class RunCourse:
    """All n blocks of a run, or means over several consecutive ones.

    `start_s`, `duration_s`, `T_out_C`, `solar_W_m2` (n,); `T_zone_C`, `lower_C`, `upper_C` (Z, n), `u` (A, n) and
    `power_W`, `price_per_kWh` (M, n) as in `Sample`. `cost` (n,) per m² and `discomfort_Kh` (Z, n) are those until the
    end of each block. `band_C` (2, A, n): heating and cooling set-point given to the plant's own loops, °C, NaN where
    levels were. `averaged`: number of blocks taken together. `scaled`: what the cost by the meters was multiplied by so
    that it ends at the plant's own bill, where a machine is billed in two carriers; else 1.
    """

    start_s: Array
    duration_s: Array
    T_out_C: Array
    solar_W_m2: Array
    T_zone_C: Array
    lower_C: Array
    upper_C: Array
    u: Array
    power_W: Array
    price_per_kWh: Array
    cost: Array
    discomfort_Kh: Array
    band_C: Array
    averaged: int
    scaled: float = 1.0

    def to_json(self) -> Json:
        """All of it, packed."""
        of = RESOLUTION
        return {
            "T_out_C": packed(self.T_out_C, of["T"]),
            "solar_W_m2": packed(self.solar_W_m2, of["sun"]),
            "lower_C": rows_packed(self.lower_C, of["T"]),
            "upper_C": rows_packed(self.upper_C, of["T"]),
            "price_per_kWh": rows_packed(self.price_per_kWh, of["price"]),
            "band_C": None if np.isnan(self.band_C).all() else [rows_packed(side, of["T"]) for side in self.band_C],
            **self.own_json(),
        }

    def own_json(self) -> Json:
        """What differs from one controller to the next."""
        of = RESOLUTION
        return {
            "start_s": exactly(self.start_s),
            "duration_s": exactly(self.duration_s),
            "T_zone_C": rows_packed(self.T_zone_C, of["T"]),
            "u": rows_packed(self.u, of["u"]),
            "power_W": rows_packed(self.power_W, of["W"]),
            "cost": packed(self.cost, of["cost"]),
            "discomfort_Kh": rows_packed(self.discomfort_Kh, of["Kh"]),
        }


def most_blocks(layout: Layout, runs: int) -> int:
    """How many blocks of each of `runs` runs a page has room for."""
    Z, A, M = len(layout.names.zones), len(layout.names.actuators), len(layout.names.machines)
    shared = 2 + 2 * Z + 2 * A + M
    own = 2 * Z + A + M + 1
    return _MOST_COURSES_BYTES // (2 * (shared + runs * own) + 16 * runs)


def course_of(result: RunResult, layout: Layout, area_m2: float, most: int) -> RunCourse:
    """The course of a run, of at most `most` blocks.

    Cost is that of the mean power of each block at the price in force, discomfort that of straight lines between the
    temperatures at the ends of blocks: both are near to the KPIs, which are of samples every 30 s. Where a machine's
    heating has a price of its own, its meter adds gas and the fan's electricity: the cost is then scaled to the KPI.
    """
    samples: list[Sample] = []
    heating_price: list[Array] = []
    bands: list[Array] = []
    for step in result.steps:
        for k, sample in enumerate(step.samples):
            samples.append(sample)
            heating = step.boundary.heating_price_per_kWh
            heating_price.append(heating[:, in_force(step.boundary, sample.start_s)].copy())  # not the whole forecast
            bands.append(_band_C(step, k))
    columns = {name: np.array([getattr(s, name) for s in samples], dtype=np.float64).T for name in _SAMPLED}
    columns["u"] = np.array([sample.u_measured for sample in samples], dtype=np.float64).T
    price = price_paid(columns["u"], columns["price_per_kWh"], np.array(heating_price).T, layout)
    # A machine that is not metered counts for nothing, and does not hide the others.
    paid = energy_kWh(columns["power_W"], columns["duration_s"]) * price
    spent = np.where(np.isfinite(paid), paid, 0.0).sum(axis=0) / area_m2
    before_C = np.column_stack([result.start.T_zone_C, columns["T_zone_C"][:, :-1]])
    outside = [excess(T_C, columns["lower_C"], columns["upper_C"]) for T_C in (before_C, columns["T_zone_C"])]
    discomfort = 0.5 * (outside[0] + outside[1]) * columns["duration_s"] / HOUR_S
    cost = np.nancumsum(spent)
    bill = result.kpis.get("cost_tot", np.nan)
    two_carriers = not np.array_equal(np.array(heating_price).T, columns["price_per_kWh"])
    scaled = float(bill / cost[-1]) if two_carriers and bill > 0 and cost[-1] > 0 else 1.0
    columns |= {"cost": scaled * cost, "discomfort_Kh": np.nancumsum(discomfort, axis=1)}
    course = RunCourse(averaged=1, scaled=scaled, band_C=np.array(bands).transpose(2, 1, 0), **columns)
    return _averaged(course, -(-course.start_s.size // most))


def _band_C(step: StepRecord, k: int) -> Array:
    """Heating and cooling set-point of each actuator in the block number `k` of a step (A, 2), °C."""
    nothing = (np.nan, np.nan)
    refused = bool(step.refused) or k >= len(step.plan.blocks)
    bands = (None,) * len(step.boundary.names.actuators) if refused else step.plan.blocks[k].command
    return np.array([band if isinstance(band, tuple) else nothing for band in bands], dtype=np.float64)


def _averaged(course: RunCourse, together: int) -> RunCourse:
    """The course with `together` blocks taken as one: means of what acts, the last of what is sampled."""
    if together <= 1:
        return course
    first = np.arange(0, course.start_s.size, together)
    last = np.append(first[1:], course.start_s.size) - 1
    weight = np.add.reduceat(course.duration_s, first)

    def mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values * course.duration_s, first, axis=-1) / weight)

    def at(places: NDArray[np.intp], *names: str) -> dict[str, Array]:
        return {name: getattr(course, name)[..., places] for name in names}

    sampled = at(last, "T_out_C", "solar_W_m2", "T_zone_C", "cost", "discomfort_Kh")
    means = {name: mean(getattr(course, name)) for name in ("u", "power_W", "price_per_kWh")}
    begins = at(first, "start_s", "lower_C", "upper_C", "band_C")
    parts: dict[str, Any] = {**begins, **sampled, **means}
    return replace(course, duration_s=weight, averaged=together, **parts)


# Decisions of this many steps are in the page; of longer runs every other step, every fourth, ….
MOST_STEPS = 4_000
# Statuses in the order of the ladder, from the plan as wanted to what acts where nothing else can.
LADDER = tuple(PlanStatus)
_FIRST = ("T_free_C", "T_free_low_C", "T_free_high_C", "T_forced_K")


def _shown(step: StepRecord) -> dict[str, Any]:
    """What the page shows of a step: a step itself, with its plan and forecast, is many times larger."""
    plan, nothing = step.plan, np.full(len(step.boundary.names.zones), np.nan)
    return {
        "time_s": step.time_s,
        "step_s": step.boundary.step_s,
        "T_zone_C": step.T_zone_C,
        "T_free_now_C": plan.T_free_now_C,
        **{name: getattr(plan, name)[:, 0] if plan.u.size else nothing for name in _FIRST},
        "status": LADDER.index(plan.status),
        "acting": [LADDER.index(status) for status in step.acting],
        "texts": (plan.why, step.refused, "; ".join(step.notes), plan.solver_status),
        "iterations": plan.iterations,
        "plan_ms": 1e3 * step.plan_seconds,
        "parts_s": plan.seconds,
    }


def thinning(result: RunResult) -> int:
    """Of how many decisions one is shown, so that there are at most `MOST_STEPS`: 1, 2, 4, …"""
    every = 1
    while len(result.steps) > every * MOST_STEPS:
        every *= 2
    return every


def decisions_json(result: RunResult) -> Json:
    """Status, reason, solver and first predicted step of each decision, one of a kind after the other."""
    every = thinning(result)
    shown = [_shown(step) for step in islice(result.steps, 0, None, every)]
    columns = {name: [row[name] for row in shown] for name in shown[0]}
    number_of: dict[str, int] = {}
    numbers = [[number_of.setdefault(text, len(number_of)) for text in texts] for texts in columns["texts"]]
    why, refused, notes, solver = (list(column) for column in zip(*numbers, strict=True))
    parts = dict.fromkeys(part for seconds in columns["parts_s"] for part in seconds)
    parts_ms = {part: [1e3 * seconds.get(part, np.nan) for seconds in columns["parts_s"]] for part in parts}
    return {
        "every": every,
        "time_s": exactly(np.array(columns["time_s"])),
        "step_s": exactly(np.array(columns["step_s"])),
        **{
            name: rows_packed(np.array(columns[name]).T, RESOLUTION["T"])
            for name in ("T_zone_C", "T_free_now_C", *_FIRST)
        },
        "statuses": [status.value for status in LADDER],
        "status": columns["status"],
        "acting": list(zip(*columns["acting"], strict=True)),
        "why": why,
        "refused": refused,
        "notes": notes,
        "solver": solver,
        "iterations": columns["iterations"],
        "plan_ms": packed(np.array(columns["plan_ms"]), 0.1),
        "parts_ms": {part: packed(np.array(ms), 0.1) for part, ms in parts_ms.items()},
        "texts": list(number_of),
    }


# Bytes of all plans in the page, before base64 adds a third; more are thinned to every other step, every fourth, ….
_MOST_PLANS_BYTES = 1_900_000
# Planned temperatures are rounded to this, K; beyond the second, large changes would cost too much of it.
FINEST_K, _COARSEST_K = 0.01, 0.05
# Rounding of planned levels, which a byte holds.
_LEVEL = 0.01
TEMPERATURES = ("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C")


def plans_json(result: RunResult, layout: Layout, area_m2: float) -> Json | None:
    """The planned courses over the instants of a run, thinned to `_MOST_PLANS_BYTES`; None where nothing was planned.

    All plans have the length of the longest; what a shorter one does not know is NaN.
    """
    n = max((step.plan.u.shape[-1] for step in result.steps), default=0)
    if not n:
        return None
    Z, A = len(layout.names.zones), len(layout.names.actuators)
    # A byte of each temperature and level, two of the cost. All plans are of instants whose decisions are shown.
    every = thinning(result)
    while len(result.steps) / every * (4 * Z + A + 2) * n > _MOST_PLANS_BYTES:
        every *= 2
    times, lengths, plans, last_boundary = [], [], [], result.steps[-1].boundary
    for step in islice(result.steps, 0, None, every):
        times.append(step.time_s)
        lengths.append(step.boundary.step_s)
        plans.append(_courses(step, layout, area_m2))
        last_boundary = step.boundary

    def over(name: str, rows: int) -> Array:
        """Rows of each kept plan (rows, P, n)."""
        values = np.full((rows, len(plans), n), np.nan)
        for p, plan in enumerate(plans):
            if name in plan:
                values[:, p, : plan[name].shape[-1]] = plan[name]
        return values

    return {
        "every": every,
        "n": n,
        "time_s": exactly(np.array(times)),
        "step_s": exactly(np.array(lengths)),
        "known": [bool(plan) for plan in plans],
        **{name: [smooth(row, FINEST_K, _COARSEST_K) for row in over(name, Z)] for name in TEMPERATURES},
        "u": rows_packed(over("u", A), _LEVEL, bits=8),
        "cost": packed(over("cost", 1)[0], RESOLUTION["cost"]),
        # The comfort bounds that the last plan looks ahead to: what was measured ends where it begins.
        "ahead": {
            "time_s": exactly(last_boundary.time_s[:n]),
            "lower_C": rows_packed(last_boundary.lower_C[:, :n], RESOLUTION["T"]),
            "upper_C": rows_packed(last_boundary.upper_C[:, :n], RESOLUTION["T"]),
        },
    }


def _courses(step: StepRecord, layout: Layout, area_m2: float) -> Mapping[str, Array]:
    """Planned courses of a step by name (rows, N); none where nothing was planned.

    `cost` (1, N): per m² until the end of each step, at the prices the plan was made with; NaN without power.
    """
    plan, boundary = step.plan, step.boundary
    if not plan.u.size:
        return {}
    n = min(plan.power_W.shape[-1], boundary.n_steps)
    prices = boundary.price_per_kWh[:, :n], boundary.heating_price_per_kWh[:, :n]
    taken_kWh = energy_kWh(plan.power_W[:, :n], boundary.step_s)
    cost = np.cumsum((taken_kWh * price_paid(plan.u[:, :n], *prices, layout)).sum(axis=0))[None] / area_m2
    return {name: getattr(plan, name) for name in (*TEMPERATURES, "u")} | {"cost": cost}


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
            band = {"mean": mean, "low": mean - NORMAL_95 * sd, "high": mean + NORMAL_95 * sd}
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
_MOST_ANSWERS_BYTES = 250_000
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

    def at(time_s: float) -> list[Counterfactual]:
        start = record.nearest(time_s)
        stop = start + round(LENGTH_H * HOUR_S / record.step_s)
        recent = record.slice(max(0, start - round(MOST_PAST_DAYS * DAY_S / record.step_s)), stop)
        return counterfactuals(model, recent, list(levels.values()), start=time_s, hours=LENGTH_H)

    def packed_rows(of_instants: list[Array]) -> list[Json]:
        return rows_packed(np.concatenate(of_instants, axis=-1), RESOLUTION["T"])

    try:
        record = record_of_run(result)
        instants = _instants(record, len(levels))
        days = list(zip(*(at(time_s) for time_s in instants), strict=True))
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
    most = max(1, int(_MOST_ANSWERS_BYTES / per_instant))
    every = steps_in(EVERY_H * HOUR_S, record.step_s)
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
