"""Seeded draw of a single-zone house. Distributions and sources: docs/how-it-works/random-buildings.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.plants.drawn_houses import (
    AIR_WH_M3_K,
    DESIGN_OUT_C,
    DESIGN_ROOM_C,
    FACADES,
    FLOOR_LIMIT_W_M2,
    HEIGHT_M,
    MASSES,
    WATER_J_KG_K,
    Facade,
    Mass,
    air_changes_1_h,
    climate,
    glazing_of,
    ground_C,
    opaque_U_W_m2K,
)
from thermoforce_mpc.plants.people import HOUSEHOLDS, Pattern

Emitter = Literal["floor", "radiator", "air"]
Machine = Literal["heat pump with fixed loss", "heat pump", "boiler", "electric"]

MACHINES: tuple[Machine, ...] = ("heat pump with fixed loss", "heat pump", "boiler", "electric")
_HEAT_PUMPS: tuple[Machine, ...] = MACHINES[:2]
# Probabilities of `MACHINES` by emitter: floors and fan coils mostly with heat pumps, radiators mostly with boilers.
_MACHINE_WEIGHTS: dict[Emitter, tuple[float, ...]] = {
    "floor": (0.35, 0.30, 0.25, 0.10),
    "radiator": (0.20, 0.20, 0.45, 0.15),
    "air": (0.30, 0.25, 0.15, 0.30),
}
# Water of a heated floor at design, °C, from which it heats the ground below too.
_FLOOR_WATER_C = 27.0


@dataclass(frozen=True)
class SunlitPart:
    """What the sun heats first, before structure and surfaces: a floor under a window, or a double-skin glazing.

    It takes `share` of the sun that comes in, has `capacity_J_K`, and gives heat to the room's air, surfaces and
    structure and, a glazing, to outdoors, by `air_W_K`, `surface_W_K`, `mass_W_K` and `out_W_K`.
    """

    kind: Literal["floor", "double skin"]
    share: float
    capacity_J_K: float
    air_W_K: float
    surface_W_K: float = 0.0
    mass_W_K: float = 0.0
    out_W_K: float = 0.0

    @property
    def through_W_K(self) -> float:
        """Transmission from the room's air through it to outdoors, W/K."""
        return self.air_W_K * self.out_W_K / (self.air_W_K + self.out_W_K)


