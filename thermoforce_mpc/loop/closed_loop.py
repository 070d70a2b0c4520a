"""The loop on a simulated plant, and what comes of it: samples, steps, results."""

from __future__ import annotations

import math
import time
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
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.inputs import OUTAGE_H, UnitDoubts
from thermoforce_mpc.loop.loop import CLOCK_TOLERANCE_S, Believed, Decided, KeptSteps, Loop, wrong_blocks
from thermoforce_mpc.model.screening import ReadingLimits, limits_of, screened, screened_history
from thermoforce_mpc.protocols import Controller, Plant, RoomSetpointPlant, has_tank

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
        counts = {status.value: 0 for status in PlanStatus} | {"refused": 0}
        for step in self.steps:
            counts[step.plan.status.value] += 1
            counts["refused"] += bool(step.refused)
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
    allowed: ReadingLimits | None = None,
    u_min: Sequence[float] | None = None,
    keeper: StepKeeper | None = None,
    steps: KeptSteps[StepRecord] | None = None,
    record_days: float = _RECORD_DAYS,
    outage_h: float = OUTAGE_H,
    units: UnitDoubts | None = None,
    state: object = None,
) -> RunResult:
    """Run `controller` on `plant` over the scored window of `period` after its warm-up.

    Measurements are screened before they reach the controller: implausible readings become NaN (see
    `thermoforce_mpc.model.screening`). Where the plant does not report u, the applied level is used.

    Args:
        on_step: called after every control step (progress display).
        allowed: limits of plausible readings; by default those of the controller's model, see `limits_of`.
        u_min: lowest level of each actuator (A,); by default that of `allowed` for all.
        keeper: keeps a journal of the steps.
        steps: where the steps are kept, also if the plant fails; empty.
        record_days: controllers get the record of these latest days, or up to a day more.
        outage_h: how long the plant may give no forecast before the run ends, h; see `Forecasts`.
        units: says which readings and prices are probably in a wrong unit.
        state: the controller's, to go on from; None: it begins.

    Raises:
        PlantError: the plant or its service failed; the KPIs so far are lost.
        ControllerRaised: the controller did; likewise.
        DataError: what the keeper says acted then could not have.
        MemoryError: too little memory is left to begin a step.
    """
    began = time.perf_counter()
    allowed = allowed or limits_of(controller)
    driver = _Simulated(
        plant,
        period=period,
        price=price,
        step_s=controller.step_s,
        on_step=on_step,
        allowed=allowed,
        u_min=allowed.u_min if u_min is None else u_min,
        keeper=keeper,
        steps=KeptSteps() if steps is None else steps,
        record_days=record_days,
        units_doubted=units,
        state=state,
    )
    state = Loop(driver, controller, outage_h).run()
    kpis = plant.kpis() | {"time_rat": time_rat(driver.steps, controller.step_s)}
    return RunResult(period, controller.name, kpis, driver.steps, driver.start, time.perf_counter() - began, state)


@dataclass(eq=False)
class PlantDriver:
    """What drivers (`LoopDriver`) of a simulated plant share: it is its own clock, and its owner's."""

    plant: Plant
    begun_anew = False

    def unfit(self, blocks: Sequence[Block]) -> str:
        """See `LoopDriver.unfit`: the plant refuses itself what it has not."""
        return ""

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        return self.plant.forecast(horizon_s, interval_s)

    def instead(self, index: int, error: Exception, state: object) -> Decided:
        """See `LoopDriver.instead`: nothing acts in the place of what cannot be decided about a simulated plant."""
        raise error

    def end(self) -> None:
        """See `LoopDriver.end`: the plant is its owner's."""


