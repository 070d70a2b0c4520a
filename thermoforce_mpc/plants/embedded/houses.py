"""The houses of the three test cases in figures: their envelopes, and what sun and wind meet there.

Constructions are chains of heat-capacity nodes, layers listed from outside to inside; all chains together form one
tridiagonal system, which the compiled step reads.

Sources: documentation and models of the BOPTEST test cases. All are BESTEST case 900 by construction. That of
`bestest_hydronic_heat_pump` is scaled to 192 m²; it and `bestest_hydronic` follow the IDEAS library, `bestest_air` the
Buildings library, and where these differ, so do the houses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from thermoforce_mpc.data import Array

START_K = 293.15
# Outside surfaces in this order; the first five are opaque.
OUTSIDE = ("south", "west", "north", "east", "roof", "window")
ROOF, WINDOW = 4, 5
# Kinds of inside surfaces, by which the air rises along them.
UPRIGHT, FLOOR, CEILING = 0, 1, -1


class Envelope(NamedTuple):
    """Thermal network of a house, n nodes in chains, and the exchange at its 6 outside and k inside surfaces.

    Attributes:
        capacity: J/K, (n,).
        start_K: initial temperatures, (n,).
        coupling: W/K between nodes i and i + 1, zero at the end of a chain, (n,).
        outside: nodes of the surfaces in the order of `OUTSIDE`, (6,).
        inside: nodes of the inside surfaces, (k,).
        panes: nodes that take half of what the outer pane absorbs each, then those of the inner pane, (4,).
        heated: nodes that the system heats, see `envelope.respond`.
        ground: node that is coupled to the ground by `ground_W_K`, which has `ground_K`.
        outside_m2: areas, (6,).
        sky_view: view factor of the sky, (6,).
        natural: film by natural convection over |dT|^(1/3), W/(m²·K^(4/3)): (6, 2), surface colder and warmer.
        adds_forced: whether forced convection adds to the natural one; else both add as the legs of a triangle.
        radiates_linearly: whether long-wave emission is linearised, outside about the surroundings, in panes about
            `START_K`.
        emissivity: long-wave, of opaque outside surfaces.
        pane_radiation: long-wave film of the outer pane, W/(m²·K).
        facing: `UPRIGHT`, `FLOOR` or `CEILING`, (k,).
        film: (k, 2): film over |dT|^exponent, W/K^(1 + exponent): where the air is not stably layered, and where it is.
        film_exponent: (k, 2).
        blend_K: half width of the temperature difference over which one passes into the other.
        radiant_W_K: long-wave conductance to the radiant node, (k,).
        beam: share of the transmitted beam that each surface absorbs, (k,).
        diffuse: the same of transmitted diffuse sun, (k,).
        emitted: the same of radiant gains, (k,); `emitted_to_star` is left in the radiant node.
        weight: weight in the mean radiant temperature, (k,).
    """

    capacity: Array
    start_K: Array
    coupling: Array
    outside: np.ndarray
    inside: np.ndarray
    panes: np.ndarray
    heated: np.ndarray
    ground: int
    ground_W_K: float
    ground_K: float
    outside_m2: Array
    sky_view: Array
    natural: Array
    adds_forced: bool
    radiates_linearly: bool
    emissivity: float
    pane_radiation: float
    facing: np.ndarray
    film: Array
    film_exponent: Array
    blend_K: float
    radiant_W_K: Array
    beam: Array
    diffuse: Array
    emitted: Array
    emitted_to_star: float
    weight: Array


@dataclass(frozen=True)
class Layer:
    """Homogeneous layer: thickness m, conductivity W/(m·K), density kg/m³, heat capacity J/(kg·K), node count."""

    thickness: float
    conductivity: float
    density: float
    capacity: float
    nodes: int
    start_K: float = START_K

    def heat_J_K(self, area_m2: float) -> float:
        """Heat capacity of an area."""
        return area_m2 * self.thickness * self.density * self.capacity

    def resistance_K_W(self, area_m2: float) -> float:
        """Resistance of an area across the layer."""
        return self.thickness / (self.conductivity * area_m2)


# BESTEST case 900: walls and roof of all three test cases.
WALL = (
    Layer(0.009, 0.14, 530.0, 900.0, 2),
    Layer(0.0615, 0.04, 10.0, 1400.0, 2),
    Layer(0.100, 0.51, 1400.0, 1000.0, 3),
)
ROOF_LAYERS = (
    Layer(0.019, 0.14, 530.0, 900.0, 2),
    Layer(0.1118, 0.04, 12.0, 840.0, 2),
    Layer(0.010, 0.16, 950.0, 840.0, 2),
)


@dataclass
class Chains:
    """Chains that are being put together; `ends`: first and last node of each construction."""

    capacity: list[float] = field(default_factory=list)
    coupling: list[float] = field(default_factory=list)
    start_K: list[float] = field(default_factory=list)
    ends: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, name: str, capacity: Sequence[float], coupling: Sequence[float], start_K: Sequence[float]) -> int:
        """Append a chain of m nodes with m − 1 couplings, W/K; returns its first node."""
        first = len(self.capacity)
        self.capacity += capacity
        self.coupling += [*coupling, 0.0]
        self.start_K += start_K
        self.ends[name] = (first, len(self.capacity) - 1)
        return first

    def add_faces(self, name: str, layers: Sequence[Layer], area_m2: float) -> list[int]:
        """Append layers of `Layer.nodes` nodes, of which neighbours share those at their faces (IDEAS library).

        Returns the first node of each layer, and the last node.
        """
        capacity, coupling, start, at = [0.0], [], [layers[0].start_K], [0]
        for layer in layers:
            segments = layer.nodes - 1
            part = layer.heat_J_K(area_m2) / segments
            for _ in range(segments):
                capacity[-1] += part / 2
                coupling.append(layer.conductivity * area_m2 * segments / layer.thickness)
                capacity.append(part / 2)
                start.append(layer.start_K)
            at.append(len(capacity) - 1)
        first = self.add(name, capacity, coupling, start)
        return [first + i for i in at]

    def add_volumes(self, name: str, layers: Sequence[Layer], volumes: Sequence[int], area_m2: float) -> None:
        """Append layers of so many equal volumes, with a node in the middle of each (Buildings library).

        The outermost and the innermost volume have half of their heat at the surface.
        """
        capacity: list[float] = []
        resistance: list[float] = []
        pending = 0.0
        for layer, n in zip(layers, volumes, strict=True):
            part, half = layer.heat_J_K(area_m2) / n, layer.resistance_K_W(area_m2) / n / 2.0
            for _ in range(n):
                if capacity:
                    resistance.append(pending + half)
                capacity.append(part)
                pending = half
        outer = layers[0].resistance_K_W(area_m2) / volumes[0] / 2.0
        capacity = [capacity[0] / 2.0, capacity[0] / 2.0, *capacity[1:-1], capacity[-1] / 2.0, capacity[-1] / 2.0]
        self.add(name, capacity, [1.0 / r for r in (outer, *resistance, pending)], [START_K] * len(capacity))

    def outside_nodes(self) -> np.ndarray:
        """Nodes of the outside surfaces."""
        return np.array([self.ends[name][0] for name in OUTSIDE])


HEIGHT_M = 2.7
_SIGMA = 5.670374419e-8
_EMISSIVITY = 0.9


@dataclass(frozen=True)
class Glazing:
    """Double glazing: shares of the sun on its area that pass, and that outer and inner pane absorb.

    `of_beam` returns these three by angle of incidence, degrees (n,), `of_diffuse` are those of diffuse sun. `lost`:
    share of the transmitted beam and diffuse sun that the panes reflect out again. They are less warm by it: with the
    sign of the Buildings library, by the shares that they absorb of diffuse sun from behind.
    """

    area_m2: float
    of_beam: Callable[[Array], tuple[Array, Array, Array]]
    of_diffuse: tuple[float, float, float]
    lost: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Facade:
    """What sun and wind meet: the glazing, and the film by forced convection, W/(m²·K).

    `forced` returns it from wind speed, m/s, the angle of the wind off the normal of a surface, rad, and its area, m²;
    `window_forced` from wind speed, None: that of the south wall. `roof_is_south`: whether the wind on the roof is
    taken as that on the south wall; else it is always windward.
    """

    areas_m2: tuple[float, ...]
    glazing: Glazing
    forced: Callable[[Array, Array, float], Array]
    window_forced: Callable[[Array], Array] | None = None
    roof_is_south: bool = False


Quantity = TypeVar("Quantity", float, Array)


class BestestHouse(NamedTuple):
    """A house: `area_m2` of floor, `air_kg` in it, moist air of `cp` J/(kg·K)."""

    area_m2: float
    air_kg: float
    cp: float
    envelope: Envelope
    facade: Facade

    @property
    def air_J_K(self) -> float:
        """Heat capacity of its air."""
        return self.air_kg * self.cp


def moist_air_cp(vapour: Quantity) -> Quantity:
    """Heat capacity of air with `vapour` kg/kg, J/(kg·K)."""
    return 1006.0 + 1860.0 * vapour


# --- Buildings of the IDEAS library --------------------------------------------------------------------------------

# By angle of incidence, degrees (BESTEST glazing of the IDEAS library, from WINDOW 6.3).
_ANGLE = [0, 10, 20, 30, 40, 45, 50, 60, 70, 80, 88.9, 90]
# fmt: off
_TRANSMITTED = [
    0.747454, 0.746824, 0.744654, 0.739491, 0.729832, 0.720922, 0.707331, 0.652331, 0.516754, 0.263009, 0, 0,
]
_ABSORBED_ANGLE = [
    0, 20, 30, 40, 48, 55, 57, 60, 63, 66, 68, 70, 72,
    75, 77.5, 80, 82, 83.5, 85, 86, 87, 88, 89, 89.99, 90,
]
_ABSORBED_OUTER = [
    0.0643, 0.0659, 0.0679, 0.0708, 0.0738, 0.0769, 0.0779, 0.0796, 0.0815, 0.0837, 0.0852, 0.0858, 0.089,
    0.0911, 0.0929, 0.094, 0.0937, 0.0924, 0.0892, 0.0854, 0.079, 0.0671, 0.0473, 0.001, 0.0,
]
_ABSORBED_INNER = [
    0.0522, 0.0534, 0.0548, 0.0566, 0.058, 0.0587, 0.0587, 0.0585, 0.0579, 0.0568, 0.0558, 0.0544, 0.0521,
    0.0495, 0.0457, 0.0413, 0.0372, 0.0335, 0.0291, 0.0254, 0.0205, 0.0128, 0.0043, 0.0, 0.0,
]
# fmt: on
_IDEAS_DIFFUSE = (0.652331, 0.0796, 0.0585)
# A surface is leeward if the wind comes from more than this angle off its normal.
_LEE_RAD = np.deg2rad(100.0)
# Long-wave radiation of the outer pane, linearised about 280 K.
_PANE_RADIATION = 0.9 * _SIGMA * (280.0 + 285.0) * (280.0**2 + 285.0**2)


def _by_table(incidence_deg: Array) -> tuple[Array, Array, Array]:
    return (
        np.interp(incidence_deg, _ANGLE, _TRANSMITTED),
        np.interp(incidence_deg, _ABSORBED_ANGLE, _ABSORBED_OUTER),
        np.interp(incidence_deg, _ABSORBED_ANGLE, _ABSORBED_INNER),
    )


def _by_power(wind: Array, off_normal: Array, area_m2: float) -> Array:
    return np.where(off_normal > _LEE_RAD, 3.55 * wind**0.617, 3.26 * wind**0.89)


class Surface(NamedTuple):
    """Inside surface: area m², weight in the mean radiant temperature, long-wave emissivity, and W/K to that node.

    The weight is area times short-wave absorptance (model constants).
    """

    area_m2: float
    weight: float
    emissivity: float
    radiant_W_K: float


def _ideas(
    chains: Chains,
    surfaces: Mapping[str, Surface],
    inside: Mapping[str, int],
    areas_m2: tuple[float, ...],
    *,
    floor_absorbs: float,
    panes: tuple[int, int],
    heated: tuple[int, ...] = (),
) -> Envelope:
    """The envelope of inside `surfaces` at the nodes `inside`, with outside areas in the order of `OUTSIDE`.

    `floor_absorbs`: share of the beam; the rest is reflected to all other surfaces. `panes`: nodes where the outer and
    the inner pane take up sun.
    """
    inside_m2, share, emissivity, radiant_W_K = np.array(list(surfaces.values())).T.copy()
    share = share / sum(share.tolist())
    floor = list(surfaces).index("floor")
    beam = np.where(np.arange(len(surfaces)) == floor, 0.0, share)
    beam = (1.0 - floor_absorbs) * beam / beam.sum()
    beam[floor] = floor_absorbs
    emitted = inside_m2 * emissivity / (inside_m2 * emissivity).sum()
    # Khalifa-type films: A·1.823/Dh^0.121·|dT|^1.293 on walls, with Dh from the perimeter of each wall.
    hydraulic_m = 4.0 * inside_m2 / (2.0 * inside_m2 / HEIGHT_M + 2.0 * HEIGHT_M)
    film = np.stack([inside_m2 * 1.823 / hydraulic_m**0.121, np.zeros(len(surfaces))], axis=1)
    exponent = np.full((len(surfaces), 2), 0.293)
    facing = np.full(len(surfaces), UPRIGHT)
    side_m = math.sqrt(areas_m2[4])
    for name, direction in (("floor", FLOOR), ("roof", CEILING)):
        k = list(surfaces).index(name)
        film[k] = areas_m2[4] * 2.175 / side_m**0.076, areas_m2[4] * 0.704 / side_m**0.601
        exponent[k], facing[k] = (0.308, 0.133), direction
    upright = 0.5 * math.cos(math.pi / 4)
    return Envelope(
        capacity=np.array(chains.capacity),
        start_K=np.array(chains.start_K),
        coupling=np.array(chains.coupling),
        outside=chains.outside_nodes(),
        inside=np.array([inside[name] for name in surfaces]),
        panes=np.array([panes[0], panes[0], panes[1], panes[1]]),
        heated=np.array(heated, dtype=np.int64),
        ground=0,
        ground_W_K=0.0,
        ground_K=START_K,
        outside_m2=np.array(areas_m2),
        sky_view=np.array([upright] * 4 + [1.0, upright]),
        natural=np.array([(1.31, 1.31)] * 4 + [(0.76, 1.509), (1.31, 1.31)]),
        adds_forced=False,
        radiates_linearly=False,
        emissivity=_EMISSIVITY,
        pane_radiation=_PANE_RADIATION,
        facing=facing,
        film=film,
        film_exponent=exponent,
        blend_K=0.1,
        radiant_W_K=radiant_W_K,
        beam=beam,
        diffuse=share,
        emitted=emitted,
        emitted_to_star=0.0,
        weight=share,
    )


def _heat_pump_house() -> BestestHouse:
    """192 m² with heated floor on the ground and an inner wall, whose two faces both see the zone."""
    areas_m2, floor_m2, partition_m2 = (19.2, 32.4, 43.2, 32.4, 192.0, 24.0), 192.0, 183.6
    soil_K = 283.95
    # From the tile down to the soil; the pipes lie between screed and PUR insulation. The edge loss to the soil acts on
    # the concrete slab, at the interface of layers 3 and 4.
    floor_layers = (
        Layer(0.01, 1.4, 2100.0, 840.0, 2),
        Layer(0.05, 0.6, 1100.0, 840.0, 2),
        Layer(0.20, 0.02, 30.0, 1470.0, 4),
        Layer(0.15, 1.4, 2100.0, 840.0, 3),
        Layer(0.17, 2.0, 2000.0, 1000.0, 3, soil_K),
        Layer(0.33, 2.0, 2000.0, 1000.0, 5, soil_K),
        Layer(0.50, 2.0, 2000.0, 1000.0, 7, soil_K),
    )
    partition_layers = (
        Layer(0.08, 0.75, 1400.0, 840.0, 2),
        Layer(0.10, 0.036, 110.0, 840.0, 3),
        Layer(0.14, 0.54, 1400.0, 840.0, 3),
        Layer(0.015, 0.6, 975.0, 840.0, 2),
    )
    # Two panes and the gap. The test case documents 0.539419 m²K/W for the gap, the conduction of 13 mm of air alone
    # (0.0241 W/mK). In the IDEAS library the panes also exchange radiation, 5.86 W/(m²·K) between black surfaces;
    # without it the house's heat loss is 10 % too low.
    gap_conduction = 1.0 / 0.539419
    gap_radiation = 5.86 / (2.0 / 0.9 - 1.0)
    window_resistance = 2 * 0.002995 + 1.0 / (gap_conduction + gap_radiation)
    chains = Chains()
    for name, area in zip(OUTSIDE[:4], areas_m2, strict=False):
        chains.add_faces(name, WALL, area)
    chains.add_faces("roof", ROOF_LAYERS, floor_m2)
    floor = chains.add_faces("floor", floor_layers, floor_m2)
    chains.add_faces("partition", partition_layers, partition_m2)
    panes = chains.add("window", [143_068.0] * 2, [areas_m2[5] / window_resistance], [START_K] * 2)
    # Resistances to the radiant node, K⁴/W: emissivity and Carroll's view factor.
    rows = {
        "south": (areas_m2[0], 0.02159, 0.9, 1.00445e6),
        "west": (areas_m2[1], 0.03644, 0.9, 5.88451e5),
        "north": (areas_m2[2], 0.04858, 0.9, 4.37077e5),
        "east": (areas_m2[3], 0.03644, 0.9, 5.88451e5),
        "roof": (floor_m2, 0.21592, 0.9, 81_703.0),
        "floor": (floor_m2, 0.19793, 0.88, 84_022.5),
        "partition_brick": (partition_m2, 0.22368, 0.88, 92_990.8),
        "partition_gypsum": (partition_m2, 0.18927, 0.85, 89_138.3),
        "window": (areas_m2[5], 0.03014, 0.9, 8.00259e5),
    }
    cubed = (2 * 295.15 - 2) * (295.15**2 + 293.15**2)
    surfaces = {name: Surface(*row[:3], cubed / row[3]) for name, row in rows.items()}
    ends = chains.ends
    inside = {name: ends[name][1] for name in ("south", "west", "north", "east", "roof", "window")}
    inside |= {"floor": floor[0], "partition_brick": ends["partition"][0], "partition_gypsum": ends["partition"][1]}
    envelope = _ideas(
        chains,
        surfaces,
        inside,
        areas_m2,
        floor_absorbs=0.55,
        panes=(panes, panes + 1),
        heated=(floor[2], floor[4]),
    )
    glazing = Glazing(areas_m2[5], _by_table, _IDEAS_DIFFUSE)
    return BestestHouse(floor_m2, 1.2 * 518.4, moist_air_cp(0.006), envelope, Facade(areas_m2, glazing, _by_power))


def _boiler_house() -> BestestHouse:
    """48 m² on a floor without heat loss below."""
    areas_m2, floor_m2 = (9.6, 16.2, 21.6, 16.2, 48.0, 12.0), 48.0
    floor_layers = (Layer(0.08, 1.13, 1400.0, 1000.0, 2), Layer(1.007, 0.04, 10.0, 10.0, 2))
    chains = Chains()
    for name, area in zip(OUTSIDE[:4], areas_m2, strict=False):
        chains.add_faces(name, WALL, area)
    chains.add_faces("roof", ROOF_LAYERS, floor_m2)
    chains.add_faces("floor", floor_layers, floor_m2)
    # The panes take up sun in their middle; the gap conducts and radiates.
    half_pane, gap = 8012.6, 79.8206
    window = [half_pane, 1.0 / (2.0 / half_pane + 1.0 / gap), half_pane]
    first = chains.add("window", [71_534.0, 0.0, 0.0, 71_534.0], window, [START_K] * 4)
    surfaces = {
        "south": Surface(areas_m2[0], 0.055491, 0.9, 51.9921),
        "west": Surface(areas_m2[1], 0.093642, 0.9, 90.6180),
        "north": Surface(areas_m2[2], 0.124855, 0.9, 124.4300),
        "east": Surface(areas_m2[3], 0.093642, 0.9, 90.6180),
        "roof": Surface(floor_m2, 0.277457, 0.9, 348.1309),
        "floor": Surface(floor_m2, 0.277457, 0.9, 348.1309),
        "window": Surface(areas_m2[5], 0.077457, 0.9, 65.7316),
    }
    inside = {name: chains.ends[name][0 if name == "floor" else 1] for name in surfaces}
    envelope = _ideas(chains, surfaces, inside, areas_m2, floor_absorbs=0.6, panes=(first + 1, first + 2))
    glazing = Glazing(areas_m2[5], _by_table, _IDEAS_DIFFUSE)
    return BestestHouse(floor_m2, 155.52, moist_air_cp(0.005), envelope, Facade(areas_m2, glazing, _by_power))


# --- Building of the Buildings library -----------------------------------------------------------------------------

# Optics of the panes at 0, 10 .. 90 degrees of incidence, and of diffuse sun.
_SYSTEM = np.array(
    [
        [0.743686, 0.742443, 0.738292, 0.729665, 0.712660, 0.678054, 0.605162, 0.456671, 0.209565, 0.0],
        [0.098600, 0.099356, 0.101654, 0.105588, 0.111346, 0.119287, 0.130094, 0.144247, 0.154482, 0.0],
        [0.082037, 0.082600, 0.084268, 0.086941, 0.090296, 0.093416, 0.093960, 0.086911, 0.064429, 0.0],
    ]
)
_SYSTEM_DIFFUSE = (0.611506, 0.129360, 0.094116)
# Angle of the wind beyond which a surface is leeward, and speed below which no side is, m/s.
_STILL_M_S, _CALM_M_S = 0.25, 0.5


def _by_spline(incidence_deg: Array) -> tuple[Array, Array, Array]:
    """Cubic Hermite over the index of the angle, central differences; beyond the ends as in the library's table."""
    from scipy.interpolate import CubicHermiteSpline

    slopes = np.gradient(np.concatenate([_SYSTEM[:, :1], _SYSTEM, np.array(_SYSTEM_DIFFUSE)[:, None]], axis=1), axis=1)[
        :, 1:-1
    ]
    at = np.clip(incidence_deg, 0.0, 90.0) / 10.0
    of = [CubicHermiteSpline(np.arange(10.0), values, slope)(at) for values, slope in zip(_SYSTEM, slopes, strict=True)]
    lit = incidence_deg < 90.0
    return tuple(np.where(lit, values, 0.0) for values in of)  # type: ignore[return-value]


