"""Data passed between plant, forecaster, predictor and controller.

Time is in seconds since 1 January 00:00 (BOPTEST's clock). `N` steps have `N + 1` boundaries: what is *sampled*
(temperatures, weather, comfort bounds) has `N + 1` values, what *acts over a step* (u, power, heat) has `N`.
Temperatures are in °C, differences and effects in K, powers and heat flows in W, energies in kWh, u in [0, 1].

A building has Z zones, A actuators and M machines, whose names travel with the arrays (`Names`). Time is the last
axis: zone temperatures and bounds are (Z, …), levels and heat (A, …), power and prices (M, …), the weather (…). Where
there is one of them, constructors also take arrays without that axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import DataError

if TYPE_CHECKING:  # loaded only where tables come in or go out
    import pandas as pd

Array = NDArray[np.float64]

HOUR_S = 3600.0
DAY_S = 86400.0


# Tolerance of equal steps, s: clocks in milliseconds and summed steps round; more is a missing sample.
_CLOCK_ROUNDING_S = 0.01

# Signals of a `Record`: samples at the boundaries, and means over the steps between them.
SAMPLED = ("time_s", "T_zone_C", "T_out_C", "solar_W_m2")
ACTING = ("u", "power_W", "heat_W", "T_return_C")
SIGNALS = (*SAMPLED, *ACTING)
# Arrays of a `Plan` over its horizon.
_PLANNED = ("u", "T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "slack_K", "power_W")
# Signals of a `Boundary`.
CONDITIONS = (
    "time_s", "T_out_C", "solar_W_m2", "occupancy", "lower_C", "upper_C", "price_per_kWh", "emission_kg_per_kWh",
    "heating_price_per_kWh",
)  # fmt: skip


# The first axis of each signal that has one: zones, actuators or machines.
_AXIS = {
    "T_zone_C": "zones",
    "occupancy": "zones",
    "lower_C": "zones",
    "upper_C": "zones",
    "u": "actuators",
    "heat_W": "actuators",
    "power_W": "machines",
    "T_return_C": "machines",
    "price_per_kWh": "machines",
    "emission_kg_per_kWh": "machines",
    "heating_price_per_kWh": "machines",
    **dict.fromkeys(("T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "T_low_C", "T_high_C"), "zones"),
    **dict.fromkeys(("slack_K", "T_free_now_C"), "zones"),
}


@dataclass(frozen=True)
class Names:
    """Names of the zones (Z), actuators (A) and machines (M) of a building, in the order of the arrays.

    Raises:
        DataError: a kind has no name, or one twice.
    """

    zones: tuple[str, ...] = ("zone",)
    actuators: tuple[str, ...] = ("actuator",)
    machines: tuple[str, ...] = ("machine",)

    def __post_init__(self) -> None:
        for kind in ("zones", "actuators", "machines"):
            names = tuple(getattr(self, kind))
            if not names or len(set(names)) != len(names):
                raise DataError(f"{kind} are {list(names)}: expected one name or more, each once")
            object.__setattr__(self, kind, names)

    @property
    def single(self) -> bool:
        """Whether there is one zone, one actuator and one machine."""
        return len(self.zones) == len(self.actuators) == len(self.machines) == 1

    def label(self, signal: str, row: int) -> str:
        """Name of a row of a signal for people: 'T_zone_C' of one zone, 'T_zone_C[bath]' of several."""
        names = getattr(self, _AXIS[signal])
        return signal if len(names) == 1 else f"{signal}[{names[row]}]"

    def columns(self, **signals: Array) -> dict[str, Array]:
        """The rows of `signals` (rows, n) by `label`, as columns of a table."""
        return {self.label(name, row): values for name, rows in signals.items() for row, values in enumerate(rows)}

    def rows(self, signal: str) -> int:
        """Number of rows of a signal: of its zones, actuators or machines."""
        return len(getattr(self, _AXIS[signal]))


SINGLE = Names()
"""One zone with one actuator and one machine."""


@dataclass(frozen=True)
class Layout:
    """What acts where in a building of Z zones, A actuators and M machines.

    Attributes:
        names: names of zones, actuators and machines.
        signs: +1 for an actuator that heats (or heats and cools), −1 for one that cools (A,).
        home: zone that each actuator serves (A,).
        machine_of: machine that feeds each actuator (A,).
        lowest: lowest level of each actuator, 0, or below where it heats and cools (A,).
        shares: share of its machine's capacity that each actuator takes at full level (A,), 0 where it is the only one.
        floor_area_m2: of each zone, m² (Z,); NaN where it is not known.
        exclusive: groups of actuators (their numbers) of which at most one may act in a step.

    Raises:
        DataError: a number of entries is wrong, one names no zone or machine, or a group is not two or more actuators
            whose levels the controller gives.
    """

    names: Names = SINGLE
    signs: tuple[int, ...] = (1,)
    home: tuple[int, ...] = (0,)
    machine_of: tuple[int, ...] = (0,)
    lowest: tuple[float, ...] = (0.0,)
    shares: tuple[float, ...] = (0.0,)
    floor_area_m2: tuple[float, ...] = (float("nan"),)
    exclusive: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        Z, A, M = (len(names) for names in (self.names.zones, self.names.actuators, self.names.machines))
        for what, expected in (
            ("signs", A), ("home", A), ("machine_of", A), ("lowest", A), ("shares", A), ("floor_area_m2", Z),
        ):  # fmt: skip
            if len(getattr(self, what)) != expected:
                raise DataError(f"layout: {what} has {len(getattr(self, what))} entries, expected {expected}")
        if not all(0 <= z < Z for z in self.home) or not all(0 <= m < M for m in self.machine_of):
            raise DataError(f"layout: home {self.home} or machine_of {self.machine_of} names what is not there")
        for group in self.exclusive:
            if len(group) < 2 or len(set(group)) != len(group) or not all(0 <= a < A for a in group):
                raise DataError(f"layout: exclusive {group}: expected two or more of {A} actuators, each once")
            for a in group:
                if self.lowest[a] < 0.0:
                    raise DataError(
                        f"layout: exclusive: {self.names.actuators[a]} is run by room set-points, whose loops act when "
                        "the zone asks for it: they cannot be excluded"
                    )

    @classmethod
    def single(cls, mode: str = "heating", lowest: float = 0.0, floor_area_m2: float | None = None) -> Layout:
        """One zone with one actuator; `mode` 'heating', 'cooling' or 'both' (levels are signed)."""
        area = float("nan") if floor_area_m2 is None else floor_area_m2
        return cls(signs=(-1 if mode == "cooling" else 1,), lowest=(lowest,), floor_area_m2=(area,))

    def mode(self, a: int) -> str:
        """What actuator `a` does: 'heating', 'cooling', or 'both' where its levels are signed."""
        if self.lowest[a] < 0.0:
            return "both"
        return "heating" if self.signs[a] > 0 else "cooling"

    def actuators_of(self, zone: int) -> list[int]:
        """The actuators that serve a zone."""
        return [a for a, home in enumerate(self.home) if home == zone]

    def fed_by(self, machine: int) -> list[int]:
        """The actuators that a machine feeds."""
        return [a for a, m in enumerate(self.machine_of) if m == machine]

    @property
    def weights(self) -> Array:
        """What each actuator counts for in the level of its machine: its share, 1 where it is the only one (A,)."""
        return np.array([share or 1.0 for share in self.shares])

    def excluding(self) -> list[tuple[int, int]]:
        """Every pair of actuators of which the first excludes the second."""
        return [(a, b) for group in self.exclusive for a in group for b in group if a != b]

    def excluded(self, wanted: Sequence[float | None]) -> dict[int, int]:
        """The actuators that may not do what is asked of them, each with the one that excludes it.

        Native control of one leaves all of its group to native control, which alone knows what it does there. Otherwise
        the one that is wanted most acts (of equals the first), and the others are off.

        Args:
            wanted: how much each actuator is wanted (A,), 0 where it is off anyway, None for native control.
        """
        found: dict[int, int] = {}
        left, native = list(wanted), [a for a, one in enumerate(wanted) if one is None]
        for by in native:  # grows with those that are left to native control here
            for a in {a for group in self.exclusive if by in group for a in group if left[a] is not None}:
                left[a], found[a] = None, found.get(by, by)
                native.append(a)
        for group in self.exclusive:
            acting = [a for a in group if left[a]]
            kept = max(acting, key=lambda a: left[a] or 0.0, default=-1)
            for a in acting:
                if a != kept:
                    left[a], found[a] = 0.0, kept
        return found


def _freeze(value: object, name: str, length: int, names: Names) -> Array:
    """An array (length,) or, with an axis of its own, (rows, length); raises `DataError` for another shape."""
    array = value if _frozen(value) else np.array(value, dtype=np.float64)
    expected: tuple[int, ...] = (length,)
    if name in _AXIS:
        rows = len(getattr(names, _AXIS[name]))
        expected = (rows, length)
        if rows == 1 and array.shape == (length,):
            array = array[None]
    if array.shape != expected:
        raise DataError(f"{name} has shape {array.shape}, expected {expected}")
    array.setflags(write=False)
    return array


def _frozen(value: object) -> TypeGuard[Array]:
    """Whether nobody can change `value`, an array, any more: it need not be copied."""
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.flags.writeable:
        return False
    return value.base is None or (isinstance(value.base, np.ndarray) and not value.base.flags.writeable)


def _of_each(value: object, name: str, names: Names) -> Array:
    """Values (rows,) of one instant; a number where there is one row. Raises `DataError` for another shape."""
    array = np.array(value, dtype=np.float64, ndmin=1)
    rows = len(getattr(names, _AXIS[name]))
    if array.shape != (rows,):
        raise DataError(f"{name} has shape {array.shape}, expected ({rows},)")
    array.setflags(write=False)
    return array


def _check_clock(time_s: Array, what: str) -> None:
    """Refuse instants that do not go up in equal steps; raises `DataError` naming the first step that is wrong."""
    steps = np.diff(time_s)
    if not steps.size or (steps[0] > 0 and np.abs(steps - steps[0]).max() <= _CLOCK_ROUNDING_S):
        return
    sound = np.sort(steps[steps > 0])
    usual = float(sound[(sound.size - 1) // 2]) if sound.size else float("nan")
    first = int(np.argmin(np.abs(steps - usual) <= _CLOCK_ROUNDING_S))
    among = f" among steps of {usual:.10g} s" if sound.size else ""
    raise DataError(
        f"{what}: time_s goes from {time_s[first]:.10g} s (index {first}) to {time_s[first + 1]:.10g} s: a step of "
        f"{steps[first]:.10g} s{among}; steps must be equal and positive: resample, with NaN where nothing was measured"
    )


Levels = float | None | Sequence[float | None]
"""Levels of the actuators: one each, or a number for one actuator; None for native control (of all, if alone)."""

Bands = Sequence[Any] | None
"""Room set-points (heating, cooling) of the actuators, °C: one pair each, or one pair for one actuator."""


@dataclass(frozen=True, init=False)
class Block:
    """One stretch of constant actuation: `u` (A,) holds the level of each actuator in [0, 1], None for native control.

    An actuator that heats and cools takes levels in [−1, 1]. `band_C` (A,) are the heating and the cooling set-point
    that the plant's own loops are to keep meanwhile, °C, None where there are none; u is then the mean level that the
    plan expects of them. One actuator's level and band may be given without a tuple.
    """

    u: tuple[float | None, ...]
    duration_s: float
    band_C: tuple[tuple[float, float] | None, ...]

    def __init__(self, u: Levels, duration_s: float, band_C: Bands = None) -> None:
        levels: tuple[Any, ...] = tuple(u) if isinstance(u, Sequence) else (u,)
        if band_C is None:
            bands: tuple[Any, ...] = (None,) * len(levels)
        elif len(levels) == 1 and len(band_C) == 2:
            bands = (band_C,)
        else:
            bands = tuple(band_C)
        if len(bands) != len(levels):
            raise DataError(f"a block of {len(levels)} levels has {len(bands)} bands")
        object.__setattr__(self, "u", tuple(None if level is None else float(level) for level in levels))
        object.__setattr__(self, "duration_s", duration_s)
        object.__setattr__(self, "band_C", bands)

    @classmethod
    def native(cls, n_actuators: int, duration_s: float) -> Block:
        """All actuators under the plant's own control."""
        return cls((None,) * n_actuators, duration_s)

    def as_array(self) -> Array:
        """Levels (A,), NaN under native control."""
        return np.array([np.nan if level is None else level for level in self.u])


