"""Conversion of a plant's points and records to the names and units of the package."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from thermoforce_mpc.data import ACTING, Array, Measurement, Record
from thermoforce_mpc.scenario.room_setpoints import RoomSetpoints
from thermoforce_mpc.scenario.testcase import Actuator, Measurements

_KELVIN = 273.15


def interval_means(record: Mapping[str, Array], points: Sequence[str] | Mapping[str, float], edges: Array) -> Array:
    """Return time means of the sum of `points` between `edges` (n + 1,), shape (n,); NaN without points.

    `points` may have a factor each.

    Each sample holds for the time since the previous one: at a switch, the sample at the start of an interval belongs
    to the previous action.
    """
    if not points or edges.size < 2:
        return np.full(edges.size - 1, math.nan)
    time_s = record["time"]
    total = weighted_sum(record, points)
    integral = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * total[1:])])
    return np.asarray(np.diff(np.interp(edges, time_s, integral)) / np.diff(edges))


def weighted_sum(record: Mapping[str, Array], points: Sequence[str] | Mapping[str, float]) -> Array:
    """Return the sum of `points` over the samples of `record`, each times its factor where `points` has factors."""
    factors = points if isinstance(points, Mapping) else dict.fromkeys(points, 1.0)
    return np.asarray(np.sum([factor * record[name] for name, factor in factors.items()], axis=0))


def recorded_level(
    record: Mapping[str, Array], m: Measurements, actuator: Actuator | RoomSetpoints, applied: Mapping[str, Array]
) -> Array:
    """Return the level u of each sample: from the `applied` values of the actuator's `sensed` points.

    Where room set-points act it is the heat to the room over full heat, in range.
    """
    if isinstance(actuator, RoomSetpoints):
        return np.clip(weighted_sum(record, m.heat_factors) / actuator.heating_W, actuator.lowest, 1.0)
    return actuator.level(applied[actuator.point], record[m.zone_temperature] - _KELVIN, applied)


def acting_means(record: Mapping[str, Array], m: Measurements, u: Array, edges: Array) -> dict[str, Array]:
    """Return means between `edges` (n + 1,) of power, heat and return temperature by `Record` names, and `u` (n,)."""
    water = [m.return_water] if m.return_water else []
    return {
        "u": u,
        "power_W": interval_means(record, m.electric_power, edges),
        "heat_W": interval_means(record, m.heat_factors, edges),
        "T_return_C": interval_means(record, water, edges) - _KELVIN,
    }


def past_record(
    record: Mapping[str, Array], m: Measurements, levels: Callable[[Array], Array], now_s: float, step_s: float
) -> Record:
    """Return sampled points as a `Record` at `step_s` that ends at `now_s`; the oldest partial step is dropped.

    `levels` gives the mean actuator level u between edges (n + 1,), shape (n,).
    """
    n = math.floor((now_s - record["time"][0]) / step_s + 1e-9)
    edges: Array = now_s - np.arange(float(n), -1.0, -1.0) * step_s
    T_zone, T_out, solar = (
        np.interp(edges, record["time"], record[name]) for name in (m.zone_temperature, m.outdoor_temperature, m.solar)
    )
    acting = acting_means(record, m, levels(edges), edges)
    return Record(
        time_s=edges,
        T_zone_C=T_zone - _KELVIN,
        T_out_C=T_out - _KELVIN,
        solar_W_m2=solar,
        u=acting["u"],
        power_W=acting["power_W"],
        heat_W=acting["heat_W"],
        T_return_C=acting["T_return_C"],
    )


def measurement(
    time_s: float, points: Mapping[str, float], m: Measurements, acting: Mapping[str, Array] | None = None
) -> Measurement:
    """Return a measurement of one zone: sampled points (NaN if missing), step means `acting` (1,) (NaN if None)."""
    means = dict.fromkeys(ACTING, np.array([math.nan])) if acting is None else acting
    return Measurement(
        time_s=time_s,
        T_zone_C=np.array([points.get(m.zone_temperature, math.nan) - _KELVIN]),
        T_out_C=points.get(m.outdoor_temperature, math.nan) - _KELVIN,
        solar_W_m2=points.get(m.solar, math.nan),
        u=means["u"],
        power_W=means["power_W"],
        heat_W=means["heat_W"],
        T_return_C=means["T_return_C"],
        points=dict(points),
    )
