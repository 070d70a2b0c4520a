"""Constructions of the house as chains of heat-capacity nodes, layers listed from outside to inside.

Source: documentation and model of the BOPTEST test case `bestest_hydronic_heat_pump` (BESTEST case 900 scaled to
192 m², IDEAS library). Every construction is a chain of nodes; all chains form one tridiagonal system.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from thermoforce_mpc.data import Array

AREA_M2 = 192.0
HEIGHT_M = 2.7
VOLUME_M3 = 518.4
_START_K = 293.15
_SOIL_START_K = 283.95


@dataclass(frozen=True)
class Layer:
    """Homogeneous layer: thickness m, conductivity W/(m·K), density kg/m³, heat capacity J/(kg·K), node count."""

    thickness: float
    conductivity: float
    density: float
    capacity: float
    nodes: int
    start_K: float = _START_K


_WOOD = Layer(0.009, 0.14, 530.0, 900.0, 2)
_INSULATION = Layer(0.0615, 0.04, 10.0, 1400.0, 2)
_BLOCK = Layer(0.100, 0.51, 1400.0, 1000.0, 3)
WALL = (_WOOD, _INSULATION, _BLOCK)
ROOF = (Layer(0.019, 0.14, 530.0, 900.0, 2), Layer(0.1118, 0.04, 12.0, 840.0, 2), Layer(0.010, 0.16, 950.0, 840.0, 2))
# From the tile down to the soil; the pipes lie between screed and PUR insulation.
TILE = Layer(0.01, 1.4, 2100.0, 840.0, 2)
SCREED = Layer(0.05, 0.6, 1100.0, 840.0, 2)
FLOOR = (
    TILE,
    SCREED,
    Layer(0.20, 0.02, 30.0, 1470.0, 4),
    Layer(0.15, 1.4, 2100.0, 840.0, 3),
    Layer(0.17, 2.0, 2000.0, 1000.0, 3, _SOIL_START_K),
    Layer(0.33, 2.0, 2000.0, 1000.0, 5, _SOIL_START_K),
    Layer(0.50, 2.0, 2000.0, 1000.0, 7, _SOIL_START_K),
)
# The edge loss to the soil acts on the concrete slab, at the interface of layers 3 and 4.
PARTITION = (
    Layer(0.08, 0.75, 1400.0, 840.0, 2),
    Layer(0.10, 0.036, 110.0, 840.0, 3),
    Layer(0.14, 0.54, 1400.0, 840.0, 3),
    Layer(0.015, 0.6, 975.0, 840.0, 2),
)
PARTITION_M2 = 183.6

WINDOW_M2 = 24.0
_PANE_J_K = 143_068.0
# Two panes and the gap. The test case documents 0.539419 m²K/W for the gap, the conduction of 13 mm of air alone
# (0.0241 W/mK). In the IDEAS library the panes also exchange radiation, 5.86 W/(m²·K) between black surfaces; without
# it the house's heat loss is 10 % too low.
_PANE_RESISTANCE = 0.002995
_PANE_EMISSIVITY = 0.9
_GAP_CONDUCTION = 1.0 / 0.539419
_GAP_RADIATION = 5.86 / (2.0 / _PANE_EMISSIVITY - 1.0)
_WINDOW_RESISTANCE = 2 * _PANE_RESISTANCE + 1.0 / (_GAP_CONDUCTION + _GAP_RADIATION)

# Outside wall areas, m²; all surface arrays use the order south, west, north, east, roof.
WALLS_M2 = (19.2, 32.4, 43.2, 32.4)


class Surface(NamedTuple):
    """Inside surface: area m², weight in the mean radiant temperature, long-wave emissivity, and resistance K⁴/W.

    The weight is area times short-wave absorptance (model constants); the resistance is that to the radiant node
    (emissivity and Carroll's view factor).
    """

    area_m2: float
    share: float
    emissivity: float
    resistance: float


SURFACES = {
    "south": Surface(WALLS_M2[0], 0.02159, 0.9, 1.00445e6),
    "west": Surface(WALLS_M2[1], 0.03644, 0.9, 5.88451e5),
    "north": Surface(WALLS_M2[2], 0.04858, 0.9, 4.37077e5),
    "east": Surface(WALLS_M2[3], 0.03644, 0.9, 5.88451e5),
    "roof": Surface(AREA_M2, 0.21592, 0.9, 81_703.0),
    "floor": Surface(AREA_M2, 0.19793, 0.88, 84_022.5),
    "partition_brick": Surface(PARTITION_M2, 0.22368, 0.88, 92_990.8),
    "partition_gypsum": Surface(PARTITION_M2, 0.18927, 0.85, 89_138.3),
    "window": Surface(WINDOW_M2, 0.03014, 0.9, 8.00259e5),
}


class Network(NamedTuple):
    """Thermal network of n nodes in one chain.

    `capacity` (n,) J/K, `start_K` (n,) K; `coupling` (n,) W/K between nodes i and i + 1, zero at the end of a
    construction. `outside` (6,): node indices of the outside surfaces (south, west, north, east, roof, window);
    `inside` (9,): those of the inside surfaces in the order of `SURFACES`. `pipe` is the heated node, `slab` the node
    with the edge loss to the soil.
    """

    capacity: Array
    coupling: Array
    start_K: Array
    outside: np.ndarray
    inside: np.ndarray
    pipe: int
    slab: int


def build_network() -> Network:
    """Build the network of all constructions."""
    capacity: list[float] = []
    coupling: list[float] = []
    start: list[float] = []
    ends: dict[str, tuple[int, int]] = {}

    def add(name: str, layers: tuple[Layer, ...], area: float) -> list[int]:
        """Append one construction; return the first node of each layer, and the last node."""
        first = len(capacity)
        at = [first]
        capacity.append(0.0)
        start.append(layers[0].start_K)
        for layer in layers:
            segments = layer.nodes - 1
            part = area * layer.thickness * layer.density * layer.capacity / segments
            for _ in range(segments):
                capacity[-1] += part / 2
                coupling.append(layer.conductivity * area * segments / layer.thickness)
                capacity.append(part / 2)
                start.append(layer.start_K)
            at.append(len(capacity) - 1)
        coupling.append(0.0)
        ends[name] = (first, len(capacity) - 1)
        return at

    for name, area in zip(("south", "west", "north", "east"), WALLS_M2, strict=True):
        add(name, WALL, area)
    add("roof", ROOF, AREA_M2)
    floor = add("floor", FLOOR, AREA_M2)
    add("partition", PARTITION, PARTITION_M2)
    ends["window"] = (len(capacity), len(capacity) + 1)
    capacity += [_PANE_J_K, _PANE_J_K]
    coupling += [WINDOW_M2 / _WINDOW_RESISTANCE, 0.0]
    start += [_START_K, _START_K]

    inside = {
        **{name: ends[name][1] for name in ("south", "west", "north", "east", "roof", "window")},
        "floor": ends["floor"][0],
        "partition_brick": ends["partition"][0],
        "partition_gypsum": ends["partition"][1],
    }
    return Network(
        capacity=np.array(capacity),
        coupling=np.array(coupling),
        start_K=np.array(start),
        outside=np.array([ends[name][0] for name in ("south", "west", "north", "east", "roof", "window")]),
        inside=np.array([inside[name] for name in SURFACES]),
        pipe=floor[2],
        slab=floor[4],
    )
