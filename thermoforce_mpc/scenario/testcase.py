"""Test cases: meaning and unit of each point, and the actuator. One YAML file each, in `configs/testcases`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from thermoforce_mpc.data import Layout
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import read_bounded
from thermoforce_mpc.registry import known_name
from thermoforce_mpc.scenario.actuator import Actuator, RoomSetpoints
from thermoforce_mpc.scenario.building import (
    ELECTRICITY,
    HEAT_IS,
    PRICES,
    ActuatorPoints,
    AnyActuator,
    AnyZoneActuator,
    BuildingPoints,
    Heat,
    HeatMeter,
    Machine,
    Price,
    Zone,
    ZoneActuator,
    ZoneRoomSetpoints,
    layout_of,
)
from thermoforce_mpc.scenario.settings import MOST_BYTES, PointName, StrictModel, one_of, parse_yaml, validate

__all__ = ["PRICES", "Actuator", "ForecastPoints", "MeasuredPoints", "Price", "TestCase"]


_OWN_PLANTS = ("bestest_hydronic", "bestest_air", "rooms", "generated", "small_office")
PlantName = Annotated[str, AfterValidator(known_name("plant", "plants", *_OWN_PLANTS)), one_of(*_OWN_PLANTS)]


class MeasuredWeather(StrictModel):
    """Measured weather. At the plant's interface temperatures are in K, irradiance in W/m²."""

    outdoor_temperature: PointName
    solar: PointName = Field(description="global horizontal irradiance")


class MeasuredPoints(StrictModel):
    """Measured points. At the plant's interface temperatures are in K, powers in W, irradiance in W/m²."""

    zone_temperature: PointName
    outdoor_temperature: PointName
    solar: PointName = Field(description="global horizontal irradiance")
    electric_power: tuple[PointName, ...] = Field(
        min_length=1, description="points whose sum is the power billed at `forecast.price`: electric, or gas"
    )
    heat: Heat = Field((), description=HEAT_IS)
    return_water: PointName | None = Field(
        None, description="return water temperature of the emitters, for the power model"
    )


def _which(measurements: object) -> str:
    known = set(measurements if isinstance(measurements, Mapping) else getattr(measurements, "__dict__", ()))
    return "weather_only" if known <= set(MeasuredWeather.model_fields) else "one_zone"


class ForecastPoints(StrictModel):
    """Forecast points. Temperatures are in K at the plant's interface."""

    outdoor_temperature: PointName = "TDryBul"
    solar: PointName = "HGloHor"
    occupancy: PointName = "Occupancy[1]"
    lower: PointName = "LowerSetp[1]"
    upper: PointName = "UpperSetp[1]"
    heating_price: dict[Price, PointName] | None = Field(
        None, description="price of the carrier of heating where it has one of its own, such as gas; `price` otherwise"
    )
    price: dict[Price, PointName] = Field(ELECTRICITY)
    emission: PointName = "EmissionsElectricPower"


class EnergyPlusZone(StrictModel):
    """EnergyPlus zone of the interventional suite as a plant, and its machine (extra `[energyplus]`)."""

    climate: Literal["heating_chicago", "cooling_phoenix"] = Field(description="building and weather of the suite")
    supply_C: float = Field(description="indoor supply temperature of the machine, °C")
    carnot_share: float = Field(gt=0, lt=1, description="efficiency as a fraction of the Carnot efficiency")
    least_lift_K: float = Field(15.0, gt=0, description="lower limit of the temperature lift, K")
    band_K: float = Field(3.0, gt=0, description="width of the comfort band at daytime, K")
    native_margin_K: float = Field(
        0.3, ge=0, description="distance of the native thermostat's set-point inside the comfort bound, K"
    )
    periods: dict[str, Annotated[int, Field(ge=0, lt=365)]] = Field(
        default_factory=dict, description="named windows: first day of the year, from 0"
    )


class Defaults(StrictModel):
    """Defaults of this building; a scenario overrides them."""

    actuation: dict[str, Any] = Field(default_factory=dict, description="options `actuation` of the MPC and of pi")
    probing: dict[str, Any] = Field(default_factory=dict, description="probing options")
    identification: dict[str, Any] = Field(default_factory=dict, description="identification options")