@dataclass(frozen=True)
class Boundary:
    """Boundary conditions at `N + 1` equally spaced instants, the first being *now*.

    Shape (N + 1,): `time_s` s, `T_out_C` °C, `solar_W_m2` global horizontal W/m².
    Shape (Z, N + 1): `occupancy` persons, `lower_C` and `upper_C` comfort bounds °C.
    Shape (M, N + 1): `price_per_kWh` currency/kWh and `emission_kg_per_kWh` kg CO2/kWh of each machine's energy. Where
    the heating of a machine that also cools has a carrier of its own (gas beside electric cooling),
    `heating_price_per_kWh` is its price; by default it is `price_per_kWh`.

    Raises:
        DataError: an array of another shape, no instant at all, or instants that do not go up in equal steps.
    """

    time_s: Array
    T_out_C: Array
    solar_W_m2: Array
    occupancy: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    emission_kg_per_kWh: Array
    heating_price_per_kWh: Array = field(default_factory=lambda: np.empty(0))
    names: Names = SINGLE

    def __post_init__(self) -> None:
        n = np.size(self.time_s)
        if n < 1:
            raise DataError("a boundary needs at least one instant")
        if not np.size(self.heating_price_per_kWh):
            object.__setattr__(self, "heating_price_per_kWh", self.price_per_kWh)
        for name in CONDITIONS:
            object.__setattr__(self, name, _freeze(getattr(self, name), name, n, self.names))
        _check_clock(self.time_s, "boundary")

    @classmethod
    def from_dataframe(
        cls,
        df: pd.DataFrame,
        record: Record,
        *,
        outdoor: str,
        solar: str | None = None,
        lower: str | float | None = None,
        upper: str | float | None = None,
        price: str | float | None = None,
        occupancy: str | float = 0.0,
        emission: str | float = 0.0,
    ) -> Boundary:
        """The forecast that follows `record`: one row per step boundary, the first at the record's last time stamp.

        Args:
            df: forecast with a `DatetimeIndex` in any zone; hourly rows are interpolated to the step of `record`.
            record: what was measured until now.
            outdoor: column of the outdoor temperature, °C.
            solar: column of the global horizontal irradiance, W/m²; None where the record has none either.
            lower: lower comfort bound, °C; a column, or one number. A plan needs both bounds, a prediction does not.
            upper: upper comfort bound, °C; the same.
            price: energy price, currency/kWh; the same.
            occupancy: persons; a column, or one number.
            emission: kg CO2/kWh; a column, or one number.

        Raises:
            DataError: a column is missing, the rows do not begin at the end of `record` or are not in order.
        """
        from thermoforce_mpc.dataframes import seconds_since, series

        if record.origin is None:
            raise DataError("forecast: the record has no time stamps; make it with Record.from_dataframe")
        at_s = seconds_since(record.origin, df.index, "forecast")
        if at_s.size < 2 or not (np.diff(at_s) > 0).all():
            raise DataError("forecast: it needs two rows or more, in order of time; use df.sort_index()")
        now_s, step_s = float(record.time_s[-1]), record.step_s
        if not at_s[0] <= now_s + _CLOCK_ROUNDING_S < at_s[-1]:
            raise DataError(
                f"forecast: it goes from {df.index[0]} to {df.index[-1]}, the record ends at {record.stamps()[-1]}: "
                "the rows must begin there (or before) and go on"
            )
        steps = np.arange(np.floor((at_s[-1] - now_s + _CLOCK_ROUNDING_S) / step_s) + 1.0)
        time_s = now_s + steps * step_s
        # Temperatures go straight between two rows; what follows a schedule holds until the next row.
        held = np.clip(np.searchsorted(at_s, time_s + _CLOCK_ROUNDING_S, side="right") - 1, 0, at_s.size - 1)

        def line(given: str | float | None) -> Array:
            return np.interp(time_s, at_s, series(df, given, "forecast"))

        def step(given: str | float | None) -> Array:
            return series(df, given, "forecast")[held]

        sun = np.zeros(time_s.size) if solar is None else line(solar)
        return cls(time_s, line(outdoor), sun, step(occupancy), step(lower), step(upper), step(price), step(emission))

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.time_s.size - 1)

    @property
    def step_s(self) -> float:
        """Length of a step, s."""
        return float(self.time_s[1] - self.time_s[0])

    def check(self, *names: str) -> None:
        """Raises `DataError` where one of the signals `names` has a value that is no number; says which and when."""
        for name in names:
            for row, values in enumerate(np.atleast_2d(getattr(self, name))):
                missing = np.flatnonzero(~np.isfinite(values))
                if missing.size:
                    label = self.names.label(name, row) if name in _AXIS else name
                    raise DataError(
                        f"boundary forecast: {label} is missing at {missing.size} of {self.time_s.size} instants, "
                        f"first at {self.time_s[missing[0]]:.10g} s "
                        f"({(self.time_s[missing[0]] - self.time_s[0]) / HOUR_S:g} h ahead): check its source"
                    )

    def part(self, zone: int, machine: int = 0) -> Boundary:
        """The boundary conditions of one zone and one machine."""
        names = Names((self.names.zones[zone],), machines=(self.names.machines[machine],))
        row = {"zones": zone, "machines": machine}
        return Boundary(
            **{
                name: getattr(self, name)[row[_AXIS[name]]] if name in _AXIS else getattr(self, name)
                for name in CONDITIONS
            },
            names=names,
        )

    def head(self, n_steps: int) -> Boundary:
        """The first `n_steps` steps."""
        return Boundary(**{name: getattr(self, name)[..., : n_steps + 1] for name in CONDITIONS}, names=self.names)


