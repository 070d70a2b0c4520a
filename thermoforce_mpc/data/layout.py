"""What acts where in a building, and what a plant says of itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from thermoforce_mpc.data.clock import DAY_S, Array
from thermoforce_mpc.data.names import SINGLE, Names, check_same_building
from thermoforce_mpc.errors import DataError


def mode_of(sign: int, u_min: float) -> str:
    """What an actuator does: 'heating', 'cooling', or 'both' where its levels are signed, as levels below 0 cool."""
    if u_min < 0.0:
        return "both"
    return "heating" if sign > 0 else "cooling"


@dataclass(frozen=True)
class Layout:
    """What acts where in a building of Z zones, A actuators and M machines.

    Attributes:
        names: names of zones, actuators and machines.
        signs: +1 for an actuator that heats (or heats and cools), −1 for one that cools (A,).
        home: zone that each actuator serves (A,).
        machine_of: machine that feeds each actuator (A,).
        u_min: lowest level of each actuator, 0, or below where it heats and cools (A,).
        shares: share of its machine's capacity that each actuator takes at full level (A,), 0 where it is the only one.
        floor_area_m2: of each zone, m² (Z,); NaN where it is not known.
        exclusive: groups of actuators (their numbers) of which at most one may act in a step.

    Raises `DataError` for entries that are too few, name what is not there, or are no area or group.
    """

    names: Names = SINGLE
    signs: tuple[int, ...] = (1,)
    home: tuple[int, ...] = (0,)
    machine_of: tuple[int, ...] = (0,)
    u_min: tuple[float, ...] = (0.0,)
    shares: tuple[float, ...] = (0.0,)
    floor_area_m2: tuple[float, ...] = (float("nan"),)
    exclusive: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        Z, A, M = (len(names) for names in (self.names.zones, self.names.actuators, self.names.machines))
        for what, expected in (
            ("signs", A), ("home", A), ("machine_of", A), ("u_min", A), ("shares", A), ("floor_area_m2", Z),
        ):  # fmt: skip
            if len(getattr(self, what)) != expected:
                raise DataError(f"layout: {what} has {len(getattr(self, what))} entries, expected {expected}")
        if not all(0 <= z < Z for z in self.home) or not all(0 <= m < M for m in self.machine_of):
            raise DataError(f"layout: home {self.home} or machine_of {self.machine_of} names what is not there")
        for zone, area in zip(self.names.zones, self.floor_area_m2, strict=True):
            if area <= 0.0:
                where = "" if Z == 1 else f" of {zone}"
                raise DataError(f"layout: floor_area_m2{where} is {area:g} m²: it must be above 0, or NaN if not known")
        for group in self.exclusive:
            if len(group) < 2 or len(set(group)) != len(group) or not all(0 <= a < A for a in group):
                raise DataError(f"layout: exclusive {group}: expected two or more of {A} actuators, each once")
            for a in group:
                if self.u_min[a] < 0.0:
                    raise DataError(
                        f"layout: exclusive: {self.names.actuators[a]} is run by room set-points, whose loops act when "
                        "the zone asks for it: they cannot be excluded"
                    )

    @classmethod
    def single(cls, mode: str = "heating", u_min: float = 0.0, floor_area_m2: float | None = None) -> Layout:
        """One zone with one actuator; `mode` 'heating', 'cooling' or 'both' (levels are signed). Raises `DataError`."""
        if mode not in ("heating", "cooling", "both"):
            raise DataError(f"mode is {mode!r}: expected heating, cooling or both")
        area = float("nan") if floor_area_m2 is None else floor_area_m2
        return cls(signs=(-1 if mode == "cooling" else 1,), u_min=(u_min,), floor_area_m2=(area,))

    def mode(self, a: int) -> str:
        """What actuator `a` does, see `mode_of`."""
        return mode_of(self.signs[a], self.u_min[a])

    def actuators_of(self, zone: int) -> list[int]:
        """The actuators that serve a zone."""
        return [a for a, home in enumerate(self.home) if home == zone]

    def fed_by(self, machine: int) -> list[int]:
        """The actuators that a machine feeds."""
        return [a for a, m in enumerate(self.machine_of) if m == machine]

    @property
    def actuators_of_zones(self) -> list[list[int]]:
        """The actuators that serve each zone (Z,)."""
        return [self.actuators_of(z) for z in range(len(self.names.zones))]

    @property
    def actuators_of_machines(self) -> list[list[int]]:
        """The actuators that each machine feeds (M,)."""
        return [self.fed_by(m) for m in range(len(self.names.machines))]

    @property
    def weights(self) -> Array:
        """What each actuator counts for in the level of its machine: its share, 1 where it is the only one (A,)."""
        return np.array([share or 1.0 for share in self.shares])

    def excluding(self) -> list[tuple[int, int]]:
        """Every pair of actuators of which the first excludes the second."""
        return [(a, b) for group in self.exclusive for a in group for b in group if a != b]

    def excluded(self, wanted: Sequence[float | None]) -> dict[int, int]:
        """The actuators that may not do what is `wanted` of them, each with the one that excludes it.

        `wanted` (A,): 0 where an actuator is off anyway, None for native control. Native control of one leaves all of
        its group to native control, which alone knows what it does there. Otherwise the one that is wanted most acts
        (of equals the first), and the others are off.
        """
        excluded_by: dict[int, int] = {}
        left, native = list(wanted), [a for a, level in enumerate(wanted) if level is None]
        for by in native:  # grows with those that are left to native control here
            for a in {a for group in self.exclusive if by in group for a in group if left[a] is not None}:
                left[a], excluded_by[a] = None, excluded_by.get(by, by)
                native.append(a)
        for group in self.exclusive:
            acting = [a for a in group if left[a]]
            kept = max(acting, key=lambda a: left[a] or 0.0, default=-1)
            for a in acting:
                if a != kept:
                    left[a], excluded_by[a] = 0.0, kept
        return excluded_by


def check_same_layout(what: str, layout: Layout, of: str, other: Layout) -> None:
    """Raise `DataError` where two things (`what` and `of` in words) are not of the same names, or an actuator serves
    another zone, is fed by another machine or does something else.
    """
    check_same_building(what, layout.names, of, other.names)
    names = layout.names
    for a, name in enumerate(names.actuators):
        ours, theirs = (
            f"{one.mode(a)} {names.zones[one.home[a]]}, fed by {names.machines[one.machine_of[a]]}"
            for one in (layout, other)
        )
        if ours != theirs:
            raise DataError(f"by {what.removesuffix(':')} {name} is {ours}, by {of} {theirs}: which is right?")


@dataclass(frozen=True)
class Period:
    """A scored window: it starts at `start_s`, lasts `scored_s`, and follows `warmup_s` of native control."""

    name: str
    start_s: float
    scored_s: float = 14 * DAY_S
    warmup_s: float = 7 * DAY_S


@dataclass(frozen=True)
class PlantInfo:
    """Plant kind, test case, weather and version, for manifests and headlines."""

    kind: str
    testcase: str
    description: str
    weather: str
    version: str
    details: Mapping[str, str] = field(default_factory=dict)