def _by_root(wind: Array, off_normal: Array, area_m2: float) -> Array:
    """Sparrow's forced film; below calm speed an even polynomial that meets the root in value, slope and curvature."""
    ratio = wind / _CALM_M_S
    calm = math.sqrt(_CALM_M_S) * (0.65625 + 0.4375 * ratio**2 - 0.09375 * ratio**4)
    root = np.where(wind < _CALM_M_S, calm, np.sqrt(wind))
    side = np.where(wind < _STILL_M_S, 0.75, np.where(off_normal > _LEE_RAD, 0.5, 1.0))
    return 2.537 * side * 1.52 * 2.0 / area_m2**0.25 * root


def _office() -> BestestHouse:
    """48 m² on soil, whose lower end has a fixed temperature."""
    areas_m2, floor_m2 = (9.6, 16.2, 21.6, 16.2, 48.0, 11.988), 48.0
    surroundings_K = 4.0 * _SIGMA * START_K**3
    chains = Chains()
    for name, area in zip(OUTSIDE[:4], areas_m2, strict=False):
        chains.add_volumes(name, WALL, (1, 1, 2), area)
    chains.add_volumes("roof", ROOF_LAYERS, (1, 2, 1), floor_m2)
    _ground_floor(chains)
    half_pane = 4002.2
    gap = areas_m2[5] * (1.989368 + surroundings_K * _EMISSIVITY / (2.0 - _EMISSIVITY))
    glass = [half_pane, gap, half_pane]
    first = chains.add("window", [0.0, 0.0, 0.0, 66_608.0], glass, [279.0, 279.0, 284.93, 284.93])
    names = ("south", "west", "north", "east", "roof", "floor", "window")
    inside_m2 = np.array([*areas_m2[:5], floor_m2, areas_m2[5]])
    share = inside_m2 / 171.6
    glass_at = names.index("window")
    upright, warm, cold = 1.3, 0.76, 1.51
    film = np.stack([upright * inside_m2, upright * inside_m2], axis=1)
    facing = np.full(len(names), UPRIGHT)
    for name, direction in (("floor", FLOOR), ("roof", CEILING)):
        k = names.index(name)
        film[k], facing[k] = (cold * floor_m2, warm * floor_m2), direction
    by_name_beam = {"south": 0.02938, "west": 0.04957, "north": 0.06609, "east": 0.04957, "roof": 0.14688, "floor": 0.6}
    by_name_diffuse = {
        "south": 0.05371, "west": 0.09064, "north": 0.12086, "east": 0.09064, "roof": 0.26857, "floor": 0.26857,
    }  # fmt: skip
    # Of the radiant gains that strike the glass it reflects a tenth.
    emitted = share.copy()
    emitted[glass_at] *= _EMISSIVITY
    envelope = Envelope(
        capacity=np.array(chains.capacity),
        start_K=np.array(chains.start_K),
        coupling=np.array(chains.coupling),
        outside=chains.outside_nodes(),
        inside=np.array([chains.ends[name][1] for name in names]),
        panes=first + np.arange(4),
        heated=np.array([], dtype=np.int64),
        ground=chains.ends["floor"][0],
        ground_W_K=1.0 / 0.00094268,
        ground_K=283.15,
        outside_m2=np.array(areas_m2),
        sky_view=np.array([0.5] * 4 + [1.0, 0.5]),
        natural=np.array([(upright, upright)] * 4 + [(warm, cold), (0.0, 0.0)]),
        adds_forced=True,
        radiates_linearly=True,
        emissivity=_EMISSIVITY,
        pane_radiation=_EMISSIVITY * surroundings_K,
        facing=facing,
        film=film,
        film_exponent=np.full((len(names), 2), 1.0 / 3.0),
        blend_K=1e-9,
        radiant_W_K=_EMISSIVITY * surroundings_K * inside_m2,
        beam=np.array([by_name_beam.get(name, 0.0) for name in names]),
        diffuse=np.array([by_name_diffuse.get(name, 0.0) for name in names]),
        emitted=emitted,
        emitted_to_star=float(share[glass_at] * (1.0 - _EMISSIVITY)),
        weight=share / share.sum(),
    )
    glazing = Glazing(areas_m2[5], _by_spline, _SYSTEM_DIFFUSE, lost=(0.05848, 0.10694))
    facade = Facade(areas_m2, glazing, _by_root, window_forced=lambda wind: 4.0 + 4.0 * wind, roof_is_south=True)
    return BestestHouse(floor_m2, 155.52, moist_air_cp(0.004), envelope, facade)


def _ground_floor(chains: Chains) -> None:
    """Soil from below, insulation without heat, slab. In steady state at the begin, the slab at `START_K`."""
    soil = [0.00188537] * 16 + [0.00094268]
    resistance = [*soil, 0.524479 + 0.000737, 0.000737463]
    capacity = [6.77647e6] * 16 + [3.388235e6] * 2 + [2.688e6] * 2
    below_K, first = 283.15, 0.00094268
    flow_W = (START_K - below_K) / (first + sum(resistance[:-1]))
    start = [below_K + flow_W * (first + sum(resistance[:i])) for i in range(len(soil) + 1)]
    chains.add("floor", capacity, [1.0 / r for r in resistance], [*start, START_K, START_K])


HEAT_PUMP_HOUSE, BOILER_HOUSE, OFFICE = _heat_pump_house(), _boiler_house(), _office()