class TestCase(StrictModel):
    """Building: point names, units, floor area (m²), actuator and default control step (s)."""

    __test__ = False  # not a pytest class, whatever its name

    name: str
    description: str
    floor_area_m2: float | None = Field(None, gt=0, description="heated floor area, m²; of `zones` their sum")
    currency: str = "EUR"
    mode: Literal["heating", "cooling", "both"] = Field(
        "heating",
        description="sign of the actuator's effect on the zone; both: room set-points for heating and cooling",
    )
    step_s: float = Field(3600.0, ge=60, le=86400, description="default control step, s")
    actuator: AnyActuator | None = Field(None, description="the actuator of a building of one zone")
    measurements: Annotated[
        Annotated[MeasuredPoints, Tag("one_zone")] | Annotated[MeasuredWeather, Tag("weather_only")],
        Discriminator(_which),
    ] = Field(
        description="measured points; with `zones` those of the weather, the others stand with zones and machines"
    )
    forecast: ForecastPoints = ForecastPoints()
    zones: dict[str, Zone] = Field(default_factory=dict, description="zones of a building of several, by name")
    actuators: dict[str, AnyZoneActuator] = Field(default_factory=dict, description="their actuators, by name")
    machines: dict[str, Machine] = Field(default_factory=dict, description="what feeds the actuators, by name")
    exclusive: tuple[tuple[str, ...], ...] = Field(
        (), description="groups of actuators, by name, of which at most one may act in a control step"
    )
    thermostat_C: float | None = Field(
        None, description="set-point of the baseline on/off thermostat, °C; default: that thermostat's own"
    )
    defaults: Defaults = Defaults()
    energyplus: EnergyPlusZone | None = Field(None, description="EnergyPlus zone of this test case")
    embedded: bool = Field(False, description="whether the embedded emulator implements this test case")
    plant: PlantName | None = Field(
        None, description="plant that implements this test case: one of our own or a plugin's (`tf-mpc plants`)"
    )

    @property
    def layout(self) -> Layout:
        """What acts where."""
        return self.points.layout

    @property
    def area_m2(self) -> float:
        """Floor area of the building, m²."""
        return self.floor_area_m2 or sum(zone.floor_area_m2 for zone in self.zones.values())

    @cached_property
    def points(self) -> BuildingPoints:
        """Points of all zones, actuators and machines; one of each where the file has `actuator`."""
        f = self.forecast
        weather = (self.measurements.outdoor_temperature, self.measurements.solar, f.outdoor_temperature, f.solar)
        if self.zones:
            acting = []
            for name, one in self.actuators.items():
                meter = HeatMeter(one.heat, self.zones[one.zone].temperature)
                acting.append(ActuatorPoints(one, meter, f"actuators.{name}", getattr(one, "full_W", None)))
            layout = layout_of(self.zones, self.actuators, self.machines, self.exclusive)
            zones, machines = tuple(self.zones.values()), tuple(self.machines.values())
            return BuildingPoints(layout, zones, tuple(acting), machines, *weather)
        m, actuator = self.metered, self.actuator
        assert actuator is not None  # checked by `_one_form`
        zone = Zone(
            temperature=m.zone_temperature,
            floor_area_m2=self.area_m2,
            occupancy=f.occupancy,
            lower=f.lower,
            upper=f.upper,
            thermostat_C=self.thermostat_C,
        )
        machine = Machine(
            power=m.electric_power,
            return_water=m.return_water,
            price=f.price,
            heating_price=f.heating_price,
            emission=f.emission,
        )
        layout = Layout.single(self.mode, getattr(actuator, "u_min", 0.0), self.area_m2)
        acts = ActuatorPoints(actuator, HeatMeter(m.heat, m.zone_temperature), "actuator")
        return BuildingPoints(layout, (zone,), (acts,), (machine,), *weather)

    @property
    def metered(self) -> MeasuredPoints:
        """Measured points of a building of one zone; raises `ConfigError` for one of several."""
        if isinstance(self.measurements, MeasuredPoints):
            return self.measurements
        raise ConfigError(f"test case '{self.name}' has several zones: this plant has one")

    @model_validator(mode="after")
    def _one_form(self) -> TestCase:
        if not self.zones:
            if self.actuators or self.machines or self.exclusive:
                raise ValueError("actuators, machines and exclusive belong to zones: name the zones")
            if self.actuator is None or self.floor_area_m2 is None or not isinstance(self.measurements, MeasuredPoints):
                raise ValueError(
                    "a building of one zone needs floor_area_m2, actuator and measurements.zone_temperature and "
                    "electric_power; one of several zones, actuators and machines"
                )
            room = isinstance(self.actuator, RoomSetpoints)
            if room != (self.mode == "both"):
                raise ValueError("mode both and an actuator of kind room_setpoints belong together")
            if room and not self.measurements.heat:
                raise ValueError(
                    "an actuator of kind room_setpoints needs measurements.heat: the level is heat over full heat"
                )
            return self
        if self.actuator is not None or isinstance(self.measurements, MeasuredPoints):
            raise ValueError(
                "with zones, leave out actuator and what measurements has besides the weather: those points stand with "
                "zones, actuators and machines"
            )
        if not self.actuators:
            raise ValueError("actuators: name one or more, each with its zone and machine")
        layout_of(self.zones, self.actuators, self.machines, self.exclusive)
        for name, one in self.actuators.items():
            if isinstance(one, RoomSetpoints) and not one.heat:
                raise ValueError(f"actuators.{name}: room set-points need heat: the level is heat over full heat")
        for name, machine in self.machines.items():
            self._check_held(f"machines.{name}", machine)
        return self

    def _check_held(self, key: str, machine: Machine) -> None:
        """Refuse points of a machine that something else sets too, or that a plant of our own would ignore."""
        others = {f"machines.{name}": each.points for name, each in self.machines.items() if each is not machine}
        others |= {f"actuators.{name}": one.points for name, one in self.actuators.items()}
        for point in machine.points:
            for other, points in others.items():
                if point in points:
                    what = "held" if point in machine.held else "supply"
                    raise ValueError(f"{key}.{what}: '{point}' is a point of {other} as well")
        if self.plant is not None and (machine.points or machine.running):
            raise ValueError(
                f"{key}: the plant '{self.plant}' has no overwrite points, it would ignore held, supply and running"
            )
        for name, one in self.actuators.items():
            if self.machines.get(one.machine) is not machine:
                continue
            if machine.supply is not None and not _is_valve(one):
                raise ValueError(
                    f"actuators.{name}: {key}.supply asks for valves with heat and full_W, of kind level and map "
                    "linear, without held points"
                )
            if machine.supply is None and isinstance(one, ZoneActuator) and one.full_W is not None:
                raise ValueError(f"actuators.{name}: full_W belongs to a machine with supply, which {key} has not")

    @model_validator(mode="after")
    def _emulators_take_the_level(self) -> TestCase:
        if not (self.embedded or self.energyplus) or self.actuator is None:
            return self
        plant = "energyplus" if self.energyplus else "embedded"
        whose = "has the level as heat" if self.energyplus else "has the level as compressor speed"
        for key, value, plain in self.actuator.beside_the_level(1.0 if self.embedded else None):
            if value != plain:
                raise ValueError(
                    f"actuator.{key}: {value}, but the plant of `{plant}` {whose} and would ignore it: "
                    f"leave it out or write {plain}, or leave `{plant}` out and run with --url or --fmu"
                )
        return self


def _is_valve(one: ZoneActuator | ZoneRoomSetpoints) -> bool:
    """Whether an actuator can be left open while the water of its machine says what it gives, and its heat is known."""
    if not isinstance(one, ZoneActuator):
        return False
    return bool(one.full_W and one.heat) and one.kind == "level" and one.map == "linear" and not one.held


def read_testcase(path: Path) -> TestCase:
    """The test case in a YAML file; raises `ConfigError` naming file and key."""
    return _of_content(path, read_bounded(path, MOST_BYTES, ConfigError))


@lru_cache(maxsize=64)
def _of_content(path: Path, content: bytes) -> TestCase:
    """The test case in a file of this content; that of a scenario is asked for several times before it is run."""
    return validate(TestCase, parse_yaml(content, path), str(path))