@dataclass(frozen=True)
class Record:
    """What was measured over `n` past steps of equal length, the last boundary being *now*.

    Sampled at the boundaries: `time_s`, `T_out_C`, `solar_W_m2` (n + 1,) and `T_zone_C` (Z, n + 1), NaN where the
    sensor was silent.
    Mean over each step: `u` (A, n) in [0, 1] (in [−1, 1], cooling below 0, where one actuator heats and cools),
    `heat_W` (A, n) delivered heat, `power_W` (M, n) total electric, `T_return_C` (M, n) return water from the emitters
    (NaN where not measured; all of `T_return_C` where it is not given).
    `origin` is the `pandas.Timestamp` with `time_s` 0 where the record came from a table with time stamps.

    Raises:
        DataError: an array of another shape, no instant at all, or instants that do not go up in equal steps.
    """

    time_s: Array
    T_zone_C: Array
    T_out_C: Array
    solar_W_m2: Array
    u: Array
    power_W: Array
    heat_W: Array
    T_return_C: Array = field(default_factory=lambda: np.empty(0))
    origin: Any = None
    names: Names = SINGLE

    def __post_init__(self) -> None:
        n = np.size(self.time_s)
        if n < 1:
            raise DataError("a history needs at least one instant")
        if not np.size(self.T_return_C):
            object.__setattr__(self, "T_return_C", np.full((len(self.names.machines), n - 1), np.nan))
        for name in SAMPLED:
            object.__setattr__(self, name, _freeze(getattr(self, name), name, n, self.names))
        for name in ACTING:
            object.__setattr__(self, name, _freeze(getattr(self, name), name, n - 1, self.names))
        _check_clock(self.time_s, "history")

    @classmethod
    def from_dataframe(
        cls,
        df: pd.DataFrame,
        *,
        zone: str,
        outdoor: str,
        level: str,
        solar: str | None = None,
        power: str | None = None,
        heat: str | None = None,
        return_water: str | None = None,
    ) -> Record:
        """A record from a table with one row per step; signals that were not measured are left out.

        A row holds the temperatures and irradiance at its time stamp, and the means of level, power, heat and return
        water over the step that begins there; in the last row only the former count. Empty cells are gaps. Without
        `solar` the sun counts as a disturbance (0 W/m² throughout).

        Args:
            df: table with a `DatetimeIndex`, equally spaced, in any time zone.
            zone: column of the zone temperature, °C.
            outdoor: column of the outdoor temperature, °C.
            level: column of the actuator level, in [0, 1].
            solar: column of the global horizontal irradiance, W/m².
            power: column of the electric power, W; needed to plan with.
            heat: column of the delivered heat, W.
            return_water: column of the return water temperature, °C.

        Raises:
            DataError: a column is missing or holds text, the index holds no time stamps, or they are not equally
                spaced; the message says what to do.
        """
        from thermoforce_mpc.dataframes import new_year, seconds_since, series

        origin = new_year(df.index, "record")
        steps = slice(0, len(df) - 1)
        return cls(
            time_s=seconds_since(origin, df.index, "record"),
            T_zone_C=series(df, zone, "record"),
            T_out_C=series(df, outdoor, "record"),
            solar_W_m2=np.zeros(len(df)) if solar is None else series(df, solar, "record"),
            u=series(df, level, "record")[steps],
            power_W=series(df, power, "record")[steps],
            heat_W=series(df, heat, "record")[steps],
            T_return_C=series(df, return_water, "record")[steps],
            origin=origin,
        )

    def stamps(self) -> pd.Index:
        """Time stamps of the boundaries (n + 1,); seconds since 1 January where the record has no `origin`."""
        from thermoforce_mpc.dataframes import stamps

        return stamps(self.time_s, self.origin)

    @property
    def n_steps(self) -> int:
        """Number of past steps n (0 when only the present instant is known)."""
        return int(self.time_s.size - 1)

    @property
    def step_s(self) -> float:
        """Length of a step, s (NaN when only the present instant is known)."""
        return float(self.time_s[1] - self.time_s[0]) if self.n_steps else float("nan")

    def last(self, n_steps: int) -> Record:
        """The last `n_steps` steps (all of it when shorter)."""
        return self.slice(self.n_steps - min(n_steps, self.n_steps), self.n_steps)

    def slice(self, start: int, stop: int) -> Record:
        """Steps `start` … `stop` − 1, with the samples at both their ends."""
        return Record(
            **{name: getattr(self, name)[..., start : stop + 1] for name in SAMPLED},
            **{name: getattr(self, name)[..., start:stop] for name in ACTING},
            origin=self.origin,
            names=self.names,
        )

    def part(self, zone: int, actuators: Sequence[int], machines: Sequence[int] = ()) -> Record:
        """The record of one zone with some of the actuators and machines; without machines, power is not measured."""
        if self.names.single and len(actuators) == len(machines) == 1:
            return self
        names = Names(
            (self.names.zones[zone],),
            tuple(self.names.actuators[a] for a in actuators),
            tuple(self.names.machines[m] for m in machines) or ("machine",),
        )
        unknown = np.full((1, self.n_steps), np.nan)
        chosen, fed = list(actuators), list(machines)
        return replace(
            self,
            T_zone_C=self.T_zone_C[zone],
            u=self.u[chosen],
            heat_W=self.heat_W[chosen],
            power_W=self.power_W[fed] if fed else unknown,
            T_return_C=self.T_return_C[fed] if fed else unknown,
            names=names,
        )

    def resample(self, every: int) -> Record:
        """Steps of `every` steps each, from the first on: samples at their ends, means over them; a rest is cut."""
        n = self.n_steps // every
        return Record(
            **{name: getattr(self, name)[..., : n * every + 1 : every] for name in SAMPLED},
            **{
                name: getattr(self, name)[:, : n * every].reshape(-1, n, every).mean(axis=-1)
                if n
                else getattr(self, name)[:, :0]
                for name in ACTING
            },
            origin=self.origin,
            names=self.names,
        )

    def weather(self) -> Boundary:
        """Measured weather as a perfect forecast; the other boundary conditions are NaN."""
        of_zone, of_machine = (
            np.full((len(n), self.time_s.size), np.nan) for n in (self.names.zones, self.names.machines)
        )
        return Boundary(
            self.time_s, self.T_out_C, self.solar_W_m2, of_zone, of_zone, of_zone, of_machine, of_machine,
            names=self.names,
        )  # fmt: skip

    @classmethod
    def beginning(cls, measurement: Measurement) -> Record:
        """Record of one instant, without a step."""
        rows = {name: len(getattr(measurement.names, _AXIS[name])) for name in ACTING}
        return cls(
            **{name: np.asarray(getattr(measurement, name))[..., None] for name in SAMPLED},
            **{name: np.empty((n, 0)) for name, n in rows.items()},
            names=measurement.names,
        )

    def extended(self, measurement: Measurement) -> Record:
        """This record with the step that ends at `measurement` appended."""
        return Record(
            **{
                name: np.concatenate([getattr(self, name), np.asarray(getattr(measurement, name))[..., None]], axis=-1)
                for name in SIGNALS
            },
            origin=self.origin,
            names=self.names,
        )


