"""Which readings of a zone sensor are used, and the model's temperature where none is.

A reading is rejected where it is missing, outside its range, further from its prediction than the record ever
changed within a step (jump), or the same for longer than the record ever showed while the model says that the zone
moved (frozen; a sensor of 0.1 or 0.5 K repeats itself by its resolution). The prediction is that of the last plan
from an accepted reading: its free forecast, plus the forced state of the levels that were applied since. A run that
begins with a reading that repeats itself has none: it predicts from where the record last moved, with the weather that
was measured since.

For `bridge_h` the model stands in for the readings: plans go on, marked. Then the zone counts as unknown, and its
actuators are left to the plant's own control, or to the on/off rule on the model's temperature. Readings are accepted
again when they are near the prediction; after a jump also when they go on moving away, as a zone does whose window was
opened and a sensor that was moved does not, or when they were steady for `return_h`.

Options of a zone sensor, its state from step to step, and its zone now.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import ClassVar

import numpy as np
from pydantic import Field

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.data.limits import RULES, SENSOR_STEP_K
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.model.card import JUDGED_H
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.screening import implausible_zone
from thermoforce_mpc.scenario.settings import StrictModel

_RULE = RULES["T_zone_C"]


class SensorConfig(StrictModel):
    """Which readings of a zone sensor are believed."""

    enabled: bool = Field(True, description="judge the readings of zone sensors by the model")
    # Readings below and above are not believed, °C: range and reason stand in `data.limits`.
    lowest_C: ClassVar[float] = _RULE.range[0]
    highest_C: ClassVar[float] = _RULE.range[1]
    # Distance from the prediction within which a reading is always believed, K; more where the record changes by more
    # than half of it within a step.
    jump_K: ClassVar[float] = _RULE.expected
    frozen_h: float = Field(
        _RULE.frozen_h,
        gt=0,
        description="shortest time after which a reading that repeats itself may be a stuck sensor, h",
    )
    # Time for which the model stands in for readings that are not believed, h: it is judged no further ahead.
    bridge_h: ClassVar[float] = JUDGED_H[-1]
    # Time after which steady readings are believed again, wherever they are, h: a sensor that is right then has seen
    # all of a day.
    return_h: ClassVar[float] = 24.0


@dataclass(frozen=True)
class Anchor:
    """Free forecast from the last reading that was accepted and new: `free_C`, half-width of its band `half_K` (N,)."""

    time_s: float
    free_C: Array
    half_K: Array

    def at(self, time_s: float, step_s: float) -> tuple[float, float]:
        """Forecast and half-width for an instant, °C and K; NaN beyond the forecast."""
        lead = round((time_s - self.time_s) / step_s)
        if not 1 <= lead <= self.free_C.size:
            return math.nan, math.nan
        return float(self.free_C[lead - 1]), float(self.half_K[lead - 1])


@dataclass(frozen=True)
class SensorState:
    """State of one zone's sensor.

    `refused_s`: instants of readings that were rejected. `anchor`: what predicts the next ones. `seen_s`: the last
    instant validated. `distrust`: why readings are rejected at present, by kind; empty while they are not. `since`:
    readings since then: time s, °C, and their distance from the prediction, K.
    """

    refused_s: tuple[float, ...] = ()
    anchor: Anchor | None = None
    seen_s: float = -math.inf
    distrust: str = ""
    kind: str = ""
    since: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True)
class Sensed:
    """A zone now: `T_C` is its reading, or the model's temperature where the reading is rejected (NaN: unknown).

    `why`: why it is not, and since when; empty where it is. `lost`: the model stands in for it no longer. `news`:
    that readings are accepted again.
    """

    T_C: float
    why: str = ""
    lost: bool = False
    news: str = ""


# A jump is more than this many times the largest change of the record within a step, or half-widths of the 80 % band.
# By judgement (2026-11-22), as the pairs below; `bench fallback` has sensors that freeze, read wrongly or nothing.
_TIMES_RECORD, _BANDS = 2.0, 3.0
# A reading that repeats itself is frozen where the model is off by its resolution and this many half-widths of the 80 %
# band, at least this, K; whatever the record showed, where it is off by the second pair.
_FROZEN_BANDS, _SURELY_BANDS, _SURELY_K = 2.0, 4.0, 0.5
# After `bridge_h` a sensor that had been silent or frozen is accepted within this of the prediction, K. By judgement: a
# room left alone for a day.
_AFTER_SILENCE_K = 5.0
# A zone that really changed goes on: within this time, h, by this share of its first change, in two steps or more.
_GOES_ON_H, _GOES_ON_SHARE = 2.0, 0.25


@dataclass(frozen=True)
class _ZoneRecord:
    """The record of one zone for one validation: accepted readings `T_C` (n + 1,), NaN where not, and the rest."""

    time_s: Array
    T_C: Array
    raw_C: Array
    forced_K: Array | None
    step_s: float
    anchor: Anchor | None

    def predicted(self, i: int) -> tuple[float, float]:
        """The model's temperature at boundary `i`, °C, and the half-width of its 80 % band, K; NaN without one."""
        if self.anchor is None or self.forced_K is None:
            return math.nan, math.nan
        free_C, half_K = self.anchor.at(float(self.time_s[i]), self.step_s)
        return float(compose(free_C, self.forced_K[i])), half_K


