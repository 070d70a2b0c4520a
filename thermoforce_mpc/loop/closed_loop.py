"""Closed loop of controller and plant: measure, forecast, plan, check, apply."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Protocol, cast

import numpy as np

from thermoforce_mpc.data import (
    DAY_S,
    SINGLE,
    Array,
    Block,
    Boundary,
    Measurement,
    Names,
    Observation,
    Period,
    Plan,
    PlanStatus,
)
from thermoforce_mpc.errors import ControllerRaised, DataError, InputError, ThermoForceError
from thermoforce_mpc.loop.forecasts import OUTAGE_H, Forecasts
from thermoforce_mpc.loop.kept_steps import KeptSteps
from thermoforce_mpc.loop.unit_doubts import UnitDoubts
from thermoforce_mpc.model.screening import Limits, limits_of, screened, screened_history
from thermoforce_mpc.plants.checks import check_levels
from thermoforce_mpc.protocols import Controller, Plant, RoomSetpointPlant

# Tolerance on times, s: shorter remainders are rounding errors of the clock.
_CLOCK_TOLERANCE_S = 1e-6
# A plant's clock that is further off after a step has jumped, s.
_CLOCK_JUMP_S = 0.01
# Controllers get the record of these latest days. It is cut once a day.
_RECORD_DAYS = 35.0


@dataclass(frozen=True)
class Sample:
    """One applied block: bounds and prices in force, and the measurements at its end.

    Zone temperatures and bounds have shape (Z,), prices and power (M,), levels and heat (A,); `u_applied` (A,) is None
    where the plant's own control acted.
    """

    start_s: float
    duration_s: float
    T_zone_C: Array
    T_out_C: float
    solar_W_m2: float
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    u_applied: tuple[float | None, ...]
    u_measured: Array
    power_W: Array
    heat_W: Array
    names: Names = SINGLE

    def columns(self) -> dict[str, float | None]:
        """The sample as one row of a table, by `Names.label`; with one zone, by the names of the fields."""
        row: dict[str, float | None] = {}
        for name in (item.name for item in fields(self) if item.name != "names"):
            values = getattr(self, name)
            if np.ndim(values) == 0:
                row[name] = values
                continue
            of = "u" if name.startswith("u_") else name
            for i, value in enumerate(values):
                label = name + self.names.label(of, i).removeprefix(of)
                row[label] = None if value is None else float(value)
        return row


@dataclass(frozen=True)
class StepRecord:
    """One control step: zone temperatures (Z,), °C, plan, boundary forecast (holes filled, see `notes`), applied blocks
    and computing times, s.

    `notes` lists the readings of the step that were missing or rejected (in the first step also those of the record
    before it); `samples` holds the readings as reported by the plant.
    """

    index: int
    time_s: float
    T_zone_C: Array
    boundary: Boundary
    plan: Plan
    refused: str
    plan_seconds: float
    forecast_seconds: float
    plant_seconds: float
    samples: tuple[Sample, ...]
    notes: tuple[str, ...] = ()

    @property
    def acting(self) -> tuple[PlanStatus, ...]:
        """What acted at each actuator (A,)."""
        n = len(self.boundary.names.actuators)
        return self.plan.acting if len(self.plan.acting) == n else (self.plan.status,) * n


@dataclass(frozen=True)
class RunResult:
    """Result of a closed loop: KPIs by BOPTEST's names, all steps, and the wall time `seconds`.

    `state` is the controller state of the last plan; with it the run can be continued.
    """

    period: Period
    controller: str
    kpis: dict[str, float]
    steps: Sequence[StepRecord]
    start: Measurement
    seconds: float = field(default=0.0)
    state: object = field(default=None, repr=False)

    @property
    def names(self) -> Names:
        """Names of zones, actuators and machines."""
        return self.start.names

    @property
    def samples(self) -> list[Sample]:
        """All applied blocks in order."""
        return [sample for step in self.steps for sample in step.samples]

    def fallback_levels(self) -> dict[str, int]:
        """Number of plans by status, and of plans refused by the check before the plant."""
        counts = {status.value: 0 for status in PlanStatus}
        for step in self.steps:
            counts[step.plan.status.value] += 1
        counts["refused"] = sum(bool(step.refused) for step in self.steps)
        return counts


class StepKeeper(Protocol):
    """Keeps a record of the steps of a loop as they happen."""

    def decided(self, index: int, time_s: float, plan: Plan, blocks: Sequence[Block], refused: str) -> Sequence[Block]:
        """Record a decision before it acts; return the blocks to apply."""
        ...

    def ended(self, record: StepRecord) -> StepRecord:
        """Record a step that has ended; return it, with the computing times to report."""
        ...


def run_closed_loop(
    plant: Plant,
    controller: Controller,
    period: Period,
    price: str = "constant",
    on_step: Callable[[StepRecord], None] | None = None,
    allowed: Limits | None = None,
    lowest: Sequence[float] | None = None,
    keeper: StepKeeper | None = None,
    steps: KeptSteps[StepRecord] | None = None,
    record_days: float = _RECORD_DAYS,
    outage_h: float = OUTAGE_H,
    units: UnitDoubts | None = None,
) -> RunResult:
    """Run `controller` on `plant` over the scored window of `period` after its warm-up.

    Measurements are screened before they reach the controller: implausible readings become NaN (see
    `thermoforce_mpc.model.screening`). Where the plant does not report u, the applied level is used.

    Args:
        on_step: called after every control step (progress display).
        allowed: limits of plausible readings; by default those of the controller's model, see `limits_of`.
        lowest: lowest level of each actuator (A,); by default that of `allowed` for all.
        keeper: keeps a journal of the steps.
        steps: where the steps are kept, also if the plant fails; empty.
        record_days: controllers get the record of these latest days, or up to a day more.
        outage_h: how long the plant may give no forecast before the run ends, h; see `Forecasts`.
        units: says which readings and prices are probably in a wrong unit.

    Raises:
        PlantError: the plant or its service failed; the KPIs so far are lost.
        ControllerRaised: the controller did; likewise.
        DataError: what the keeper says acted then could not have.
    """
    began = time.perf_counter()
    start = plant.reset(period.start_s, period.warmup_s, price)
    allowed = allowed or limits_of(controller)
    lowest = [allowed.lowest] if lowest is None else lowest
    as_read = plant.past(controller.step_s)
    history, doubts = screened_history(as_read, allowed)
    end_s = period.start_s + period.scored_s
    now_s = start.time_s
    records: KeptSteps[StepRecord] = KeptSteps() if steps is None else steps
    state: object = None
    forecasts = Forecasts(plant, controller.horizon_s, controller.step_s, outage_h)
    while end_s - now_s > _CLOCK_TOLERANCE_S:
        t0 = time.perf_counter()
        forecast, boundary, gaps = forecasts.now(history)
        doubts += units.now(history if records else as_read, boundary) if units else ()
        t1 = time.perf_counter()
        # The controller fills holes of the forecast itself, and says so.
        observation = Observation(history, forecast)
        plan = _planned(controller, observation, state, len(records))
        t2 = time.perf_counter()
        # Records do not hold the controller state, which grows with the run; only the latest is kept.
        plan, next_state = replace(plan, state=None), plan.state
        blocks, refused = checked_blocks(plan, controller.step_s, end_s - now_s, lowest, history.names)
        # A plan that was refused did not act: the controller goes on from what it knew before.
        state = state if refused else next_state
        if keeper:
            kept = tuple(keeper.decided(len(records), observation.time_s, plan, blocks, refused))
            if wrong := _wrong(kept, min(controller.step_s, end_s - now_s), lowest, history.names):
                raise DataError(f"the journal tells of {wrong}; was it edited? Start the run again")
            blocks = kept
        doubts += gaps
        samples: list[Sample] = []
        parts: list[tuple[float, Measurement]] = []
        ahead_s = 0.0
        for block in blocks:
            reported = advanced(plant, block)
            measurement, notes = screened(reported, allowed, history)
            parts.append((block.duration_s, with_level(measurement, block)))
            doubts += notes
            samples.append(sample_of(now_s, block, reported, boundary))
            ahead_s += reported.time_s - now_s - block.duration_s
            now_s = reported.time_s
        t3 = time.perf_counter()
        if abs(ahead_s) > _CLOCK_JUMP_S:
            doubts += (
                f"the plant's clock ran ahead by {ahead_s:g} s: what happened meanwhile is read from its record",
            )
        record = StepRecord(
            index=len(records),
            time_s=observation.time_s,
            T_zone_C=observation.T_zone_C,
            boundary=boundary,
            plan=plan,
            refused=refused,
            plan_seconds=round(t2 - t1, 6),
            forecast_seconds=round(t1 - t0, 6),
            plant_seconds=round(t3 - t2, 6),
            samples=tuple(samples),
            notes=tuple(dict.fromkeys(doubts)),
        )
        doubts = ()
        record = keeper.ended(record) if keeper else record
        records.append(record)
        if end_s - now_s > _CLOCK_TOLERANCE_S:  # the last step may be cut short, and no plan follows it
            if abs(ahead_s) > _CLOCK_JUMP_S:
                history, doubts = screened_history(plant.past(controller.step_s), allowed)
            else:
                history = history.extended(parts[-1][1].averaged_with(parts))
            if history.time_s[-1] - history.time_s[0] > (record_days + 1.0) * DAY_S:
                history = history.last(round(record_days * DAY_S / controller.step_s))
        if on_step:
            on_step(record)
    kpis = plant.kpis() | {"time_rat": time_rat(records, controller.step_s)}
    return RunResult(period, controller.name, kpis, records, start, time.perf_counter() - began, state)


def time_rat(steps: Sequence[StepRecord], step_s: float) -> float:
    """BOPTEST's time_rat, computing time per control step over the step, in the place of the plant's own value."""
    return math.fsum(step.plan_seconds for step in steps) / len(steps) / step_s if steps else math.nan


def advanced(plant: Plant, block: Block) -> Measurement:
    """Apply `block` to `plant`; room set-points go only to plants that have them. Raises as `Plant.advance` does."""
    if all(command is None for command in block.command):
        return plant.advance(block.u, block.duration_s)
    return cast(RoomSetpointPlant, plant).advance(block.u, block.duration_s, block.command)


def checked_blocks(
    plan: Plan, step_s: float, remaining_s: float, lowest: float | Sequence[float] = 0.0, names: Names = SINGLE
) -> tuple[tuple[Block, ...], str]:
    """The blocks of `plan` cut to the window and "", or one step of native control and the reason for the refusal.

    Last check before the plant: there must be one level for each actuator of `names`, None or finite and in
    [`lowest`, 1] (`lowest` of all or of each), room set-points finite and in order; a duration must be finite and
    positive; the durations must sum to `step_s`. What is wrong with one actuator refuses the plan for all.
    """
    native = (Block.native(len(names.actuators), min(step_s, remaining_s)),)
    if not plan.blocks:
        return native, "the plan had no action: native control instead"
    if wrong := _wrong(plan.blocks, step_s, lowest, names):
        return native, f"refused {wrong}: native control instead"
    cut: list[Block] = []
    left_s = remaining_s
    for block in plan.blocks:
        if left_s <= _CLOCK_TOLERANCE_S:
            break
        cut.append(replace(block, duration_s=min(block.duration_s, left_s)))
        left_s -= block.duration_s
    return tuple(cut), ""


def _wrong(blocks: Sequence[Block], duration_s: float, lowest: float | Sequence[float], names: Names) -> str:
    """What is wrong with blocks for `duration_s`, in words; empty where they may be applied."""
    try:
        for block in blocks:
            check_levels(block.u, block.duration_s, block.command, names=names, lowest=lowest)
    except InputError as error:
        return str(error)
    total_s = math.fsum(block.duration_s for block in blocks)
    if abs(total_s - duration_s) > _CLOCK_TOLERANCE_S:
        return f"blocks of {total_s:g} s in all for a step of {duration_s:g} s"
    return ""


def _planned(controller: Controller, observation: Observation, state: object, index: int) -> Plan:
    """The controller's plan; raises `ControllerRaised` for whatever else it does."""
    at = f"{controller.name} in step {index}, day {observation.time_s / DAY_S:.3f}"
    try:
        plan = controller.plan(observation, state)
    except ThermoForceError:  # has its own exit code, and says what to do
        raise
    except Exception as error:
        last = "".join(traceback.format_tb(error.__traceback__)[1:][-3:]).rstrip()
        raise ControllerRaised(f"{at} raised {type(error).__name__}: {error}\n{last}") from error
    if not isinstance(plan, Plan):
        raise ControllerRaised(f"{at} returned a {type(plan).__name__}, not a Plan (docs/how-to/controller.md)")
    return plan


