"""Points of a test case file: checked against a plant, and converted to the names and units of the package.

Every point must exist in the expected unit and within its limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from boptest_client import Point
from thermoforce_mpc.data import ACTING, ZERO_C_K, Array, Block, Boundary, Measurement, Record
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.shell import plant_inputs
from thermoforce_mpc.scenario.actuator import Actuator, RoomSetpoints
from thermoforce_mpc.scenario.building import BuildingPoints, HeatMeter, Machine, Price, weighted_sum
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.scenario.testcase import TestCase

_KELVIN, _POWER, _IRRADIANCE = "K", "W", "W/m2"


class _Wanted(NamedTuple):
    """Key of the test case file, the point it names, the points offered, and the expected unit (None: any)."""

    key: str
    point: str
    offered: Mapping[str, Point]
    unit: str | None = None


def check_points(
    testcase: TestCase,
    inputs: Mapping[str, Point],
    measured: Mapping[str, Point],
    forecast: Mapping[str, Point],
    plant: str = "the service",
) -> None:
    """Compare a test case file with the points that `plant` offers.

    Raises `ConfigError`, which lists every key that names an unknown point or one in another unit, and every value that
    the plant would silently clip.
    """
    points, several = testcase.points, bool(testcase.zones)
    wanted = [
        _Wanted("measurements.outdoor_temperature", points.outdoor_temperature, measured, _KELVIN),
        _Wanted("measurements.solar", points.solar, measured, _IRRADIANCE),
        _Wanted("forecast.outdoor_temperature", points.forecast_outdoor, forecast, _KELVIN),
        _Wanted("forecast.solar", points.forecast_solar, forecast, _IRRADIANCE),
    ]
    for one in points.actuators:
        wanted += _actuator_points(one.key, one.actuator, inputs)
        key = f"{one.key}.heat" if several else "measurements.heat"
        wanted += [_Wanted(key, name, measured, unit) for name, unit in one.heat.units.items()]
    for zone, name in zip(points.zones, points.layout.names.zones, strict=True):
        key = f"zones.{name}.temperature" if several else "measurements.zone_temperature"
        of = f"zones.{name}" if several else "forecast"
        wanted += [
            _Wanted(key, zone.temperature, measured, _KELVIN),
            _Wanted(f"{of}.occupancy", zone.occupancy, forecast),
            _Wanted(f"{of}.lower", zone.lower, forecast, _KELVIN),
            _Wanted(f"{of}.upper", zone.upper, forecast, _KELVIN),
        ]
    for machine, name in zip(points.machines, points.layout.names.machines, strict=True):
        wanted += _machine_points(machine, f"machines.{name}" if several else "", inputs, measured, forecast)
    wrong = [problem for item in wanted if (problem := _problem(item, plant))]
    for key, name, value in _values(points):
        known = inputs.get(f"{name}_u")
        if known is not None:
            wrong += _clipped(key, value, known, plant)
    if wrong:
        raise ConfigError(f"test case '{testcase.name}' does not fit {plant}:\n  " + "\n  ".join(wrong))


def _machine_points(
    machine: Machine,
    at: str,
    inputs: Mapping[str, Point],
    measured: Mapping[str, Point],
    forecast: Mapping[str, Point],
) -> list[_Wanted]:
    """The points of a machine, whose keys stand `at` its own; of one zone's, "": at those of the test case."""
    of, power = at or "measurements", f"{at}.power" if at else "measurements.electric_power"
    wanted = [_Wanted(power, point, measured, _POWER) for point in machine.power]
    if machine.return_water:
        wanted.append(_Wanted(f"{of}.return_water", machine.return_water, measured, _KELVIN))
    of = at or "forecast"
    wanted += [_Wanted(f"{of}.price.{key}", point, forecast) for key, point in machine.price.items()]
    heating = machine.heating_price or {}
    wanted += [_Wanted(f"{of}.heating_price.{key}", point, forecast) for key, point in heating.items()]
    wanted.append(_Wanted(f"{of}.emission", machine.emission, forecast))
    if machine.running:
        wanted.append(_Wanted(f"{of}.running", f"{machine.running}_u", inputs))
    for held in machine.held:
        wanted += [_Wanted(f"{of}.held.{held}", f"{held}_{end}", inputs) for end in ("u", "activate")]
    if machine.supply:
        key, point = f"{of}.supply.point", machine.supply.point
        wanted += [_Wanted(key, f"{point}_u", inputs, _KELVIN), _Wanted(key, f"{point}_activate", inputs)]
    return wanted