@dataclass(eq=False, kw_only=True)
class _Simulated(PlantDriver):
    """A simulated plant under a controller of `step_s` over a scored window; the others as in `run_closed_loop`."""

    period: Period
    price: str
    step_s: float
    on_step: Callable[[StepRecord], None] | None
    allowed: ReadingLimits
    u_min: float | Sequence[float]
    keeper: StepKeeper | None
    steps: KeptSteps[StepRecord]
    record_days: float
    units_doubted: UnitDoubts | None
    state: object
    start: Measurement = field(init=False)

    def begin(self) -> object:
        """See `LoopDriver.begin`."""
        self.start = self.plant.reset(self.period.start_s, self.period.warmup_s, self.price)
        self._end_s, self._now_s = self.period.start_s + self.period.scored_s, self.start.time_s
        self._as_read = self.plant.past(self.step_s)
        self._history, self._notes = screened_history(self._as_read, self.allowed)
        return self.state

    def next_step(self) -> bool:
        """See `LoopDriver.next_step`."""
        return self._end_s - self._now_s > CLOCK_TOLERANCE_S

    def read(self) -> Believed:
        """See `LoopDriver.read`."""
        as_read = self._history if self.steps else self._as_read
        tank = self.plant.tank_now() if has_tank(self.plant) else (math.nan, False)
        return Believed(self._history, as_read, self._notes, self._end_s - self._now_s, self.u_min, tank)

    def units(self) -> UnitDoubts | None:
        """See `LoopDriver.units`."""
        return self.units_doubted

    def act(self, decided: Decided) -> object:
        """See `LoopDriver.act`."""
        t0 = time.perf_counter()
        observation, boundary = decided.observation, decided.boundary
        assert observation is not None
        assert boundary is not None
        blocks = self._kept(decided, observation)
        if has_tank(self.plant):
            of_tank = decided.plan.hot_water
            self.plant.set_tank(None if of_tank is None or decided.refused else of_tank.command[0])
        notes, samples = decided.notes, list[Sample]()
        parts: list[tuple[float, Measurement]] = []
        ahead_s = 0.0
        for block in blocks:
            reported = advanced(self.plant, block)
            measurement, rejected = screened(reported, self.allowed, self._history)
            parts.append((block.duration_s, with_level(measurement, block)))
            notes += rejected
            samples.append(sample_of(self._now_s, block, reported, boundary))
            ahead_s += reported.time_s - self._now_s - block.duration_s
            self._now_s = reported.time_s
        t1 = time.perf_counter()
        jumped = abs(ahead_s) > _CLOCK_JUMP_S
        if jumped:
            notes += (f"the plant's clock ran ahead by {ahead_s:g} s: what happened meanwhile is read from its record",)
        record = StepRecord(
            index=decided.index,
            time_s=observation.time_s,
            T_zone_C=observation.T_zone_C,
            boundary=boundary,
            plan=decided.plan,
            refused=decided.refused,
            plan_seconds=decided.plan_seconds,
            forecast_seconds=decided.forecast_seconds,
            plant_seconds=round(t1 - t0, 6),
            samples=tuple(samples),
            notes=tuple(dict.fromkeys(notes)),
        )
        record = self.keeper.ended(record) if self.keeper else record
        self.steps.append(record)
        self._notes = ()
        if self.next_step():  # the last step may be cut short, and no plan follows it
            self._learn(parts, jumped)
        if self.on_step:
            self.on_step(record)
        return decided.after

    def _kept(self, decided: Decided, observation: Observation) -> tuple[Block, ...]:
        """The blocks to apply, once the decision is recorded: of a run that is resumed those of then."""
        if self.keeper is None:
            return decided.blocks
        kept = tuple(
            self.keeper.decided(decided.index, observation.time_s, decided.plan, decided.blocks, decided.refused)
        )
        left_s = min(self.step_s, self._end_s - self._now_s)
        if wrong := wrong_blocks(kept, left_s, self.u_min, self._history.names):
            raise DataError(f"the journal tells of {wrong}; was it edited? Start the run again")
        return kept

    def _learn(self, parts: list[tuple[float, Measurement]], jumped: bool) -> None:
        """Extend the history by what was measured in a step; after a jump of the clock it is read again."""
        if jumped:
            self._history, self._notes = screened_history(self.plant.past(self.step_s), self.allowed)
        else:
            self._history = self._history.extended(parts[-1][1].averaged_with(parts))
        if self._history.time_s[-1] - self._history.time_s[0] > (self.record_days + 1.0) * DAY_S:
            self._history = self._history.last(round(self.record_days * DAY_S / self.step_s))


def time_rat(steps: Sequence[StepRecord], step_s: float) -> float:
    """BOPTEST's time_rat, computing time per control step over the step, in the place of the plant's own value."""
    return math.fsum(step.plan_seconds for step in steps) / len(steps) / step_s if steps else math.nan


def advanced(plant: Plant, block: Block) -> Measurement:
    """Apply `block` to `plant`; room set-points go only to plants that have them. Raises as `Plant.advance` does."""
    if all(command is None for command in block.command):
        return plant.advance(block.u, block.duration_s)
    return cast(RoomSetpointPlant, plant).advance(block.u, block.duration_s, block.command)


def with_level(measurement: Measurement, block: Block) -> Measurement:
    """The measurement with the applied levels where u was not measured; u stays NaN where native control acts."""
    if not np.isnan(measurement.u).any():
        return measurement
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
    return int(max((boundary.time_s <= start_s + CLOCK_TOLERANCE_S).sum() - 1, 0))
