"""Which readings of weather sensors and meters are used: one that stays while what it follows moves is stuck.

| reading | follows | stuck, by default, where meanwhile |
|---|---|---|
| outdoor temperature | its forecast for now | the forecast moved by 2 K |
| sun | its forecast for now | the forecast moved by 100 W/m² |
| power of a machine | the levels of its actuators | they moved by a quarter of full level |
| heat of an actuator | its level | it moved by a quarter of full level |

So the sun at night and the power of a machine that is off, or runs evenly, may stay as they are. A meter that reads
next to nothing is not validated: a machine that does not run reads that too, and the watch compares it with the level
that was requested. Nor is a point that never moved in the record, since nothing measures it.

What is rejected counts as not measured, from its second reading on; it is used again when it moves. A run that begins
sees in the record since when a meter stays and which levels it had since; forecasts of then are not in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from pydantic import Field

from controllers.checks import ControllerConfigError
from thermoforce_mpc.data import HOUR_S, Array, Boundary, Layout, Record
from thermoforce_mpc.data.limits import RULES
from thermoforce_mpc.scenario.settings import StrictModel

_JUDGED = ("T_out_C", "solar_W_m2", "power_W", "heat_W")
_WEATHER = ("T_out_C", "solar_W_m2")
# Readings within this share of one another are the same; of the largest of the record they are next to nothing. By
# judgement: of rounding, and of a meter's idle reading.
_SAME, _NOTHING = 1e-9, 0.05


class MeterConfig(StrictModel):
    """Which readings of a weather sensor or meter are believed."""

    enabled: bool = Field(True, description="judge the readings of weather sensors and meters")
    frozen_h: float = Field(
        RULES["T_out_C"].frozen_h,
        gt=0,
        description="shortest time after which a reading that repeats itself may be stuck, h",
    )


@dataclass(frozen=True)
class MeterState:
    """State of one point: its last reading, since when, and the range of what it follows since then.

    `refused_s`: instants whose readings are rejected (for power and heat, the begin of the step).
    """

    value: float = math.nan
    since_s: float = math.nan
    low: float = math.nan
    high: float = math.nan
    stuck: str = ""
    refused_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class MeterFindings:
    """Result of a validation: `why` readings are rejected, which are used again (`news`), and whether past readings
    that were used until now were `found` to be stuck.
    """

    why: str = ""
    news: str = ""
    found: bool = False


@dataclass(frozen=True)
class Meters:
    """Validates the readings of weather sensors and meters of a building; it holds no state.

    `common`: options of all points; `single`: of single ones, by the name of the signal (`solar_W_m2`) or of its row
    (`power_W[boiler]`). Raises `ControllerConfigError` where that names a point that is not there.
    """

    layout: Layout
    common: MeterConfig = field(default_factory=MeterConfig)
    single: Mapping[str, MeterConfig] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [*_JUDGED, *(self._label(*point) for point in self._points)]
        for name in self.single:
            if name not in names:
                raise ControllerConfigError(
                    f"controller.options.meters: there is no '{name}'; known are {', '.join(dict.fromkeys(names))}"
                )

    @property
    def begin(self) -> tuple[MeterState, ...]:
        """The states at the begin of a run."""
        return (MeterState(),) * len(self._points)

    def mask_rejected(self, states: tuple[MeterState, ...], history: Record) -> Record:
        """The record with rejected readings taken as not measured."""
        masked: dict[str, Array] = {}
        for (name, row), state in zip(self._points, states, strict=True):
            if not state.refused_s:
                continue
            values = masked.setdefault(name, np.array(getattr(history, name)))
            time_s = history.time_s[: values.shape[-1]]
            rows = values if values.ndim == 1 else values[row]
            rows[np.isin(time_s, np.array(state.refused_s))] = np.nan
        return replace(history, **masked) if masked else history  # type: ignore[arg-type]

    def validate(
        self, states: tuple[MeterState, ...], history: Record, boundary: Boundary
    ) -> tuple[tuple[MeterState, ...], MeterFindings]:
        """The states after the latest readings of `history`; `boundary` is the forecast from now on, without gaps."""
        after, why, news, newly_stuck = [], [], [], False
        for (name, row), before in zip(self._points, states, strict=True):
            label = self._label(name, row)
            config = self.single.get(label, self.single.get(name, self.common))
            state = before
            if config.enabled:
                state = self._update(before, name, row, history, boundary)
                state = self._validated(state, config, name, row, history)
            if state.stuck:
                why.append(f"{label} {state.stuck}: not believed")
            elif before.stuck:
                news.append(f"{label}: readings are believed again")
            newly_stuck |= bool(state.stuck and not before.stuck)
            after.append(state)
        return tuple(after), MeterFindings("; ".join(why), "; ".join(news), newly_stuck)

    @cached_property
    def _points(self) -> list[tuple[str, int]]:
        names = self.layout.names
        acting = [(name, row) for name in ("power_W", "heat_W") for row in range(names.rows(name))]
        return [(name, 0) for name in _WEATHER] + acting

    def _label(self, name: str, row: int) -> str:
        return name if name in _WEATHER else self.layout.names.label(name, row)

    def _update(self, state: MeterState, name: str, row: int, history: Record, boundary: Boundary) -> MeterState:
        values = _values(history, name, row)
        value = float(values[-1]) if values.size else math.nan
        at_s, reference = float(history.time_s[values.size - 1]), self._reference(name, row, history, boundary)
        same = math.isclose(value, state.value, rel_tol=_SAME) if math.isfinite(value) else False
        if math.isnan(state.since_s) and math.isfinite(value) and name not in _WEATHER:
            stays = np.isclose(values, value, rtol=_SAME, atol=0.0)
            first = 0 if stays.all() else int(values.size - np.argmin(stays[::-1]))
            # What the last step asked for may show on it in the next.
            since = [self._reference(name, row, history, boundary, k) for k in range(first, values.size - 1)]
            low, high = (of.reduce(since or [math.nan]) for of in (np.fmin, np.fmax))
            return replace(state, value=value, since_s=float(history.time_s[first]), low=float(low), high=float(high))
        if not same:
            return replace(state, value=value, since_s=at_s, low=reference, high=reference, stuck="")
        return replace(state, low=_lesser(state.low, reference), high=-_lesser(-state.high, -reference))

    def _reference(self, name: str, row: int, history: Record, boundary: Boundary, k: int = -1) -> float:
        """What a reading follows: the forecast for now, or the level in step `k`."""
        if name in _WEATHER:
            return float(getattr(boundary, name)[0])
        levels = history.u[:, k] if history.n_steps else np.full(len(self.layout.home), np.nan)
        fed = self.layout.fed_by(row) if name == "power_W" else [row]
        if len(fed) == 1:
            return float(levels[fed[0]])
        # Beyond its capacity a shared machine gives no more, whatever the levels.
        return float(np.minimum(np.sum(self.layout.weights[fed] * levels[fed]), 1.0))

    def _validated(self, state: MeterState, config: MeterConfig, name: str, row: int, history: Record) -> MeterState:
        values = _values(history, name, row)
        at_s = history.time_s[: values.size]
        if not values.size or not math.isfinite(state.value):
            return state
        hours, moved = (float(at_s[-1]) - state.since_s) / HOUR_S, state.high - state.low
        if not state.stuck:
            if not RULES[name].is_frozen(hours, moved, config.frozen_h):
                return state
            magnitudes = np.abs(values[np.isfinite(values)])
            if np.ptp(magnitudes) == 0.0 or (name not in _WEATHER and abs(state.value) <= _NOTHING * magnitudes.max()):
                return state
        reference = "forecast" if name in _WEATHER else "level"
        unit = {"T_out_C": " K", "solar_W_m2": " W/m²"}.get(name, "")
        reading = f"{state.value:.4g} {RULES[name].unit}"
        stuck = f"has been {reading} for {hours:.3g} h, in which its {reference} moved by {moved:.3g}{unit}"
        new = tuple(float(t) for t in at_s[at_s > state.since_s] if float(t) not in state.refused_s)
        return replace(state, stuck=stuck, refused_s=(*state.refused_s, *new))


def _values(history: Record, name: str, row: int) -> Array:
    """The readings of a point: samples (n + 1,), or means over the steps (n,)."""
    values = getattr(history, name)
    return np.asarray(values if values.ndim == 1 else values[row])


def _lesser(a: float, b: float) -> float:
    return b if math.isnan(a) else a if math.isnan(b) else min(a, b)