def _values(points: BuildingPoints) -> list[tuple[str, str, float]]:
    """The values that a test case would write: key, name of the point and value of each."""
    values = [
        (f"{one.key}.{key}", name, value)
        for one in points.actuators
        for key, name, value in _actuator_values(one.actuator)
    ]
    for machine, name in zip(points.machines, points.layout.names.machines, strict=True):
        for group, at in (("held", machine.held), ("idle", machine.idle)):
            values += [(f"machines.{name}.{group}.{held}", held, value) for held, value in at.items()]
        if machine.supply:
            ends = (("minimum", machine.supply.minimum), ("maximum", machine.supply.maximum))
            values += [(f"machines.{name}.supply.{end}", machine.supply.point, value) for end, value in ends]
    return values


def _actuator_points(at: str, actuator: Actuator | RoomSetpoints, inputs: Mapping[str, Point]) -> list[_Wanted]:
    """Overwrite points of an actuator, each with its activation; set-points and levels in the actuator's unit."""
    if isinstance(actuator, RoomSetpoints):
        main = {"heating": actuator.heating, "cooling": actuator.cooling}
        held = {f"{side}_held.{n}": n for side in main for n in getattr(actuator, f"{side}_held")}
    else:
        main, held = {"point": actuator.point}, {f"held.{name}": name for name in actuator.held}
    wanted = [_Wanted(f"{at}.{key}", f"{name}_u", inputs, actuator.unit) for key, name in main.items()]
    wanted += [_Wanted(f"{at}.{key}", f"{name}_u", inputs) for key, name in held.items()]
    return wanted + [_Wanted(f"{at}.{key}", f"{name}_activate", inputs) for key, name in (main | held).items()]


def _actuator_values(actuator: Actuator | RoomSetpoints) -> list[tuple[str, str, float]]:
    """Values that the plant must not clip: key, point and value."""
    values: list[tuple[str, str, float]]
    if isinstance(actuator, RoomSetpoints):
        # Set-points that a release limits to less are clipped there: the loop then keeps the nearest it can.
        values = []
        held = {"heating_held": actuator.heating_held, "cooling_held": actuator.cooling_held}
    else:
        values = [("minimum", actuator.point, actuator.minimum), ("maximum", actuator.point, actuator.maximum)]
        held = {"held": actuator.held}
    return values + [(f"{key}.{name}", name, value) for key, group in held.items() for name, value in group.items()]


def _problem(wanted: _Wanted, plant: str) -> str:
    point = wanted.offered.get(wanted.point)
    if point is None:
        return f"{wanted.key}: {plant} has no point '{wanted.point}'{suggestion(wanted.point, wanted.offered)}"
    if wanted.unit is not None and point.unit is not None and point.unit != wanted.unit:
        return f"{wanted.key}: '{wanted.point}' is in {point.unit} at {plant}, expected {wanted.unit}"
    return ""


def _clipped(key: str, value: float, point: Point, plant: str) -> list[str]:
    low = point.minimum if point.minimum is not None else value
    high = point.maximum if point.maximum is not None else value
    if low <= value <= high:
        return []
    return [f"{key}: {value:.10g} lies outside the limits of '{point.name}' at {plant}, {low:g} to {high:g}"]


# Applied value above which the signal of a machine's pump or fan means that it runs, and share from which a valve is
# open.
_RUNS, _OPEN = 1e-3, 0.5


def interval_means(record: Mapping[str, Array], points: Sequence[str] | Mapping[str, float], edges: Array) -> Array:
    """Return time means of the sum of `points` between `edges` (n + 1,), shape (n,); NaN without points.

    `points` may have a factor each. Each sample holds for the time since the previous one: at a switch, the sample at
    the start of an interval belongs to the previous action.
    """
    if not points or edges.size < 2:
        return np.full(edges.size - 1, math.nan)
    return means_between(record["time"], weighted_sum(record, points)[1:], edges)