@dataclass(frozen=True)
class Sensor:
    """Validates the readings of one zone; `name`: of the zone in messages, empty where there is one."""

    config: SensorConfig = field(default_factory=SensorConfig)
    name: str = ""

    def mask_rejected(self, state: SensorState, history: Record, z: int) -> Array:
        """The readings (n + 1,) of zone `z` in `history`, NaN where they were rejected."""
        T = history.T_zone_C[z]
        if not state.refused_s:
            return T
        return np.where(np.isin(history.time_s, np.array(state.refused_s)), np.nan, T)

    def validate(
        self, state: SensorState, history: Record, z: int, forced_K: Array | None
    ) -> tuple[SensorState, Sensed]:
        """Validate what was measured of zone `z` since the last call.

        `history`: the record until now, as measured; `forced_K` (n + 1,): forced response of the zone at its
        boundaries, K; None where unknown.
        """
        now_s, raw = float(history.time_s[-1]), history.T_zone_C[z]
        if self.config.enabled:
            new = history.time_s > state.seen_s
            # The first record is validated by its limits alone.
            if math.isinf(state.seen_s):
                implausible = implausible_zone(raw, history.time_s, (self.config.lowest_C, self.config.highest_C))
                state = _reject(state, history.time_s[implausible & new])
            else:
                outside = (raw < self.config.lowest_C) | (raw > self.config.highest_C) | np.isinf(raw)
                state = _reject(state, history.time_s[outside & new])
        record = _ZoneRecord(
            history.time_s, self.mask_rejected(state, history, z), raw, forced_K, history.step_s, state.anchor
        )
        before = state.distrust
        state = self._validated_now(state, record) if self.config.enabled else state
        state = replace(state, seen_s=now_s)
        T = self.mask_rejected(state, history, z)
        if math.isfinite(T[-1]):
            news = f"{self._prefix}readings are believed again ({before})" if before and not state.distrust else ""
            return state, Sensed(float(T[-1]), news=news)
        valid = np.flatnonzero(np.isfinite(T))
        if not valid.size:
            return state, Sensed(math.nan, f"the temperature of {self.name or 'the zone'} was never measured", True)
        age_h = (now_s - float(history.time_s[valid[-1]])) / HOUR_S
        reason = state.distrust or "was not measured"
        why = f"{self._prefix}zone temperature {reason}, the last reading believed is {age_h:.3g} h old"
        return state, Sensed(record.predicted(T.size - 1)[0], why, age_h > self.config.bridge_h + 1e-6)

    def anchored(self, state: SensorState, history: Record, z: int, context: PredictionContext) -> SensorState:
        """The state with the free forecast of a plan, where its reading was accepted and new."""
        time_s, T = float(history.time_s[-1]), self.mask_rejected(state, history, z)
        if not math.isfinite(T[-1]):
            return state
        repeated = T.size > 1 and T[-1] == T[-2]
        if repeated and state.anchor is not None and math.isfinite(state.anchor.at(time_s, history.step_s)[0]):
            return state
        half_K = 0.5 * (context.free.quantile_C(0.9)[z] - context.free.quantile_C(0.1)[z])
        return replace(state, anchor=Anchor(time_s, context.free.median_C[z], half_K))

    def repeats(self, state: SensorState, history: Record, z: int) -> int:
        """Steps at the end of the record of a run that begins in which readings of zone `z` repeat themselves for
        `frozen_h` or longer; 0 where they do not, or something predicts them.
        """
        if not self.config.enabled or state.anchor is not None or not math.isinf(state.seen_s):
            return 0
        repeated = _repeated(history.T_zone_C[z], float(history.T_zone_C[z, -1]))
        return repeated if repeated * history.step_s >= self.config.frozen_h * HOUR_S - 1.0 else 0

    @property
    def _prefix(self) -> str:
        return f"{self.name}: " if self.name else ""

    def _validated_now(self, state: SensorState, record: _ZoneRecord) -> SensorState:
        now_s, y = float(record.time_s[-1]), float(record.raw_C[-1])
        if math.isnan(y):
            if not state.distrust or state.kind == "frozen":  # a frozen sensor that fell silent is no longer frozen
                return replace(state, distrust="was not measured", kind="silent", since=())
            return state
        if now_s in state.refused_s:
            return replace(state, distrust=f"reads {y:.4g} °C, out of range", kind="silent", since=())
        if state.distrust:
            return self._after_rejection(state, record, y)
        jump = self._jump_reason(record, y)
        if jump:
            off = y - record.predicted(record.time_s.size - 1)[0]
            state = replace(state, distrust=jump, kind="jump", since=((now_s, y, off),))
            return _reject(state, record.time_s[-1:])
        repeated, frozen = self._frozen_reason(record, y)
        if frozen:
            state = replace(state, distrust=frozen, kind="frozen", since=())
            return _reject(state, record.time_s[-repeated:])
        return state

    def _limit_K(self, record: _ZoneRecord, half_K: float = 0.0) -> float:
        """Largest distance from the prediction, or change within a step, that is accepted, K."""
        changes = np.abs(np.diff(record.T_C[:-1]))
        largest = float(np.nanmax(changes)) if np.isfinite(changes).any() else math.inf
        return max(self.config.jump_K, _TIMES_RECORD * largest, _BANDS * half_K if math.isfinite(half_K) else 0.0)

    def _jump_reason(self, record: _ZoneRecord, y: float) -> str:
        predicted_C, half_K = record.predicted(record.time_s.size - 1)
        # What is always believed needs no look at the record.
        if not math.isfinite(predicted_C) or abs(y - predicted_C) <= self.config.jump_K:
            return ""
        valid = np.flatnonzero(np.isfinite(record.T_C[:-1]))
        if not valid.size:
            return ""
        limit_K, off_K = self._limit_K(record, half_K), y - predicted_C
        if abs(off_K) <= limit_K:
            return ""
        # A model that drifts away while the sensor moves on is the model's fault.
        if valid[-1] == record.T_C.size - 2 and abs(y - record.T_C[-2]) <= self._limit_K(record):
            return ""
        return f"jumped to {y:.2f} °C, {abs(off_K):.2f} K from its prediction ({limit_K:.2f} K are believed)"

    def _frozen_reason(self, record: _ZoneRecord, y: float) -> tuple[int, str]:
        """How many readings repeat the one before, and why the sensor is frozen; empty where it may not be."""
        if record.T_C.size > 1 and record.T_C[-2] != y:
            return 0, ""
        repeated = _repeated(record.T_C, y)
        if repeated * record.step_s < self.config.frozen_h * HOUR_S - 1.0:
            return repeated, ""
        before = record.T_C[: record.T_C.size - repeated]
        changes = np.abs(np.diff(before))
        moved = changes[changes > 0]
        if not moved.size:
            return repeated, ""
        plausible = repeated <= _longest_run(np.diff(before) == 0)
        bands, least_K = (_SURELY_BANDS, _SURELY_K) if plausible else (_FROZEN_BANDS, SENSOR_STEP_K)
        courses = np.array([record.predicted(i) for i in range(before.size, record.T_C.size)])
        beyond_K = np.abs(courses[:, 0] - y) - bands * courses[:, 1] - moved.min() - least_K
        if not (beyond_K > 0.0).any():
            return repeated, ""
        hours = repeated * record.step_s / HOUR_S
        return repeated, f"has been {y:.2f} °C for {hours:.3g} h, in which the model moved away"

    def _after_rejection(self, state: SensorState, record: _ZoneRecord, y: float) -> SensorState:
        """The state where readings had been rejected: they are accepted again, or this one is rejected too."""
        now_s = float(record.time_s[-1])
        predicted_C, half_K = record.predicted(record.time_s.size - 1)
        off_K = y - predicted_C
        before = record.raw_C[-2] if record.raw_C.size > 1 else math.nan
        since = (*state.since, (now_s, y, off_K))
        accepted = replace(state, distrust="", kind="", since=())
        if state.kind == "frozen" and y == before:
            return _reject(state, record.time_s[-1:])
        valid = np.flatnonzero(np.isfinite(record.T_C[:-1]))
        bridged_h = (now_s - float(record.time_s[valid[-1]])) / HOUR_S if valid.size else math.inf
        limit_K = self._limit_K(record, half_K)
        if state.kind != "jump" and bridged_h > self.config.bridge_h:
            limit_K = max(limit_K, _AFTER_SILENCE_K)
        if abs(off_K) <= limit_K or (math.isnan(off_K) and state.kind != "jump"):
            return accepted
        if state.kind == "jump" and _keeps_moving(since):
            refused_before = tuple(time_s for time_s in state.refused_s if time_s < since[0][0])
            return replace(accepted, refused_s=refused_before)
        if self._steady(since, limit_K):
            return accepted
        jump = state.distrust
        if state.kind != "jump":
            jump = f"came back at {y:.2f} °C, {abs(off_K):.2f} K from its prediction"
            since = since[-1:]
        longest = round(self.config.return_h * HOUR_S / record.step_s) + 2
        return _reject(replace(state, distrust=jump, kind="jump", since=since[-longest:]), record.time_s[-1:])

    def _steady(self, since: tuple[tuple[float, float, float], ...], limit_K: float) -> bool:
        """Whether consecutive readings of `return_h` moved as those of a sensor do: neither in jumps nor not at all."""
        if since[-1][0] - since[0][0] < self.config.return_h * HOUR_S - 1.0:
            return False
        readings = np.array([T for _, T, _ in since])
        steps = np.abs(np.diff(readings))
        return bool(steps.max() <= limit_K and np.ptp(readings) > 0.0)


