"""What was measured: at one instant, and over past steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data.clock import Array, check_clock
from thermoforce_mpc.data.names import SINGLE, Names, frozen, of_each
from thermoforce_mpc.errors import DataError

if TYPE_CHECKING:  # loaded only where tables come in
    import pandas as pd

# Signals of a `Record`: samples at the boundaries, and means over the steps between them.
SAMPLED = ("time_s", "T_zone_C", "T_out_C", "solar_W_m2")
ACTING = ("u", "power_W", "heat_W", "T_return_C")
SIGNALS = (*SAMPLED, *ACTING)


@dataclass(frozen=True)
class Record:
    """What was measured over `n` past steps of equal length, the last boundary being *now*.

    Sampled at the boundaries: `time_s`, `T_out_C`, `solar_W_m2` (n + 1,) and `T_zone_C` (Z, n + 1), NaN where the
    sensor was silent. Mean over each step: `u` (A, n) in [0, 1] (in [−1, 1], cooling below 0, where one actuator heats
    and cools), `heat_W` (A, n) delivered heat, `power_W` (M, n) total electric, `T_return_C` (M, n) return water from
    the emitters (NaN where not measured; all of `T_return_C` where it is not given), and `meter_W` (n,), empty where it
    is not measured: what the building takes from the grid, less what it feeds in. `origin` is the `pandas.Timestamp`
    with `time_s` 0 where the record came from a table with time stamps. Raises `DataError` for another shape, no
    instant, or instants that do not go up in equal steps.
    """

    time_s: Array
    T_zone_C: Array
    T_out_C: Array
    solar_W_m2: Array
    u: Array
    power_W: Array
    heat_W: Array
    T_return_C: Array = field(default_factory=lambda: np.empty(0))
    meter_W: Array = field(default_factory=lambda: np.empty(0))
    origin: Any = None
    names: Names = SINGLE

    def __post_init__(self) -> None:
        n = np.size(self.time_s)
        if n < 1:
            raise DataError("a history needs at least one instant")
        if not np.size(self.T_return_C):
            object.__setattr__(self, "T_return_C", np.full((len(self.names.machines), n - 1), np.nan))
        for name in SAMPLED:
            object.__setattr__(self, name, frozen(getattr(self, name), name, n, self.names))
        for name in ACTING:
            object.__setattr__(self, name, frozen(getattr(self, name), name, n - 1, self.names))
        of_meter = n - 1 if np.size(self.meter_W) else 0
        object.__setattr__(self, "meter_W", frozen(self.meter_W, "meter_W", of_meter, self.names))
        check_clock(self.time_s, "history")

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
            DataError: `df` is no data frame, a column is missing, twice there or holds text, most of it is impossible
                in its unit, zone and outdoor are one column, or the index holds no equally spaced time stamps; says
                what to do.
        """
        from thermoforce_mpc.data.dataframes import check_table, measured_column, new_year, seconds_since

        def of(argument: str, name: str | None, signal: str) -> Array:
            return np.full(len(df), np.nan) if name is None else measured_column(df, name, "record", argument, signal)

        check_table(df, "record")
        columns = {"zone": (zone, "T_zone_C"), "outdoor": (outdoor, "T_out_C"), "level": (level, "u")}
        T_zone_C, T_out_C, u = (
            measured_column(df, name, "record", argument, signal) for argument, (name, signal) in columns.items()
        )
        if zone == outdoor:
            raise DataError(f"record: zone and outdoor are the same column, '{zone}'")
        origin = new_year(df.index, "record")
        steps = slice(0, len(df) - 1)
        return cls(
            time_s=seconds_since(origin, df.index, "record"),
            T_zone_C=T_zone_C,
            T_out_C=T_out_C,
            solar_W_m2=np.zeros(len(df)) if solar is None else of("solar", solar, "solar_W_m2"),
            u=u[steps],
            power_W=of("power", power, "power_W")[steps],
            heat_W=of("heat", heat, "heat_W")[steps],
            T_return_C=of("return_water", return_water, "T_return_C")[steps],
            origin=origin,
        )

    def stamps(self) -> pd.Index:
        """Time stamps of the boundaries (n + 1,); seconds since 1 January where the record has no `origin`."""
        from thermoforce_mpc.data.dataframes import stamps

        return stamps(self.time_s, self.origin)

    @property
    def n_steps(self) -> int:
        """Number of past steps n (0 when only the present instant is known)."""
        return int(self.time_s.size - 1)

    @property
    def step_s(self) -> float:
        """Length of a step, s (NaN when only the present instant is known)."""
        return float(self.time_s[1] - self.time_s[0]) if self.n_steps else float("nan")

    def nearest(self, time_s: float) -> int:
        """Number of the boundary nearest to `time_s`, below 0 or above n where the record does not reach it."""
        return round((time_s - float(self.time_s[0])) / self.step_s)

    def last(self, n_steps: int) -> Record:
        """The last `n_steps` steps (all of it when shorter)."""
        return self.slice(self.n_steps - min(n_steps, self.n_steps), self.n_steps)

    def slice(self, start: int, stop: int) -> Record:
        """Steps `start` … `stop` − 1, with the samples at both their ends."""
        values = {name: getattr(self, name)[..., start : stop + 1] for name in SAMPLED}
        values |= {name: getattr(self, name)[..., start:stop] for name in ACTING}
        values |= {"meter_W": self.meter_W[start:stop], "origin": self.origin, "names": self.names}
        if not 0 <= start <= stop <= self.n_steps:
            return Record(**values)
        part = object.__new__(Record)  # what holds of the whole was checked, and holds of its steps
        part.__dict__.update(values)
        return part

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
            meter_W=self.meter_W[: n * every].reshape(-1, every).mean(axis=1),
            origin=self.origin,
            names=self.names,
        )

    @classmethod
    def beginning(cls, measurement: Measurement) -> Record:
        """Record of one instant, without a step."""
        rows = {name: measurement.names.rows(name) for name in ACTING}
        return cls(
            **{name: np.asarray(getattr(measurement, name))[..., None] for name in SAMPLED},
            **{name: np.empty((n, 0)) for name, n in rows.items()},
            names=measurement.names,
        )

    def extended(self, *ends: Measurement) -> Record:
        """This record with the steps that end at the measurements `ends` appended."""
        if not ends:
            return self
        later = {name: np.array([getattr(end, name) for end in ends]).T for name in SIGNALS}
        joined = {name: np.concatenate([getattr(self, name), new], axis=-1) for name, new in later.items()}
        meter_W = np.append(self.meter_W, np.full(len(ends), np.nan)) if self.meter_W.size else self.meter_W
        return Record(**joined, meter_W=meter_W, origin=self.origin, names=self.names)


@dataclass(frozen=True)
class Measurement:
    """Measured values at one instant.

    `time_s` s; `T_zone_C` (Z,), `T_out_C` °C and `solar_W_m2` W/m² are samples; `u`, `heat_W` (A,), `power_W` and
    `T_return_C` (M,) are means over the interval just advanced (NaN right after a reset, and where not measured). Where
    there is one zone, actuator or machine, a number will do. `points`: the plant's own signals, as at the wire.
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
                value = np.full(self.names.rows(name), np.nan)
            object.__setattr__(self, name, of_each(value, name, self.names))

    def averaged_with(self, parts: list[tuple[float, Measurement]]) -> Measurement:
        """This measurement with the means of what acts over a step taken over `(duration_s, part)`."""
        durations_s = np.array([duration for duration, _ in parts])[:, None]

        def mean(name: str) -> Array:  # `np.average` takes several times as long, in every step
            values = np.array([getattr(part, name) for _, part in parts])
            return np.asarray((values * durations_s).sum(axis=0) / durations_s.sum())

        return replace(self, u=mean("u"), power_W=mean("power_W"), heat_W=mean("heat_W"), T_return_C=mean("T_return_C"))