@dataclass(frozen=True)
class House:
    """Parameters of one house. Powers in W, temperatures in °C, areas in m², times in s.

    Envelope: `floor_area_m2`; `opaque_W_K` and `windows_W_K` transmission; `windows_m2` glazing by `FACADES`, `g_value`
    at normal incidence, `unshaded` share of the irradiance that reaches the glass after frame and shading;
    `air_changes_1_h` mean infiltration; `mass` class of EN ISO 13790.

    Occupants: `pattern` of presence; comfort bounds `lower_C`, `upper_C` while at home, `empty_lower_C`,
    `empty_upper_C` otherwise; `people`; other heat gains `gains_home_W_m2` and `gains_empty_W_m2`, with a relative
    standard deviation `gains_sd`.

    Climate: `weather_seed`, `warmer_K`, `clearer` of `synthetic_weather`.

    Emitter: water and metal of `emitter_J_K`; it delivers `emitter_W_Kn` · ΔT^`emitter_exponent` W, of that
    `convective` to the air and the rest to the surfaces, or for floor heating all to a slab of `slab_J_K`, which is
    coupled to the room by `slab_room_W_K` and to the ground by `slab_ground_W_K`. The machine throttles within 10 K
    of `water_limit_C`.

    Machine: `capacity_W` at the design outdoor temperature; below `lowest_level` it cycles. Heat pump: capacity rises
    by `capacity_per_K` per K outdoors, COP is `carnot` times Carnot's, `fixed_W` of electric power while on.
    Boiler: `efficiency` on the gross calorific value above the dew point. `spread_K` supply over return at full level.

    Sensor: noise `noise_sd_K`, resolution `resolution_K` (0: none), time constant `lag_s`, `sun_bias_K` at 800 W/m²
    on `sun_facade`. `heat_metered`: whether delivered heat and return temperature are measured.

    `sunlit`: what the sun heats first; None: structure and surfaces alone. Its transmission is part of `windows_W_K`.
    """

    seed: int
    index: int
    floor_area_m2: float
    opaque_W_K: float
    windows_W_K: float
    windows_m2: tuple[float, float, float, float]
    g_value: float
    unshaded: float
    air_changes_1_h: float
    mass: Mass
    pattern: Pattern
    lower_C: float
    upper_C: float
    empty_lower_C: float
    empty_upper_C: float
    people: int
    gains_home_W_m2: float
    gains_empty_W_m2: float
    gains_sd: float
    weather_seed: int
    warmer_K: float
    clearer: float
    emitter: Emitter
    emitter_J_K: float
    emitter_W_Kn: float
    emitter_exponent: float
    convective: float
    slab_J_K: float
    slab_room_W_K: float
    slab_ground_W_K: float
    water_limit_C: float
    machine: Machine
    sizing: float
    capacity_W: float
    capacity_per_K: float
    lowest_level: float
    carnot: float
    fixed_W: float
    efficiency: float
    spread_K: float
    noise_sd_K: float
    resolution_K: float
    lag_s: float
    sun_bias_K: float
    sun_facade: Facade
    heat_metered: bool
    sunlit: SunlitPart | None = None

    @property
    def name(self) -> str:
        """Name from which the house can be drawn again."""
        return f"house_{self.seed}_{self.index}"

    @property
    def ventilation_W_K(self) -> float:
        """Heat loss by the mean infiltration, W/K."""
        return AIR_WH_M3_K * HEIGHT_M * self.floor_area_m2 * self.air_changes_1_h

    @property
    def loss_W_K(self) -> float:
        """Heat loss coefficient to outdoors, ground excluded, W/K."""
        return self.opaque_W_K + self.windows_W_K + self.ventilation_W_K

    @property
    def design_out_C(self) -> float:
        """Design outdoor temperature, °C."""
        return DESIGN_OUT_C + self.warmer_K

    @property
    def design_load_W(self) -> float:
        """Heat load at the design outdoor temperature without gains, W (EN 12831)."""
        ground_W = self.slab_ground_W_K * (_FLOOR_WATER_C - ground_C(self.warmer_K))
        return self.loss_W_K * (DESIGN_ROOM_C - self.design_out_C) + ground_W

    @property
    def mass_J_K(self) -> float:
        """Heat capacity of the structure, J/K."""
        return MASSES[self.mass][1] * self.floor_area_m2

    @property
    def mass_area_m2(self) -> float:
        """Effective area of the structure, m²."""
        return MASSES[self.mass][0] * self.floor_area_m2

    @property
    def words(self) -> str:
        """The house in one line."""
        watts = self.loss_W_K / self.floor_area_m2
        glass = sum(self.windows_m2)
        flaws = [f"{self.noise_sd_K:g} K noise"] if self.noise_sd_K else []
        flaws += [f"{self.resolution_K:g} K steps"] if self.resolution_K else []
        flaws += [f"{self.lag_s / 60:.0f} min lag"] if self.lag_s >= 30 else []
        flaws += [f"{self.sun_bias_K:.1f} K in the {self.sun_facade} sun"] if self.sun_bias_K else []
        lit = {"floor": ", floor in the sun", "double skin": " in two skins"}[self.sunlit.kind] if self.sunlit else ""
        return (
            f"{self.floor_area_m2:.0f} m2 {self.mass}, {watts:.1f} W/m2K, {glass:.0f} m2 glass{lit}, {self.emitter}, "
            f"{self.machine} x{self.sizing:.1f}, {self.pattern} {self.lower_C:g}-{self.upper_C:g}; "
            f"sensor {', '.join(flaws) or 'exact'}"
        )