def _reject(state: SensorState, time_s: Array) -> SensorState:
    new = tuple(float(t) for t in time_s if float(t) not in state.refused_s)
    return replace(state, refused_s=(*state.refused_s, *new)) if new else state


def _keeps_moving(since: tuple[tuple[float, float, float], ...]) -> bool:
    """Whether readings after a jump went on the same way, as those of a zone do and of a moved sensor do not."""
    times = np.array([t for t, _, _ in since])
    off = np.array([off_K for _, _, off_K in since])
    if off.size < 3 or times[-1] - times[0] > _GOES_ON_H * HOUR_S + 1.0 or not np.isfinite(off).all():
        return False
    first, steps = abs(off[0]), np.diff(off) * np.sign(off[0])
    return bool((steps > 0).all() and steps.max() <= first and steps.sum() >= _GOES_ON_SHARE * first)


def _repeated(T_C: Array, y: float) -> int:
    """How many of the last readings (n,) repeat the one before, which is `y` as they are."""
    same = np.equal(T_C, y)
    return int(same.size if same.all() else np.argmin(same[::-1])) - 1


def _longest_run(flags: Array) -> int:
    return max((len(list(run)) for is_set, run in groupby(flags) if is_set), default=0)


@dataclass(frozen=True)
class Zones:
    """The zones now (Z,): what is known of each, with `T_C` °C to act on (NaN: unknown)."""

    each: tuple[Sensed, ...]

    @property
    def T_C(self) -> Array:
        """Temperatures (Z,), °C: readings, or what stands in for them."""
        return np.array([zone.T_C for zone in self.each])

    @property
    def bridged(self) -> str:
        """Which zones the model stands in for, in words; empty where none."""
        return "; ".join(f"{zone.why}, the model stands in" for zone in self.each if zone.why and not zone.lost)

    @property
    def news(self) -> str:
        """Which readings are accepted again, in words."""
        return "; ".join(zone.news for zone in self.each if zone.news)