def recorded_levels(record: Mapping[str, Array], points: BuildingPoints, applied: Mapping[str, Array]) -> Array:
    """Return the levels (A, n) of n samples: from the `applied` values of the points that the actuators sense.

    Where room set-points act it is the heat to the room over full heat, in range. While a machine does not run, the
    levels of its actuators are 0. Where the plan sets a machine's water, it is the heat of each valve over full heat.
    """
    rows = []
    for one, home, m in zip(points.actuators, points.layout.home, points.layout.machine_of, strict=True):
        actuator, running = one.actuator, points.machines[m].running
        if isinstance(actuator, RoomSetpoints):
            level = np.clip(one.heat.heat_W(record) / actuator.heating_W, actuator.u_min, 1.0)
        elif one.full_W is not None:
            level = np.clip(one.heat.heat_W(record) / one.full_W, 0.0, 1.0)
        else:
            room_C = record[points.zones[home].temperature] - ZERO_C_K
            level = actuator.level(applied[actuator.point], room_C, applied)
        rows.append(level if running is None else np.where(applied[running] > _RUNS, level, 0.0))
    return np.stack(rows)


def mean_levels(record: Mapping[str, Array], points: BuildingPoints, edges: Array, suffix: str) -> Array:
    """Return mean levels (A, n) between `edges` (n + 1,); `suffix`: of the points that `record` has as applied."""
    applied = {name: record[f"{name}{suffix}"] for name in points.sensed}
    return means_between(record["time"], recorded_levels(record, points, applied)[:, 1:], edges)


def heat_means(record: Mapping[str, Array], meter: HeatMeter, edges: Array) -> Array:
    """Return the mean heat between `edges` (n + 1,), W, shape (n,); NaN where it is not measured."""
    if not meter.units or edges.size < 2:
        return np.full(edges.size - 1, math.nan)
    return means_between(record["time"], meter.heat_W(record)[1:], edges)


def acting_means(record: Mapping[str, Array], points: BuildingPoints, u: Array, edges: Array) -> dict[str, Array]:
    """Return means between `edges` (n + 1,) by `Record` names: power and return water (M, n), heat and `u` (A, n)."""

    def of_machines(names: Callable[[Machine], Sequence[str] | Mapping[str, float]]) -> Array:
        return np.stack([interval_means(record, names(machine), edges) for machine in points.machines])

    return {
        "u": u,
        "power_W": of_machines(lambda machine: machine.power),
        "heat_W": np.stack([heat_means(record, one.heat, edges) for one in points.actuators]),
        "T_return_C": of_machines(lambda m: [m.return_water] if m.return_water else []) - ZERO_C_K,
    }


def past_record(record: Mapping[str, Array], points: BuildingPoints, levels: Array, edges: Array) -> Record:
    """Return sampled points as a `Record` of the steps between `edges` (n + 1,), s, with mean `levels` (A, n)."""
    names = (*points.temperatures, points.outdoor_temperature, points.solar)
    *T_zone, T_out, solar = (np.interp(edges, record["time"], record[name]) for name in names)
    acting: dict[str, Any] = dict(acting_means(record, points, levels, edges))
    T_zone_C = np.stack(T_zone) - ZERO_C_K
    return Record(edges, T_zone_C, T_out - ZERO_C_K, solar, **acting, names=points.layout.names)


def measurement(
    time_s: float, values: Mapping[str, float], points: BuildingPoints, acting: Mapping[str, Array] | None = None
) -> Measurement:
    """Return a measurement: sampled `values` by point (NaN if missing), step means `acting` (rows, 1) (NaN if None)."""
    means: dict[str, Any] = {name: np.empty(0) if acting is None else acting[name][:, 0] for name in ACTING}
    return Measurement(
        time_s=time_s,
        T_zone_C=np.array([values.get(name, math.nan) for name in points.temperatures]) - ZERO_C_K,
        T_out_C=values.get(points.outdoor_temperature, math.nan) - ZERO_C_K,
        solar_W_m2=values.get(points.solar, math.nan),
        **means,
        points=dict(values),
        names=points.layout.names,
    )


