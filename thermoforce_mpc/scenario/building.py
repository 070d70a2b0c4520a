"""Zones, actuators and machines of a test case, the points of each at the plant's interface, and heat from points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from thermoforce_mpc.data import ZERO_C_K, Array, Layout, Names
from thermoforce_mpc.errors import suggestion
from thermoforce_mpc.scenario.actuator import Actuator, RoomSetpoints
from thermoforce_mpc.scenario.settings import Factor, PointName, StrictModel, check_range

# Dry air at 20 °C: 1.2 kg/m³ · 1006 J/kgK.
AIR_J_M3K = 1207.0

HEAT_IS = (
    "points whose sum is the delivered heat, W; empty if not measured. With a factor each, heat from metered power: an "
    "efficiency, or for cooling minus the coefficient of performance. Or the supply air of the zone: flow, temperature"
)


class SupplyAir(StrictModel):
    """Heat of a zone's supply air: c · (flow · (T_supply − T_zone) − least · (T_before − T_zone)).

    A box of a variable air volume system always passes some air while the fan runs. What the least flow brings without
    reheat (`least` is `least_flow` or, where it is less, the flow) is no choice of the zone's loops and is taken off.
    """

    flow: PointName = Field(description="measured flow of the supply air, m³/s")
    temperature: PointName = Field(description="measured temperature of the supply air where it enters the zone, K")
    before: PointName | None = Field(None, description="measured temperature of the air before the zone's reheat, K")
    least_flow: float = Field(0.0, ge=0, description="least flow while the fan runs, m³/s")

    @model_validator(mode="after")
    def _together(self) -> SupplyAir:
        if (self.before is not None) != (self.least_flow > 0):
            raise ValueError("before and least_flow go together: the air that the least flow brings, and that flow")
        return self

    @property
    def points(self) -> dict[str, str]:
        """Unit of each point by its name."""
        named = {self.flow: "m3/s", self.temperature: "K"}
        return named if self.before is None else {**named, self.before: "K"}

    def heat_W(self, record: Mapping[str, Array], T_zone: Array) -> Array:
        """Return the heat (n,) of n samples by point, W, with the zone at `T_zone` (n,), K."""
        flow = record[self.flow]
        heat = flow * (record[self.temperature] - T_zone)
        if self.before is not None:
            heat = heat - np.minimum(flow, self.least_flow) * (record[self.before] - T_zone)
        return np.asarray(AIR_J_M3K * heat)


def _form(value: object) -> str:
    """Tag of what tells a heat, so that an error is one of the form that was meant."""
    if isinstance(value, SupplyAir) or (isinstance(value, Mapping) and SupplyAir.model_fields.keys() & value.keys()):
        return "air"
    return "factors" if isinstance(value, Mapping) else "meters"


Heat = Annotated[
    Annotated[tuple[PointName, ...], Tag("meters")]
    | Annotated[dict[PointName, Factor], Tag("factors")]
    | Annotated[SupplyAir, Tag("air")],
    Discriminator(_form),
]


@dataclass(frozen=True)
class HeatMeter:
    """What tells the heat of an actuator whose zone has its sensor at point `zone`."""

    heat: Heat
    zone: str

    @property
    def units(self) -> dict[str, str]:
        """Unit of each point by its name; empty if the heat is not measured."""
        return self.heat.points if isinstance(self.heat, SupplyAir) else dict.fromkeys(self.heat, "W")

    def heat_W(self, record: Mapping[str, Array]) -> Array:
        """Return the heat (n,) of n samples by point, W; it must be measured."""
        if isinstance(self.heat, SupplyAir):
            return self.heat.heat_W(record, record[self.zone])
        return weighted_sum(record, self.heat)


def weighted_sum(record: Mapping[str, Array], points: Sequence[str] | Mapping[str, float]) -> Array:
    """Return the sum of `points` over the samples of `record`, each times its factor where `points` has factors."""
    factors = points if isinstance(points, Mapping) else dict.fromkeys(points, 1.0)
    return np.asarray(np.sum([factor * record[name] for name, factor in factors.items()], axis=0))


class Supply(StrictModel):
    """Set-point of a machine's supply water, by which its valves give the heat that is asked of them.

    The cooler its water, the less power a heat pump needs. What heat some water gives depends on how warm the floor is,
    so the set-point is corrected in every block by what the last one lacked. Water that is a kelvin warmer gives at
    most `flow_W_per_K` more, so the correction never overshoots.
    """

    point: PointName = Field(description="overwrite point of the set-point, K, without the `_u` ending")
    minimum: float = Field(description="coolest water, K")
    maximum: float = Field(description="warmest water that a plan may ask for, K")
    flow_W_per_K: float = Field(
        gt=0, description="heat capacity of the water that flows through an open valve, W/K: kg/s times 4186 J/kgK"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Supply:
        check_range(self.minimum, self.maximum, "K")
        return self

    def value(self, heat_W: float, T_floor_C: float, last_K: float = math.nan, gave_W: float = math.nan) -> float:
        """Return the set-point, K, for `heat_W` through an open valve.

        `last_K`, `gave_W`: set-point of the last block and the valve's mean heat in it, W; NaN where it was closed. The
        water then comes back at `T_floor_C` °C, NaN: unknown.
        """
        more_W = heat_W - gave_W
        if math.isfinite(last_K + more_W):
            wanted = last_K + more_W / self.flow_W_per_K
        elif math.isfinite(T_floor_C):
            wanted = T_floor_C + ZERO_C_K + heat_W / self.flow_W_per_K
        else:
            wanted = self.maximum
        return min(max(wanted, self.minimum), self.maximum)


Price = Literal["constant", "dynamic", "highly_dynamic"]
PRICES: tuple[Price, ...] = ("constant", "dynamic", "highly_dynamic")
ELECTRICITY: dict[Price, str] = {
    "constant": "PriceElectricPowerConstant",
    "dynamic": "PriceElectricPowerDynamic",
    "highly_dynamic": "PriceElectricPowerHighlyDynamic",
}


class Zone(StrictModel):
    """A zone: its sensor, its floor area and the forecast points of its comfort band."""

    temperature: PointName = Field(description="measured zone temperature, K")
    floor_area_m2: float = Field(gt=0, description="floor area, m²")
    occupancy: PointName = Field(description="forecast point of the number of persons")
    lower: PointName = Field(description="forecast point of the lower comfort bound, K")
    upper: PointName = Field(description="forecast point of the upper comfort bound, K")
    thermostat_C: float | None = Field(None, description="set-point of the baseline on/off thermostat, °C")


class Machine(StrictModel):
    """A machine: the power that is billed, at the price of its carrier, and what it needs to feed its actuators."""

    power: tuple[PointName, ...] | dict[PointName, float] = Field(
        min_length=1,
        description="points whose sum is the power billed, W. With a factor each where a part of it, such as a pump, "
        "is billed at another price: that price over the machine's own",
    )
    held: dict[PointName, float] = Field(
        default_factory=dict,
        description="overwrite points held at a value (unit of the interface) while an actuator of the machine acts "
        "(u is not 0), such as what starts its pump; native otherwise",
    )
    idle: dict[PointName, float] = Field(
        default_factory=dict, description="values of points of `held` while all its actuators are held at u = 0"
    )
    running: PointName | None = Field(
        None,
        description="overwrite point whose applied value is above 0 while the machine feeds its actuators, such as the "
        "signal of its pump: their level is 0 otherwise, whatever native control does to them",
    )
    return_water: PointName | None = Field(None, description="return water temperature of the emitters, K")
    supply: Supply | None = Field(
        None,
        description="set-point of the water that it delivers, where the plan sets it: its actuators are then valves, "
        "open while u is above 0, and the one with the highest u says how warm the water is",
    )
    price: dict[Price, PointName] = Field(ELECTRICITY, description="forecast points of the price, per tariff")
    heating_price: dict[Price, PointName] | None = Field(
        None,
        description="price of the carrier of heating where a machine that also cools has one of its own, such as gas",
    )
    emission: PointName = Field("EmissionsElectricPower", description="forecast point of the emissions, kg CO2/kWh")

    @model_validator(mode="after")
    def _idle_is_held(self) -> Machine:
        for name in self.idle:
            if name not in self.held:
                raise ValueError(f"idle: '{name}' is not one of the points in held")
        if self.supply is not None and self.supply.point in self.held:
            raise ValueError(f"supply: '{self.supply.point}' is one of the points in held")
        return self

    @property
    def points(self) -> tuple[str, ...]:
        """All its overwrite points."""
        return (*self.held, *([] if self.supply is None else [self.supply.point]))

    def inputs(self, levels: Sequence[float | None], supply_K: float = math.nan) -> dict[str, float]:
        """Return the plant inputs of its points for the `levels` of its actuators (None: native).

        While some are native and none acts, the points are native too: native control may need the machine.
        `supply_K`: set-point of its water while one acts.
        """
        if any(level is not None and level != 0 for level in levels):
            values = dict(self.held)
            if self.supply is not None:
                values[self.supply.point] = supply_K
        elif any(level is None for level in levels):
            return {f"{name}_activate": 0.0 for name in self.points}
        else:
            values = {**self.held, **self.idle}
            if self.supply is not None:
                values[self.supply.point] = self.supply.minimum
        return {f"{name}_u": value for name, value in values.items()} | {f"{name}_activate": 1.0 for name in values}


class ZoneActuator(Actuator):
    """An actuator of a building: what it serves and what feeds it."""

    zone: str = Field(description="the zone that it serves")
    machine: str = Field(description="the machine that feeds it")
    mode: Literal["heating", "cooling"] = Field("heating", description="sign of its effect")
    heat: Heat = Field((), description=HEAT_IS)
    full_W: float | None = Field(
        None, gt=0, description="valve whose machine has `supply`: heat at u = 1, W; its level is metered heat over it"
    )
    share: float | None = Field(
        None, gt=0, description="share of its machine's capacity at full level; by default equal shares"
    )


class ZoneRoomSetpoints(RoomSetpoints):
    """Room set-points of a zone: what they serve and what feeds them."""

    zone: str = Field(description="the zone that they serve")
    machine: str = Field(description="the machine that feeds it")
    heat: Heat = Field((), description=HEAT_IS)
    share: float | None = Field(
        None, gt=0, description="share of its machine's capacity at full level; by default that of full heat"
    )


def _kind(actuator: object) -> str:
    kind = actuator.get("kind") if isinstance(actuator, Mapping) else getattr(actuator, "kind", None)
    return "room" if kind == "room_setpoints" else "direct"


AnyActuator = Annotated[
    Annotated[Actuator, Tag("direct")] | Annotated[RoomSetpoints, Tag("room")], Discriminator(_kind)
]
AnyZoneActuator = Annotated[
    Annotated[ZoneActuator, Tag("direct")] | Annotated[ZoneRoomSetpoints, Tag("room")], Discriminator(_kind)
]


@dataclass(frozen=True)
class ActuatorPoints:
    """An actuator, what tells its heat, and `key`, where it stands in the test case file."""

    actuator: Actuator | RoomSetpoints
    heat: HeatMeter
    key: str
    full_W: float | None = None  # full heat of a valve behind water that the plan sets


@dataclass(frozen=True)
class BuildingPoints:
    """Points of Z zones, A actuators and M machines, in the order of the layout's names.

    `zones` (Z,), `actuators` (A,), `machines` (M,); `outdoor_temperature` and `solar` are measured, with
    forecast points `forecast_outdoor` and `forecast_solar`.
    """

    layout: Layout
    zones: tuple[Zone, ...]
    actuators: tuple[ActuatorPoints, ...]
    machines: tuple[Machine, ...]
    outdoor_temperature: str
    solar: str
    forecast_outdoor: str
    forecast_solar: str

    @property
    def sensed(self) -> tuple[str, ...]:
        """Points whose applied values give the levels."""
        names = [name for one in self.actuators for name in one.actuator.sensed]
        for machine in self.machines:
            names += [machine.running] if machine.running else []
            names += [machine.supply.point] if machine.supply else []
        return tuple(dict.fromkeys(names))

    @property
    def flows(self) -> tuple[str, ...]:
        """Points that are averaged over a step instead of sampled."""
        names = [name for machine in self.machines for name in machine.power]
        names += [name for one in self.actuators for name in one.heat.units]
        names += [machine.return_water for machine in self.machines if machine.return_water]
        return tuple(dict.fromkeys(names))

    @property
    def temperatures(self) -> tuple[str, ...]:
        """Zone temperatures (Z,)."""
        return tuple(zone.temperature for zone in self.zones)

    def forecast(self, price: Price) -> tuple[str, ...]:
        """All forecast points for a tariff."""
        names = [self.forecast_outdoor, self.forecast_solar]
        for zone in self.zones:
            names += [zone.occupancy, zone.lower, zone.upper]
        for machine in self.machines:
            names += [machine.price[price], (machine.heating_price or machine.price)[price], machine.emission]
        return tuple(dict.fromkeys(names))


def layout_of(
    zones: Mapping[str, Zone],
    actuators: Mapping[str, ZoneActuator | ZoneRoomSetpoints],
    machines: Mapping[str, Machine],
    exclusive: Sequence[Sequence[str]] = (),
) -> Layout:
    """What acts where; raises `ValueError` naming the key of an actuator, zone or machine that fits nothing."""
    for name, one in actuators.items():
        for what, value, known in (("zone", one.zone, zones), ("machine", one.machine, machines)):
            if value not in known:
                raise ValueError(
                    f"actuators.{name}.{what}: there is no {what} '{value}'{suggestion(value, known)}; "
                    f"{what}s: {', '.join(known)}"
                )
    fed = {machine: [name for name, one in actuators.items() if one.machine == machine] for machine in machines}
    for machine, names in fed.items():
        if not names:
            raise ValueError(f"machines.{machine}: it feeds no actuator")
    for i, group in enumerate(exclusive):
        for name in group:
            if name not in actuators:
                raise ValueError(
                    f"exclusive[{i}]: there is no actuator '{name}'{suggestion(name, actuators)}; "
                    f"actuators: {', '.join(actuators)}"
                )
            if isinstance(actuators[name], RoomSetpoints):
                raise ValueError(
                    f"exclusive[{i}]: '{name}' is of kind room_setpoints, whose loops act when the zone asks for it: "
                    "they cannot be excluded"
                )
            if list(group).count(name) > 1:
                raise ValueError(f"exclusive[{i}]: '{name}' stands there twice: name each actuator once")
        if len(group) < 2:
            raise ValueError(f"exclusive[{i}]: {list(group)}: name two or more actuators that exclude one another")

    def share(one: ZoneActuator | ZoneRoomSetpoints) -> float:
        siblings = [actuators[name] for name in fed[one.machine]]
        if len(siblings) == 1:
            return 0.0
        heat = [each.heating_W if isinstance(each, RoomSetpoints) else math.nan for each in siblings]
        full = one.heating_W / sum(heat) if isinstance(one, RoomSetpoints) else math.nan
        return one.share or (full if math.isfinite(full) else 1.0 / len(siblings))

    return Layout(
        Names(tuple(zones), tuple(actuators), tuple(machines)),
        tuple(-1 if getattr(one, "mode", "heating") == "cooling" else 1 for one in actuators.values()),
        tuple(list(zones).index(one.zone) for one in actuators.values()),
        tuple(list(machines).index(one.machine) for one in actuators.values()),
        tuple(one.u_min if isinstance(one, RoomSetpoints) else 0.0 for one in actuators.values()),
        tuple(share(one) for one in actuators.values()),
        tuple(zone.floor_area_m2 for zone in zones.values()) or (math.nan,),
        tuple(tuple(list(actuators).index(name) for name in group) for group in exclusive),
    )