class ZoneSensors:
    """Validates the readings of all zones (Z,); it holds no state."""

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)

    def mask_rejected(self, states: Sequence[SensorState], history: Record) -> Record:
        """The record with rejected readings taken as not measured."""
        if not any(state.refused_s for state in states):
            return history
        rows = [sensor.mask_rejected(state, history, z) for z, (sensor, state) in enumerate(self._each(states))]
        return replace(history, T_zone_C=np.stack(rows))

    def validate(
        self, states: Sequence[SensorState], history: Record, forced_K: Array | None
    ) -> tuple[tuple[SensorState, ...], Record, Zones]:
        """The states (Z,) now, the record with rejected readings taken as not measured, and the zones now.

        `states`: after the last call; `history`: as measured; `forced_K` (Z, A, n + 1, r): forced states until now, K;
        None where unknown.
        """
        after, zones = [], []
        for z, (sensor, state) in enumerate(self._each(states)):
            row = None if forced_K is None else forced_K[z].sum(axis=(0, 2))
            state, zone = sensor.validate(state, history, z, row)
            after.append(state)
            zones.append(zone)
        return tuple(after), self.mask_rejected(after, history), Zones(tuple(zones))

    def repeat_since(self, states: Sequence[SensorState], history: Record) -> dict[int, int]:
        """The boundary of the record since which readings repeat themselves, by zone, see `Sensor.repeats`."""
        each = enumerate(self._each(states))
        repeated = {z: sensor.repeats(state, history, z) for z, (sensor, state) in each}
        return {z: history.n_steps - n for z, n in repeated.items() if 0 < n < history.n_steps}

    def anchored(
        self, states: Sequence[SensorState], history: Record, context: PredictionContext
    ) -> tuple[SensorState, ...]:
        """The states with the free forecast of a plan, for zones whose reading is accepted and new."""
        return tuple(
            state if z in context.unmeasured else sensor.anchored(state, history, z, context)
            for z, (sensor, state) in enumerate(self._each(states))
        )

    def _each(self, states: Sequence[SensorState]) -> list[tuple[Sensor, SensorState]]:
        return list(zip(self._sensors, states, strict=True))