def draw_house(seed: int, index: int) -> House:
    """Draw house `index` of the population `seed`; sources of distributions: docs/how-it-works/random-buildings.md."""
    rng = np.random.default_rng([seed, index])
    # Areas and U-values span TABULA's single-family and terraced houses, from not refurbished to passive.
    # By the C library: NumPy's differ in the last bit from processor to processor, and so would a run's content key.
    area = math.exp(rng.uniform(math.log(50.0), math.log(220.0)))
    envelope = _envelope(rng, area)
    warmer, clearer = climate(rng)
    occupants = _occupants(rng, area)

    # Emitter and machine; floor heating only where the load is low enough.
    ground = 0.85 * area * rng.uniform(0.15, 0.30)
    design_out = DESIGN_OUT_C + warmer
    load = envelope.loss_W_K * (DESIGN_ROOM_C - design_out)
    emitter: Emitter = ("floor", "radiator", "air")[rng.integers(3)]
    if emitter == "floor" and load > FLOOR_LIMIT_W_M2 * area:
        emitter = "radiator"
    if emitter == "floor":
        load += ground * (_FLOOR_WATER_C - ground_C(warmer))
    machine = MACHINES[rng.choice(4, p=_MACHINE_WEIGHTS[emitter])]
    low, high = ((0.8, 0.95), (1.0, 1.3), (1.3, 2.5))[rng.choice(3, p=[0.2, 0.45, 0.35])]
    sizing = rng.uniform(low, high)
    emitter_W = load * rng.uniform(1.0, 1.3)
    if emitter == "floor":
        circuit = _floor(rng, machine, area, ground)
    else:
        circuit = (_radiators if emitter == "radiator" else _coil)(rng, machine, emitter_W)
    heat = _machine(rng, machine, float(sizing * load), design_out, DESIGN_ROOM_C + circuit.excess_K)
    return House(
        seed=seed,
        index=index,
        floor_area_m2=area,
        opaque_W_K=float(envelope.opaque_W_K),
        windows_W_K=float(envelope.windows_W_K),
        windows_m2=tuple(float(value) for value in envelope.windows_m2),  # type: ignore[arg-type]
        g_value=envelope.g_value,
        unshaded=float(envelope.unshaded),
        air_changes_1_h=envelope.air_changes_1_h,
        mass=envelope.mass,
        **occupants,
        weather_seed=int(rng.integers(1, 2**31)),
        warmer_K=warmer,
        clearer=clearer,
        emitter=emitter,
        emitter_J_K=float(circuit.water_J_K),
        emitter_W_Kn=float(circuit.W_Kn),
        emitter_exponent=circuit.exponent,
        convective=circuit.convective,
        slab_J_K=float(circuit.slab_J_K),
        slab_room_W_K=float(circuit.slab_room_W_K),
        slab_ground_W_K=float(circuit.slab_ground_W_K),
        water_limit_C=circuit.limit_C,
        spread_K=circuit.spread_K,
        machine=machine,
        sizing=float(sizing),
        **heat,
        efficiency=float(rng.uniform(0.84, 0.90)),
        **_sensor(rng),
        heat_metered=bool(rng.uniform() < 0.4) and emitter != "air" and machine != "electric",
    )


class _Envelope(NamedTuple):
    """Structure, walls, windows by `FACADES` (4,) and infiltration, as in `House`, and all that they lose, W/K."""

    mass: Mass
    opaque_W_K: float
    windows_W_K: float
    windows_m2: np.ndarray
    g_value: float
    unshaded: float
    air_changes_1_h: float
    loss_W_K: float


def _envelope(rng: np.random.Generator, area: float) -> _Envelope:
    mass = list(MASSES)[rng.integers(len(MASSES))]
    age = rng.uniform()  # 0: passive house, 1: not refurbished
    U_opaque = opaque_U_W_m2K(rng, age)
    opaque = area * rng.uniform(1.2, 2.0) * U_opaque
    share = rng.uniform(0.10, 0.30)  # glazing per floor area
    facing = rng.dirichlet([2.0, 1.0, 0.6, 1.0])  # south more than north
    U_window, g_value = glazing_of(age)
    glass = share * area * U_window
    unshaded = rng.uniform(0.45, 0.70)  # frame 0.7 to 0.8, external shading 0.6 to 0.9 (EN ISO 13790)
    changes = air_changes_1_h(rng, age)
    loss = opaque + glass + AIR_WH_M3_K * HEIGHT_M * area * changes
    return _Envelope(mass, opaque, glass, share * area * facing, g_value, unshaded, changes, loss)