def with_level(measurement: Measurement, block: Block) -> Measurement:
    """The measurement with the applied levels where u was not measured; u stays NaN where native control acts."""
    by_level = np.array([command is None for command in block.command])
    return replace(measurement, u=np.where(np.isnan(measurement.u) & by_level, block.as_array(), measurement.u))


def sample_of(start_s: float, block: Block, measurement: Measurement, boundary: Boundary) -> Sample:
    """Sample of one block, with the bounds and prices in force at its start (from the forecast)."""
    index = in_force(boundary, start_s)
    return Sample(
        start_s=start_s,
        duration_s=block.duration_s,
        T_zone_C=measurement.T_zone_C,
        T_out_C=measurement.T_out_C,
        solar_W_m2=measurement.solar_W_m2,
        lower_C=boundary.lower_C[:, index],
        upper_C=boundary.upper_C[:, index],
        price_per_kWh=boundary.price_per_kWh[:, index],
        u_applied=block.u,
        u_measured=measurement.u,
        power_W=measurement.power_W,
        heat_W=measurement.heat_W,
        names=measurement.names,
    )


def in_force(boundary: Boundary, start_s: float) -> int:
    """Number of the instant whose bounds and prices hold for a block from `start_s`, s: the latest not after it."""
    return int(max((boundary.time_s <= start_s + _CLOCK_TOLERANCE_S).sum() - 1, 0))