def boundary(
    time_s: Array, values: Mapping[str, Array], points: BuildingPoints, price: Price, weather: tuple[Array, Array]
) -> Boundary:
    """Return the boundary conditions from forecast points, `values` (N + 1,) by name, with `weather` °C and W/m²."""

    def of_zones(name: str) -> Array:
        return np.stack([values[getattr(zone, name)] for zone in points.zones])

    heating = [machine.heating_price or machine.price for machine in points.machines]
    return Boundary(
        time_s=time_s,
        T_out_C=weather[0],
        solar_W_m2=weather[1],
        occupancy=of_zones("occupancy"),
        lower_C=of_zones("lower") - ZERO_C_K,
        upper_C=of_zones("upper") - ZERO_C_K,
        price_per_kWh=np.stack([values[machine.price[price]] for machine in points.machines]),
        emission_kg_per_kWh=np.stack([values[machine.emission] for machine in points.machines]),
        heating_price_per_kWh=np.stack([values[prices[price]] for prices in heating]),
        names=points.layout.names,
    )


def inputs(points: BuildingPoints, block: Block, T_zone_C: Array, last: Measurement | None = None) -> dict[str, float]:
    """Return the inputs of all actuators for a block with the zones at `T_zone_C` (Z,), °C; raises as `plant_inputs`.

    A point that one actuator holds and another releases stays held. The points of a machine come after its actuators'.
    Where the plan sets a machine's water, its valves are open or closed, and the water follows from the heat that is
    asked of the neediest and what it gave in the `last` block.
    """
    out: dict[str, float] = {}
    layout = points.layout
    rooms_C = [float(T_zone_C[home]) for home in layout.home]
    for a, (one, m) in enumerate(zip(points.actuators, layout.machine_of, strict=True)):
        u = block.u[a]
        if points.machines[m].supply is not None and u:
            u = 1.0
        for name, value in plant_inputs(one.actuator, u, block.command[a], rooms_C[a]).items():
            out[name] = max(out.get(name, value), value) if name.endswith("_activate") else value
    for m, machine in enumerate(points.machines):
        fed = layout.fed_by(m)
        acting = {a: u for a in fed if (u := block.u[a])}
        supply_K = math.nan
        if machine.supply is not None and acting:
            neediest = max(acting, key=lambda a: acting[a])
            supply_K = _supply_K(points, machine, neediest, acting[neediest], rooms_C[neediest], last)
        out |= machine.inputs([block.u[a] for a in fed], supply_K)
    return out


def _supply_K(
    points: BuildingPoints, machine: Machine, a: int, u: float, room_C: float, last: Measurement | None
) -> float:
    """Set-point of the water of a machine with `supply`, K, for level `u` of its valve `a`, room at `room_C` °C.

    A floor whose valve was closed is at least as warm as the room; the water that last came back tells more.
    """
    assert machine.supply is not None  # where it is called
    one, floor_C, before_K, gave_W = points.actuators[a], room_C, math.nan, math.nan
    if last is not None and last.heat_W.size and _open(one.actuator, last):
        before_K, gave_W = _applied(last, machine.supply.point), float(last.heat_W[a])
    elif last is not None and machine.return_water is not None:
        floor_C = float(np.fmax(last.points.get(machine.return_water, math.nan) - ZERO_C_K, room_C))
    return machine.supply.value(u * (one.full_W or 0.0), floor_C, before_K, gave_W)


def _open(valve: Actuator | RoomSetpoints, last: Measurement) -> bool:
    """Whether a valve was open in the last block; False where the plant does not tell."""
    assert isinstance(valve, Actuator)  # checked by the test case
    return (_applied(last, valve.point) - valve.minimum) / (valve.maximum - valve.minimum) > _OPEN


def _applied(last: Measurement, point: str) -> float:
    """Value of an overwrite point in the last block; NaN where the plant does not tell."""
    return float(last.points.get(f"{point}_y", last.points.get(f"{point}_u", math.nan)))
