"""A test case file proposed from the points that a BOPTEST service lists, with what is not certain marked by CHECK."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from boptest_client import BoptestClient, BoptestError, Point, TransportConfig
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.building import PRICES

# What points are, by names and descriptions as BOPTEST's test cases have them.
_ROOM = re.compile(r"(?i)\b(zone|room|operative)\b")
_NO_ROOM = re.compile(
    r"(?i)set ?point|supply|discharge|return|floor temp|percentile|average floor|mixed|leaving|outside"
)
_COOLING = re.compile(r"(?i)\bcool|chill|_?coo(?![a-z])|oveCoo|SetCoo|EmiCoo|AhuCoo|ProCoo")
_LOADS = re.compile(r"(?i)light|plug|internal|gains|exchanged|delivered|floor heating|radiant")
_FUEL = re.compile(r"(?i)\bgas\b|thermal power|district|boiler power")
_MACHINE = re.compile(r"(?i)heat pump|compressor|boiler|heating production|gas|district|heating thermal|heater")
_HEAT = re.compile(r"(?i)exchanged in the condenser|heating delivered|floor heating (thermal )?power")
_ASIDE = re.compile(r"(?i)damper|bypass|mixing|air handling|\bahu\b|coil|freeze|pressure|co2|chiller|evaporator|tower")
# Inputs by which a room may be heated, the surest first: what they are called, their unit, and what u is.
_KINDS = (
    (re.compile(r"(?i)compressor|modulating signal"), "1", "level"),
    (re.compile(r"(?i)valve"), "1", "level"),
    (re.compile(r"(?i)reheat|heating (control )?signal"), "1", "level"),
    (re.compile(r"(?i)supply (water )?temperature set ?point|system supply temperature"), "K", "radiator"),
    (re.compile(r"(?i)\bfan\b"), "1", "fan_coil"),
    (re.compile(r"(?i)zone .*temperature.*set ?point|set ?point temperature|temperature set ?point"), "K", "setpoint"),
)
_PUMP = re.compile(r"(?i)\bpump\b")
_ROOM_SETPOINTS_K = (288.15, 298.15)
_AREA_M2 = 100.0
_FUELS = (
    ("DistrictHeating", re.compile(r"(?i)district")), ("Gas", re.compile(r"(?i)gas|boiler|thermal")),
)  # fmt: skip


@dataclass(frozen=True)
class ServicePoints:
    """Points of a test case as a service lists them."""

    inputs: Mapping[str, Point]
    measurements: Mapping[str, Point]
    forecast: Mapping[str, Point]


def points_of_service(url: str, testcase: str) -> ServicePoints:
    """The points of a test case at a service, which is selected and stopped again.

    Raises `ConfigError` where nothing answers there, or has no such test case; it says which there are.
    """
    try:
        with BoptestClient(url, testcase, config=TransportConfig()) as client:
            return ServicePoints(client.inputs(), client.measurements(), client.forecast_points())
    except BoptestError as error:
        raise ConfigError(f"--from-url {url}: {error}") from error


def proposed_testcase(name: str, points: ServicePoints) -> str:
    """The text of a test case file for `points`; raises `ConfigError` where they have no zone or nothing heats one.

    Heated zones are planned; a building that is cooled, or has loops of its own for both, is written by hand.
    """
    return "\n".join(_Proposal(name, points).lines()) + "\n"


class _NotHeated(ConfigError):
    """No input heats a zone."""


class _Proposal:
    def __init__(self, name: str, points: ServicePoints) -> None:
        self.name, self.points = name, points
        self.inputs = {key.removesuffix("_u"): one for key, one in points.inputs.items() if key.endswith("_u")}
        self.keys = sorted({match[1] for key in points.forecast if (match := re.match(r"LowerSetp\[(.+)\]$", key))})
        if not self.keys:
            raise ConfigError(
                f"{name}: no forecast point LowerSetp[...]: the service names no zone with a comfort band"
            )
        self.several = len(self.keys) > 1

    def lines(self) -> list[str]:
        head = [
            f"# Test case {self.name}, proposed from the points that its service lists: check every line, above all",
            "# those with CHECK; docs/reference/testcase.md has all keys. Other inputs than those named stay native.",
            f"name: {self.name}",
            f"description: {self.name}, proposed from its service's points",
            "currency: EUR  # CHECK: the service's prices are in EUR or USD",
            "step_s: 900" if self.several else "step_s: 3600",
        ]
        outdoor = self.measured("outdoor temperature", r"TDryBul|drybulb|outdoor.*temperature", "K")
        sun = self.measured("global horizontal irradiance", r"HGloHor|global horizontal", "W/m2")
        weather = [f"  outdoor_temperature: {outdoor}", f"  solar: {sun}"]
        return head + (self._zones(weather) if self.several else self._one_zone(weather))

    def measured(self, what: str, pattern: str, unit: str) -> str:
        found = [key for key, one in self.points.measurements.items() if _says(pattern, one) and one.unit == unit]
        if not found:
            raise ConfigError(f"{self.name}: no measurement in {unit} looks like the {what}")
        return found[0]

    def _one_zone(self, weather: list[str]) -> list[str]:
        zone = self.temperature(self.keys[0])
        held, actuator = self.actuator(self.keys[0])
        power, carrier, left = self.power()
        heat = [
            key for key, one in self.points.measurements.items() if one.unit == "W" and _HEAT.search(one.description)
        ]
        heat = [key for key in heat if "condenser" in self.points.measurements[key].description] or heat[:1]
        return [
            f"floor_area_m2: {_AREA_M2:g}  # CHECK: no service tells it; cost per m² and the comfort weight go by it",
            "mode: heating",
            *actuator_lines("actuator:", actuator, "  "),
            *held,
            "measurements:",
            f"  zone_temperature: {zone}",
            *weather,
            f"  electric_power: [{', '.join(power)}]  # billed at forecast.price" + left,
            f"  heat: [{', '.join(heat)}]" + ("" if heat else "  # not measured"),
            "forecast:",
            *(f'  {key}: "{point}"' for key, point in self.of_zone(self.keys[0]).items()),
            *carrier_lines(carrier, "  "),
        ]

    def _zones(self, weather: list[str]) -> list[str]:
        power, carrier, left = self.power()
        zones, actuators = ["zones:"], ["actuators:"]
        for key in self.keys:
            try:
                held, actuator = self.actuator(key)
            except _NotHeated:
                continue  # not by itself: not planned
            zones += [f"  {key}:", f"    temperature: {self.temperature(key)}"]
            zones.append(f"    floor_area_m2: {_AREA_M2:g}" + ("  # CHECK: no service tells it" * (len(zones) == 3)))
            zones += [f'    {what}: "{point}"' for what, point in self.of_zone(key).items()]
            heat = self.matching(
                key,
                {k: p for k, p in self.points.measurements.items() if p.unit == "W" and _HEAT.search(p.description)},
            )
            actuators += [f"  {key}_heating:", f"    zone: {key}", "    machine: machine"]
            actuators += [*actuator_lines("", actuator, "    "), *(f"  {line}" for line in held)]
            if heat:
                actuators.append(f"    heat: [{heat[0]}]")
        if len(actuators) == 1:
            raise ConfigError(f"{self.name}: no input heats a single zone; write the test case by hand")
        machine = ["machines:", "  machine:", f"    power: [{', '.join(power)}]  # CHECK: billed at price{left}"]
        return ["measurements:", *weather, *zones, *actuators, *machine, *carrier_lines(carrier, "    ")]

    def of_zone(self, key: str) -> dict[str, str]:
        return {"occupancy": f"Occupancy[{key}]", "lower": f"LowerSetp[{key}]", "upper": f"UpperSetp[{key}]"}

    def temperature(self, key: str) -> str:
        rooms = {
            name: one for name, one in self.points.measurements.items()
            if one.unit == "K" and _ROOM.search(one.description) and "temperature" in one.description.lower()
            and not _NO_ROOM.search(one.description) and not re.search(r"reaWea", name)
        }  # fmt: skip
        found = self.matching(key, rooms) if self.several else list(rooms)
        if not found:
            raise ConfigError(f"{self.name}: no measured temperature of zone {key}")
        return found[0]

    def matching(self, key: str, among: Mapping[str, Point]) -> list[str]:
        """The points that are of zone `key`: it stands in their name or description, or its first letters do."""
        for word in (key, key[:3]):
            found = [
                name
                for name, one in among.items()
                if re.search(rf"(?i)(?<![a-z]){re.escape(word)}(?![a-z])", one.description)
                or re.search(rf"(?i:{re.escape(word)})(?![a-z])", name)
            ]
            if found:
                return found
        return []

    def actuator(self, key: str) -> tuple[list[str], dict[str, str]]:
        """Lines of what is held while it acts, and keys of the actuator of a zone."""
        heating = {name: one for name, one in self.inputs.items() if not _COOLING.search(f"{one.description} {name}")}
        for pattern, unit, how in _KINDS:
            able = {name: one for name, one in heating.items() if one.unit == unit and pattern.search(one.description)}
            if how in ("level", "radiator"):
                able = {name: one for name, one in able.items() if not _ASIDE.search(one.description)}
                able = {name: one for name, one in able.items() if how == "radiator" or not _of_pump(one)}
            found = self.matching(key, able) if self.several else list(able)
            if found:
                return self._acting(key, found[0], able[found[0]], how, heating)
        raise _NotHeated(f"{self.name}: no input heats zone {key}; write the test case by hand")

    def _acting(
        self, key: str, name: str, point: Point, how: str, heating: Mapping[str, Point]
    ) -> tuple[list[str], dict[str, str]]:
        low, high = point.minimum or 0.0, 1.0 if point.maximum is None else point.maximum
        out = {"point": f"{name}  # CHECK: {point.description}"}
        if how == "level":
            return [], out | {"minimum": f"{low:g}", "maximum": f"{high:g}"}
        if how == "setpoint":
            low, high = max(low, _ROOM_SETPOINTS_K[0]), min(high, _ROOM_SETPOINTS_K[1])
            return [], out | {"minimum": f"{low:g}", "maximum": f"{high:g}", "unit": "K", "kind": "setpoint"}
        if how == "fan_coil":
            supply = [
                other for other, one in heating.items() if one.unit == "K" and "upply air" in one.description
            ]  # fmt: skip
            if not supply:
                return [], out | {"minimum": f"{low:g}", "maximum": f"{high:g}"}
            warm = heating[supply[0]].maximum or 313.15
            keys = {"minimum": f"{low:g}", "maximum": f"{high:g}", "map": "fan_coil", "supply": supply[0]}
            return [f"  held: {{{supply[0]}: {warm:g}}}"], out | keys
        pumps = {
            other: one
            for other, one in heating.items()
            if one.unit == "1" and _of_pump(one) and not _ASIDE.search(one.description)
        }
        pump = (self.matching(key, pumps) if self.several else []) or list(pumps)[:1]
        keys = {"minimum": f"{low:g}", "maximum": f"{high:g}", "unit": "K", "map": "radiator"}
        if not pump:
            return [], out | keys
        return [f"  held: {{{pump[0]}: 1}}"], out | keys | {"switch": f"{pump[0]}  # off at u = 0"}

    def power(self) -> tuple[list[str], str, str]:
        """Points whose sum is billed at one price, the carrier, and a comment on those of another one."""
        loads = {
            name: one for name, one in self.points.measurements.items()
            if one.unit == "W" and not _LOADS.search(one.description) and not _COOLING.search(one.description)
        }  # fmt: skip
        fuel = {name: one for name, one in loads.items() if _FUEL.search(one.description)}
        electric = {name: one for name, one in loads.items() if name not in fuel}
        machine = {
            name: one for name, one in electric.items() if _MACHINE.search(one.description) and not _of_pump(one)
        }
        if not loads:
            raise ConfigError(f"{self.name}: no measured power in W")
        if machine or not fuel:
            return list(electric), "", ""
        left = f"; left out, at the price of electricity: {', '.join(electric)}" if electric else ""
        told = " ".join(one.description for one in fuel.values())
        carrier = next((c for c, says in _FUELS if says.search(told) and f"Price{c}Power" in self.points.forecast), "")
        return list(fuel), carrier, left


def actuator_lines(head: str, keys: Mapping[str, str], indent: str) -> list[str]:
    """Lines of an actuator's keys."""
    return [*([head] if head else []), *(f"{indent}{key}: {value}" for key, value in keys.items())]


def carrier_lines(carrier: str, indent: str) -> list[str]:
    """Lines of the price and the emissions of a carrier, none for electricity, which is the default."""
    if not carrier:
        return []
    same = ", ".join(f"{tariff}: Price{carrier}Power" for tariff in PRICES)
    return [f"{indent}price: {{{same}}}", f"{indent}emission: Emissions{carrier}Power"]


def _of_pump(one: Point) -> bool:
    """Whether a point is of a pump of water."""
    return bool(_PUMP.search(re.sub(r"(?i)heat pump", "", one.description)))


def _says(pattern: str, one: Point) -> bool:
    return bool(re.search(pattern, f"{one.name} {one.description}", re.I))