@dataclass(frozen=True)
class Measurement:
    """Measured values at one instant.

    `time_s` s; `T_zone_C` (Z,), `T_out_C` °C and `solar_W_m2` W/m² are samples at that instant; `u`, `heat_W` (A,),
    `power_W` (total electric) and `T_return_C` (return water) (M,) are means over the interval just advanced (NaN right
    after a reset, and where not measured). Where there is one zone, actuator or machine, a number will do. `points`
    holds the plant's own signals by their own names and units, as at the wire.
    """

    time_s: float
    T_zone_C: Array
    T_out_C: float
    solar_W_m2: float
    u: Array = field(default_factory=lambda: np.empty(0))
    power_W: Array = field(default_factory=lambda: np.empty(0))
    heat_W: Array = field(default_factory=lambda: np.empty(0))
    T_return_C: Array = field(default_factory=lambda: np.empty(0))
    points: Mapping[str, float] = field(default_factory=dict)
    names: Names = SINGLE

    def __post_init__(self) -> None:
        for name in ("T_zone_C", *ACTING):
            value = getattr(self, name)
            if not np.size(value):
                value = np.full(len(getattr(self.names, _AXIS[name])), np.nan)
            object.__setattr__(self, name, _of_each(value, name, self.names))

    def averaged_with(self, parts: list[tuple[float, Measurement]]) -> Measurement:
        """This measurement with the means of what acts over a step taken over `(duration_s, part)`."""
        weights = np.array([duration for duration, _ in parts])

        def mean(name: str) -> Array:
            return np.average([getattr(part, name) for _, part in parts], weights=weights, axis=0)

        return replace(self, u=mean("u"), power_W=mean("power_W"), heat_W=mean("heat_W"), T_return_C=mean("T_return_C"))


