"""Constructions as chains of heat-capacity nodes, and the envelope that they make up: what the compiled step reads.

Layers are listed from outside to inside. All chains together form one tridiagonal system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

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