def _occupants(rng: np.random.Generator, area: float) -> dict[str, Any]:
    """Draw the fields of a `House` of its occupants: gains after EN ISO 13790 annex G, 80 W a person."""
    pattern = HOUSEHOLDS[rng.choice(4, p=[0.35, 0.25, 0.20, 0.20])]
    lower = float(rng.choice([20.0, 21.0, 21.5]))
    upper = lower + float(rng.choice([3.0, 4.0]))
    always = pattern == "always"
    return {
        "pattern": pattern,
        "lower_C": lower,
        "upper_C": upper,
        "empty_lower_C": lower if always else 15.0,
        "empty_upper_C": upper if always else 30.0,
        "people": max(1, round(area / rng.uniform(30.0, 55.0))),
        "gains_home_W_m2": float(rng.uniform(2.0, 5.0)),
        "gains_empty_W_m2": float(rng.uniform(0.7, 1.5)),
        "gains_sd": 0.5,
    }


class _Circuit(NamedTuple):
    """Water, emitter and slab, as in `House`; `excess_K`: of the mean water over the room at design."""

    water_J_K: float
    W_Kn: float
    exponent: float
    convective: float
    limit_C: float
    spread_K: float
    excess_K: float
    slab_J_K: float = 0.0
    slab_room_W_K: float = 0.0
    slab_ground_W_K: float = 0.0


def _floor(rng: np.random.Generator, machine: Machine, area: float, ground_W_K: float) -> _Circuit:
    """Draw floor heating."""
    # Screed of 45 to 75 mm, 1.2 l of water per m²; water to screed 0.1 m²K/W (Koschenz and Lehmann 2000);
    # surface 10.8 W/m²K (EN 1264-5) below a covering of 0.01 to 0.10 m²K/W.
    covered = 0.85 * area
    slab_J_K = covered * rng.uniform(0.045, 0.075) * 2000.0 * 1000.0
    slab_room_W_K = covered / (1.0 / 10.8 + rng.uniform(0.01, 0.10))
    water_kg = 0.2 * covered if machine == "electric" else 1.2 * covered + 20.0
    water_J_K, W_K = water_kg * WATER_J_KG_K, covered / 0.10
    return _Circuit(water_J_K, W_K, 1.0, 0.0, 45.0, 5.0, 12.0, slab_J_K, slab_room_W_K, ground_W_K)


def _radiators(rng: np.random.Generator, machine: Machine, emitter_W: float) -> _Circuit:
    """Draw radiators that give `emitter_W` at design."""
    # EN 442: exponent 1.3; type 22 panels hold 6 l and 28 kg of steel per kW at 50 K, plus 5 l/kW in pipes.
    excess = {"boiler": rng.uniform(38.0, 50.0), "electric": 50.0}.get(machine, rng.uniform(24.0, 32.0))
    per_kW = 6.0 * WATER_J_KG_K + 28.0 * 460.0 + (0.0 if machine == "electric" else 5.0 * WATER_J_KG_K)
    water_J_K = per_kW * emitter_W / 1e3 * (50.0 / excess) ** 1.3
    limit_C, spread_K = (60.0, 7.0) if machine in _HEAT_PUMPS else (85.0, 15.0)
    return _Circuit(water_J_K, emitter_W / excess**1.3, 1.3, 0.7, limit_C, spread_K, excess)


def _coil(rng: np.random.Generator, machine: Machine, emitter_W: float) -> _Circuit:
    """Draw a fan coil, split unit or convector that gives `emitter_W` at design."""
    # No exponent, heat capacity of 3 to 6 min.
    excess = {"boiler": 40.0, "electric": 60.0}.get(machine, rng.uniform(20.0, 28.0))
    W_K = emitter_W / excess
    limit_C = {"boiler": 80.0, "electric": 120.0}.get(machine, 60.0)
    water_J_K, spread_K = W_K * rng.uniform(180.0, 360.0), 0.0 if machine == "electric" else 5.0
    return _Circuit(water_J_K, W_K, 1.0, 1.0, limit_C, spread_K, excess)