@dataclass(frozen=True)
class Observation:
    """Input of a controller: the record until now and the forecast of the boundary conditions."""

    history: Record
    boundary: Boundary

    @property
    def time_s(self) -> float:
        """Now, s since 1 January."""
        return float(self.history.time_s[-1])

    @property
    def T_zone_C(self) -> Array:
        """Zone temperatures now (Z,), °C (NaN when the sensor is silent)."""
        return np.asarray(self.history.T_zone_C[:, -1])

    @property
    def names(self) -> Names:
        """Names of zones, actuators and machines."""
        return self.history.names


@dataclass(frozen=True)
class FreeForecast:
    """A free response over `N` steps, of one zone as a method gives it, or of all Z zones (`stacked`).

    `quantiles_C` °C has shape (Q, N) or (Q, Z, N) for the increasing `levels` (Q,); `note` says what made it, and
    `doubt` why it was not the method asked for; empty where it was.
    """

    levels: Array
    quantiles_C: Array
    note: str = ""
    doubt: str = ""

    @classmethod
    def stacked(cls, zones: Sequence[FreeForecast]) -> FreeForecast:
        """The forecasts of all zones as one; levels that not all zones have are interpolated."""
        levels = np.asarray(zones[0].levels, dtype=np.float64)
        rows = [np.stack([zone.quantile_C(float(level)) for level in levels]) for zone in zones]
        note = "; ".join(dict.fromkeys(zone.note for zone in zones))
        doubt = "; ".join(dict.fromkeys(zone.doubt for zone in zones if zone.doubt))
        return cls(levels, np.stack(rows, axis=1), note, doubt)

    @property
    def median_C(self) -> Array:
        """The 0.5 quantile, shape (N,) or (Z, N), °C."""
        index = int(np.argmin(np.abs(np.asarray(self.levels) - 0.5)))
        return np.asarray(self.quantiles_C[index], dtype=np.float64)

    def quantile_C(self, level: float) -> Array:
        """The quantile of `level`, shape (N,) or (Z, N), °C: between levels that were forecast by a straight line,
        beyond the outermost theirs.
        """
        levels = np.asarray(self.levels, dtype=np.float64)
        place = float(np.interp(level, levels, np.arange(levels.size)))
        below = min(int(place), levels.size - 2) if levels.size > 1 else 0
        share = place - below
        lower, upper = self.quantiles_C[below], self.quantiles_C[min(below + 1, levels.size - 1)]
        return np.asarray(lower + share * (upper - lower), dtype=np.float64)


