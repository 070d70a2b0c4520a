"""Check of a test case file against a plant: every point must exist in the expected unit and within its limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from boptest_client import Point
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.scenario.testcase import Actuator, TestCase

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
        of = f"machines.{name}" if several else "measurements"
        power = f"{of}.power" if several else f"{of}.electric_power"
        wanted += [_Wanted(power, point, measured, _POWER) for point in machine.power]
        if machine.return_water:
            wanted.append(_Wanted(f"{of}.return_water", machine.return_water, measured, _KELVIN))
        of = f"machines.{name}" if several else "forecast"
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
    wrong = [problem for item in wanted if (problem := _problem(item, plant))]
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
    for key, name, value in values:
        known = inputs.get(f"{name}_u")
        if known is not None:
            wrong += _clipped(key, value, known, plant)
    if wrong:
        raise ConfigError(f"test case '{testcase.name}' does not fit {plant}:\n  " + "\n  ".join(wrong))


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
    return [f"{key}: {value:g} lies outside the limits of '{point.name}' at {plant}, {low:g} to {high:g}"]