def _machine(
    rng: np.random.Generator, machine: Machine, capacity_W: float, design_out_C: float, water_C: float
) -> dict[str, Any]:
    """Draw the fields of a `House` of its machine, of a capacity and water at design."""
    carnot = rng.uniform(0.48, 0.62)  # between the refrigerant's temperatures; EN 14511 data sheets: A2/W35 3.3 to 4.2
    fixed = 0.0
    if machine == "heat pump with fixed loss":  # 12 to 30 % of the electric power at full level, 2 °C outdoors
        full_W = capacity_W * (1.0 + 0.02 * (2.0 - design_out_C)) / heat_pump_cop(carnot, 2.0, water_C)
        fixed = rng.uniform(0.12, 0.30) * full_W
    lowest = {"boiler": rng.uniform(0.15, 0.40), "electric": 0.0}.get(machine, rng.uniform(0.20, 0.35))
    return {
        "capacity_W": capacity_W,
        "capacity_per_K": 0.02 if machine in _HEAT_PUMPS else 0.0,  # of that at design, air-source data sheets
        "lowest_level": float(lowest),
        "carnot": float(carnot),
        "fixed_W": float(fixed),
    }


def _sensor(rng: np.random.Generator) -> dict[str, Any]:
    """Draw the fields of a `House` of its sensor: one in five stands in the sun."""
    return {
        "noise_sd_K": float(rng.choice([0.0, 0.02, 0.05])),
        "resolution_K": float(rng.choice([0.0, 0.1, 0.5], p=[0.3, 0.45, 0.25])),
        "lag_s": float(rng.uniform(0.0, 900.0)),
        "sun_bias_K": float(rng.uniform(1.0, 4.0)) if rng.uniform() < 0.2 else 0.0,
        "sun_facade": FACADES[rng.choice(4, p=[0.5, 0.25, 0.0, 0.25])],
    }


def with_sunlit_part(house: House) -> House:
    """Return a drawn house with a floor in the sun or a double-skin glazing, equally likely; the rest stays as drawn.

    Light rooms follow the sun within minutes then, as a sensor in the sun does.
    """
    rng = np.random.default_rng([house.seed, house.index, 3])  # a stream of its own: 1 draws gains, 2 noise
    glass_m2 = sum(house.windows_m2)
    if rng.uniform() < 0.5:
        # The patch of sun: about the size of the glass. Carpet, wood or tiles; upward convection 5 and radiation
        # 5.1 W/m²K (EN ISO 6946), and a covering of 0.1 to 0.5 m²K/W on the structure.
        area_m2 = glass_m2 * rng.uniform(0.5, 1.5)
        part = SunlitPart(
            "floor",
            share=float(rng.uniform(0.4, 0.8)),
            capacity_J_K=float(area_m2 * rng.uniform(4e3, 20e3)),
            air_W_K=float(5.0 * area_m2),
            surface_W_K=float(5.1 * area_m2),
            mass_W_K=float(area_m2 / rng.uniform(0.1, 0.5)),
        )
    else:
        # 8 to 18 mm of glass and a blind; the inner pane single or open to the room, and 50 to 90 % of the
        # transmission of the windows through it.
        air_W_K = glass_m2 * rng.uniform(3.0, 8.0)
        through_W_K = house.windows_W_K * rng.uniform(0.5, 0.9)
        part = SunlitPart(
            "double skin",
            share=float(rng.uniform(0.3, 0.7)),
            capacity_J_K=float(glass_m2 * rng.uniform(17e3, 40e3)),
            air_W_K=float(air_W_K),
            out_W_K=float(through_W_K * air_W_K / (air_W_K - through_W_K)),
        )
    return replace(house, sunlit=part)


def heat_pump_cop(carnot: float, T_out_C: float, water_C: float) -> float:
    """Return the COP without the fixed loss: `carnot` times Carnot's, 8 K below outdoors to 5 K above the water.

    The temperature lift counts as at least 15 K, as at the end of data sheets, which bounds the COP.
    """
    warm_K = water_C + 5.0 + ZERO_C_K
    return carnot * warm_K / max(warm_K - (T_out_C - 8.0 + ZERO_C_K), 15.0)