class PlanStatus(StrEnum):
    """Source of an action."""

    SOLVED = "solved"  # an optimisation whose status and solution were checked
    BRIDGED = "bridged"  # as solved, with a substitute for a reading, a weather forecast or the free forecast
    ACCEPTABLE = "acceptable"  # first fallback level: levels of a solver that did not reach its optimum, checked
    SHIFTED = "shifted"  # second: the previous plan, one step on
    THERMOSTAT = "thermostat"  # third: on/off rule
    NATIVE = "native"  # last: the plant's own control, where nothing is known to act on
    GUARD = "guard"  # the zone was far outside the comfort band: full level or off instead of the plan
    GATE = "gate"  # the model is not competent: native control or the on/off rule acts
    WATCH = "watch"  # the model does not hold at present: native control or the on/off rule acts
    RULE = "rule"  # the controller is a rule; nothing was solved

    @property
    def fallen_back(self) -> bool:
        """Whether what acted took the place of an optimal plan; gate and watch are told apart."""
        return self in (self.ACCEPTABLE, self.SHIFTED, self.THERMOSTAT, self.NATIVE, self.GUARD)


@dataclass(frozen=True)
class Plan:
    """A decision and its reason.

    `blocks` is what to apply until the next plan. The arrays describe the whole horizon of N steps for reports: planned
    `u` (A, N), predicted `T_free_C` and `T_forced_K` at the end of each step and comfort `slack_K` (violation allowed
    for) (Z, N), and predicted `power_W` (M, N); they are empty for rules. `time_s` (N,) is the start of each step,
    counted from `origin` where the record has time stamps. `T_free_now_C` (Z,) is the control-free temperature the plan
    starts from.
    `acting` (A,): source of the action of each actuator; `status` is that of the plan, or of what took the place of the
    plan at one of them. `why` is one sentence for people; `solver_status` is the status reported by the solver. `state`
    goes to the controller's next plan of this run and is opaque to others.
    """

    blocks: tuple[Block, ...]
    status: PlanStatus
    why: str
    u: Array = field(default_factory=lambda: np.empty(0))
    T_free_now_C: Array = field(default_factory=lambda: np.empty(0))
    T_free_C: Array = field(default_factory=lambda: np.empty(0))
    T_forced_K: Array = field(default_factory=lambda: np.empty(0))
    T_free_low_C: Array = field(default_factory=lambda: np.empty(0))
    T_free_high_C: Array = field(default_factory=lambda: np.empty(0))
    slack_K: Array = field(default_factory=lambda: np.empty(0))
    power_W: Array = field(default_factory=lambda: np.empty(0))
    time_s: Array = field(default_factory=lambda: np.empty(0))
    origin: Any = None
    solver_status: str = ""
    iterations: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    names: Names = SINGLE
    acting: tuple[PlanStatus, ...] = ()
    state: object = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not self.acting:
            object.__setattr__(self, "acting", (self.status,) * len(self.names.actuators))
        for name in _PLANNED:
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if not values.size:
                values = np.empty((self.names.rows(name), 0))
            object.__setattr__(self, name, values[None] if values.ndim == 1 else values)
        now = self.T_free_now_C if np.size(self.T_free_now_C) else np.full(len(self.names.zones), np.nan)
        object.__setattr__(self, "T_free_now_C", _of_each(now, "T_free_now_C", self.names))

    @property
    def T_zone_C(self) -> Array:
        """Predicted zone temperatures at the end of each step, free plus forced (paper eq:compose), (Z, N), °C."""
        return np.asarray(self.T_free_C + self.T_forced_K, dtype=np.float64)

    def to_dataframe(self) -> pd.DataFrame:
        """The planned horizon, one row per step at its start; no rows where nothing was solved.

        Columns: `u` and mean electric `power_W` over the step; at its end `T_zone_C`, the 80 % band `T_low_C` to
        `T_high_C` of the free response, `T_free_C`, `T_forced_K` and the comfort violation `slack_K`. With several
        zones, actuators or machines, one of each per name: `T_zone_C[bath]`.
        """
        from thermoforce_mpc.dataframes import table

        columns = self.names.columns(
            u=self.u,
            power_W=self.power_W,
            T_zone_C=self.T_zone_C,
            T_low_C=self.T_free_low_C + self.T_forced_K,
            T_high_C=self.T_free_high_C + self.T_forced_K,
            T_free_C=self.T_free_C,
            T_forced_K=self.T_forced_K,
            slack_K=self.slack_K,
        )
        return table(self.time_s, self.origin, **columns)


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
