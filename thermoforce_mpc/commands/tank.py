"""A tank of hot water that its machine heats in the place of the rooms: what is set, and what a record tells of it.

In kelvin of the tank's sensor, so that neither its size nor heat need be known:

    dT/dt = rise · [charging] − loss · (T − cellar) − draw        begins at T < target − band, ends at T ≥ target
    energy per kelvin = e₀ + e_T (T − 50 °C) + e_out (T_out − mean)

A charge is a rise between turning points, or where its column says so. Its energy is what the meter shows meanwhile:
while the tank is charged the machine heats nothing else. Draw-off is what falls beyond the standing loss, by hours of
the record's days; plans are made for all these days, so that what belongs together (shower after shower) stays so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.commands.command import Command, SwitchCommand, TemperatureCommand
from thermoforce_mpc.commands.kinds import told_apart
from thermoforce_mpc.data import DAY_S, HOUR_S, NORMAL_95, Array, HotWaterPlan, Plan, steps_in
from thermoforce_mpc.data.clock import hour_of_day, whole_hour
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.data.series import means_between, stretches
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.scenario.comfort import TankComfort

if TYPE_CHECKING:  # loaded only where tables are read
    import pandas as pd

# A tank's sensor falls by less than this between two parts of one charge, and rises by more in one, K: half of the
# smallest band that is usual (4 K), several times the resolution of the coarsest sensors (0.5 K).
_TURN_K, _LEAST_RISE_K = 0.6, 2.0
# Rows by which a column may say later than the sensor that a charge began or ended.
_LATE = 2
# Least of a record: days, charges that were measured from begin to end, and hours of a day that tells what is drawn.
_LEAST_DAYS, _LEAST_CHARGES, _LEAST_HOURS = 5, 6, 18
# Where the tank stands, °C (EN 15316-5: heated cellar); the loss is small, and half of it leaves plans as they are.
CELLAR_C, _MIDDLE_C = 18.0, 50.0
# The energy of a kelvin rises with the tank and falls with the outdoor temperature by about 1 / lift, 2 % per K at
# 45 K (Carnot); what a record of one target tells least of. Standard deviation of both.
_PER_K, _PER_K_SD = 0.02, 0.01
# Standing loss: fall over windows of so many hours, this quantile of it, and most of it, 1/h.
_STILL_H, _STILL, _MOST_LOSS = 4.0, 0.15, 0.1
# Charges begin while hot water is drawn: this quantile of their rises is that of the machine.
_FASTER = 0.75
# Most that a machine gains with a kelvin outdoors, as a share: air to water, full load (EN 14511 data: 2 to 3 %).
_MOST_SLOPE = 0.04
# Standard error of the energy of a kelvin from which on the record does not tell it.
_MOST_ERROR = 0.3
# Distance of the meter's readings, as a share of a charge, from which on they do not tell its energy.
_MOST_APART = 0.5
# Scatter of where charges begin or end from which on something else than the target begins them, K.
_MOST_BAND_SD_K = 4.0
# A reading that is older says nothing of now, s.
_OLD_S = HOUR_S
# Parts of a step in which a tank is followed.
_PARTS = 4
CHARGED = 0.02
"""Share of a step that its machine charges a tank from which on the meter says nothing of the rooms."""


TANK_NAME = "hot_water"
"""What a tank is called where something is set at it."""
ANY_TANK = TankComfort(schedule="else 20-80")
"""No wish of a tank's temperature."""


class TankTarget(TemperatureCommand):
    """Target temperature of a tank of hot water: the device charges below it by its own band, up to it."""

    usual_C: ClassVar[tuple[float, float]] = (35.0, 60.0)
    possible_C: ClassVar[tuple[float, float]] = (10.0, 80.0)
    name_in_words: ClassVar[str] = "the target of the tank"

    kind: Literal["tank_target"]

    def check_bounds(self, of: str, lower_C: float, upper_C: float) -> None:
        """See `Command.check_bounds`."""
        self._check_reach(of, lower_C, upper_C)

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`; of the tank's comfort."""
        return self.within(lower_C, upper_C)

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"tank target {super().in_words(value)}"


class TankCharge(SwitchCommand):
    """A switch that charges a tank of hot water up to the device's own target (1), or leaves it to the device (0)."""

    name_in_words: ClassVar[str] = "a switch that charges the tank"

    kind: Literal["tank_charge"]

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return "charge the tank" if value >= 0.5 else "tank left to the device"


if TYPE_CHECKING:
    AnyTankCommand = Command
else:
    AnyTankCommand = told_apart((TankTarget, TankCharge))
    """What can be set at a tank, told apart by its key `kind`."""


@dataclass(frozen=True, eq=False)
class TankRecord:
    """A tank over n steps: at `time_s` (n + 1,), s, its temperature and that outdoors, °C, and what was set (NaN: not
    known); over each step (n,) the power of its machine, W, and the share that it was charged, NaN where no column
    says it. `clock_s` (n + 1,): what a clock on the wall showed, s. `usual` (n + 1,): what people would have set; None:
    what was set. `power_every_s`: usual distance of the meter's readings, s.
    """

    time_s: Array
    T_C: Array
    T_out_C: Array
    command: Array
    power_W: Array
    charging: Array
    clock_s: Array
    usual: Array | None = None
    power_every_s: float = 0.0

    def last(self, days: float) -> TankRecord:
        """Its last `days`."""
        n = min(self.charging.size, round(days * DAY_S / self.step_s))
        at, over = slice(-n - 1, None), slice(-n, None)
        return TankRecord(
            self.time_s[at],
            self.T_C[at],
            self.T_out_C[at],
            self.command[at],
            self.power_W[over],
            self.charging[over],
            self.clock_s[at],
            None if self.usual is None else self.usual[at],
            self.power_every_s,
        )

    def now(self) -> tuple[float, bool]:
        """Its temperature at the end, °C, NaN where it was not read lately, and whether it is charged then."""
        known = np.flatnonzero(np.isfinite(self.T_C))
        if not known.size or self.time_s[-1] - self.time_s[known[-1]] > _OLD_S:
            return float("nan"), False
        return float(self.T_C[known[-1]]), bool(
            np.nan_to_num(self.last(1.0).charges()[known[-1] - self.T_C.size]) > 0.0
        )

    def share_of(self, grid_s: Array) -> Array:
        """Share of the steps between `grid_s` (m + 1,), s, that the tank was charged (m,); not known counts as not."""
        return np.asarray(np.clip(means_between(self.time_s, np.nan_to_num(self.charges()), grid_s), 0.0, 1.0))

    @property
    def step_s(self) -> float:
        """Its step, s."""
        return float(self.time_s[1] - self.time_s[0])

    def charges(self) -> Array:
        """Share of each step that the tank was charged (n,), by its rise; NaN: not known.

        A column says which rises are charges, and of charges that do not raise it; it may be read a row late. What
        rises without it is heated by something else.
        """
        measured = np.isfinite(self.T_C[1:]) & np.isfinite(self.T_C[:-1])
        out, rises, dT = np.where(measured, 0.0, np.nan), _rises(self.T_C), np.diff(self.T_C)
        has_column = bool(np.isfinite(self.charging).any())
        left = np.where(measured, np.nan_to_num(self.charging), np.nan)
        full = float(np.median([dT[first:stop].max() for first, stop in rises])) if rises else 1.0
        for first, stop in rises:
            out[first:stop] = 1.0
            for edge in (first, stop - 1):
                out[edge] = np.clip(dT[edge] / full, 0.0, 1.0)
            around = slice(max(first - _LATE, 0), stop + _LATE)
            if has_column and not (left[around] > 0.0).any():
                out[first:stop] = np.nan
            left[around] = 0.0
        return np.maximum(out, left)


def _rises(T_C: Array) -> list[tuple[int, int]]:
    """Steps of the rises of a tank's sensor (n + 1,), from a lowest to a highest point, first and behind the last."""
    out: list[tuple[int, int]] = []
    low = high = None
    for k, T in enumerate(T_C.tolist()):
        if not np.isfinite(T):
            low = high = None
            continue
        if low is None or high is None:
            low = high = k
            continue
        if T_C[high] < T:
            high = k
        elif T_C[high] - T > _TURN_K or k == T_C.size - 1:
            if T_C[high] - T_C[low] >= _LEAST_RISE_K:
                out.append(_trimmed(T_C, low, high))
            low = high = k
        if T_C[low] >= T:
            low = high = k
    return out


def _trimmed(T_C: Array, first: int, stop: int) -> tuple[int, int]:
    """A rise without slow steps at its ends, which are none of it."""
    dT = np.diff(T_C[first : stop + 1])
    fast = np.flatnonzero(dT > 0.1 * dT.max())
    return first + int(fast[0]), first + int(fast[-1]) + 1


def _Wh_per_K(energy: np.ndarray, T_C: Any, outdoors_K: Any) -> Any:
    """Of a tank at `T_C`, `outdoors_K` warmer outdoors than the mean; a tenth of the usual at least."""
    return np.maximum(energy[0] + energy[1] * (T_C - _MIDDLE_C) + energy[2] * outdoors_K, 0.1 * energy[0])


_Wh_per_K_compiled = njit(cache=True)(_Wh_per_K)  # for `_follow`; arrays need none


@dataclass(frozen=True, eq=False)
class LearnedTank:
    """What a record tells of a tank; `..._sd` are standard errors.

    `energy` (3,): see the head of this module, Wh/K, about `T_out_mean_C`; `rise` (2,): while it is charged, K/h, and
    its slope by the outdoor temperature, K/h/K; `loss_1_h`: standing; `draws_K` (days, 24): by hour of the clock. The
    device begins a charge `band_K` below its target, which is usually `usual_C` (24,), by hour of the clock. `comfort`:
    lowest and highest temperature by schedule.
    """

    machine: str
    command: Command | None
    energy: Array
    energy_sd: float
    T_out_mean_C: float
    rise: Array
    rise_sd: float
    loss_1_h: float
    loss_sd: float
    draws_K: Array
    usual_C: Array
    band_K: float
    band_sd: float
    charges: int
    days: float
    charge_kWh: float
    comfort: TankComfort = ANY_TANK
    origin: pd.Timestamp | None = None

    def Wh_per_K(self, T_C: Array | float, T_out_C: Array | float) -> Array:
        """Electric energy that a kelvin of the tank takes, Wh/K; a tenth of the usual at least."""
        return np.asarray(_Wh_per_K(self.energy, np.asarray(T_C), np.asarray(T_out_C) - self.T_out_mean_C))

    @property
    def rise_K_h(self) -> float:
        """By how much it rises while it is charged, K/h, at the mean outdoor temperature of the record."""
        return float(self.rise[0])

    def rise_at(self, T_out_C: Array) -> Array:
        """By how much it rises while it is charged, K/h, of the shape of `T_out_C`; a tenth of the usual at least."""
        return np.asarray(np.maximum(self.rise[0] + self.rise[1] * (T_out_C - self.T_out_mean_C), 0.1 * self.rise[0]))

    def draws_from(self, clock_s: float, n_steps: int, step_s: float) -> Array:
        """What is drawn in each of `n_steps` from `clock_s` on, as in each day of the record, (S, n), K."""
        at_h = float(hour_of_day(clock_s)) + np.arange(n_steps + 1) * step_s / HOUR_S
        days, after = np.arange(len(self.draws_K)), np.roll(np.arange(len(self.draws_K)), -1)
        following = [self.draws_K[days], self.draws_K[after], self.draws_K[np.roll(after, -1)]]
        so_far = np.cumsum(np.concatenate(following, axis=1), axis=1)
        so_far = np.concatenate([np.zeros((len(so_far), 1)), so_far], axis=1)
        total = np.array([np.interp(at_h, np.arange(so_far.shape[1]), row) for row in so_far])
        return np.asarray(np.diff(total, axis=1))

    @property
    def in_words(self) -> str:
        """What was learned, with 90 % bands."""
        a_day = self.draws_K.sum(axis=1)
        by_hour = np.quantile(self.draws_K, 0.9, axis=0)
        most = ", ".join(f"{h}:00 {by_hour[h]:.1f} K" for h in sorted(np.argsort(-by_hour)[:3].tolist()))
        return (
            f"{self.charges} charges in {self.days:.0f} days, {self.charge_kWh:.2f} kWh each; a kelvin takes "
            f"{_band(self.energy[0], self.energy_sd)} Wh at {_MIDDLE_C:.0f} °C and {self.T_out_mean_C:.0f} °C "
            f"outdoors, it rises by {_band(self.rise_K_h, self.rise_sd)} K/h and loses "
            f"{_band((_MIDDLE_C - CELLAR_C) * self.loss_1_h, (_MIDDLE_C - CELLAR_C) * self.loss_sd)} K/h standing; the "
            f"device begins {_band(self.band_K, self.band_sd)} K below its target; draw-off {a_day.mean():.1f} K a day "
            f"(9 of 10 below {np.quantile(a_day, 0.9):.1f}), most of it (9 of 10) at {most}"
        )


def _band(value: float, sd: float) -> str:
    half = NORMAL_95 * sd
    return f"{value:.3g}" if half < 1e-3 * abs(value) else f"{value:.3g} ± {half:.2g}"


def tank_rows(plan: Plan, command: Command | None) -> list[dict[str, Any]]:
    """What a plan sets at the tank, in the order of time, JSON types; `value` None: leave it to the device."""
    from thermoforce_mpc.data.dataframes import stamps

    told = plan.hot_water
    if told is None or command is None:
        return []
    step_s, begins = float(plan.time_s[1] - plan.time_s[0]), plan.time_s
    changes = [0, *(k for k in range(1, begins.size) if told.command[k] != told.command[k - 1]), begins.size]
    ends = stamps(np.append(begins, begins[-1] + step_s), plan.origin)
    rows = []
    for first, stop in pairwise(changes):
        value = told.command[first]
        text = "left to the device" if value is None else command.in_words(value)
        row = {"actuator": TANK_NAME, "kind": command.kind, "from": ends[first].isoformat()}
        told_value = None if value is None else command.as_told(value)
        rows.append(row | {"until": ends[stop].isoformat(), "value": told_value, "unit": command.told_in, "text": text})
    return rows


def tank_in_words(told: HotWaterPlan) -> str:
    """What a plan makes of the tank, in a sentence."""
    now = "" if np.isnan(told.T_now_C) else f"{told.T_now_C:.1f} °C now, "
    return (
        f"Hot water: {now}cost {told.cost:.2f} instead of {told.cost_alone:.2f} with the tank left to the device, on "
        f"one of ten days {told.below_Kh:.1f} instead of {told.below_alone_Kh:.1f} K·h below what is wanted"
    )


class TankCourse(NamedTuple):
    """K courses of a tank on S days over N steps, (K, S, N): °C at their end, lowest °C, Wh, share of charging.

    `is_charged` (K, S): at the end of all.
    """

    T_C: Array
    lowest_C: Array
    Wh: Array
    share: Array
    is_charged: NDArray[np.bool_]


def follow_tank(
    tank: LearnedTank,
    T_C: float,
    is_charged: bool,
    target_C: Array,
    at_once: NDArray[np.bool_],
    draws_K: Array,
    T_out_C: Array,
    step_s: float,
) -> TankCourse:
    """What the device makes of K commands on S days: it charges where the tank falls below its target by its band.

    `target_C` (K, N), and where it begins `at_once`, without its band (K, N); `draws_K` (S, N); `T_out_C` (N,).
    """
    shape = (len(target_C), len(draws_K), target_C.shape[1])
    empty = [np.empty(shape) for _ in range(4)]
    course = TankCourse(empty[0], empty[1], empty[2], empty[3], np.empty(shape[:2], dtype=np.bool_))
    T_out_C = np.ascontiguousarray(T_out_C)
    device = _Device(
        tank.rise_at(T_out_C), tank.energy, T_out_C - tank.T_out_mean_C, float(tank.loss_1_h), float(tank.band_K)
    )
    target_C = np.ascontiguousarray(target_C, dtype=np.float64)
    draws_K = np.ascontiguousarray(draws_K)
    _follow(course, float(T_C), bool(is_charged), target_C, at_once, draws_K, device, step_s / HOUR_S)
    return course


class _Device(NamedTuple):
    """A tank and what heats it over N steps: `rise_K_h`, and `outdoors_K` above the mean of the record (N,)."""

    rise_K_h: Array
    energy: Array
    outdoors_K: Array
    loss_1_h: float
    band_K: float


@njit(cache=True)
def _follow(
    course: TankCourse,
    now_C: float,
    is_charged: bool,
    target_C: np.ndarray,
    at_once: np.ndarray,
    draws_K: np.ndarray,
    device: _Device,
    step_h: float,
) -> None:
    """Fill the course of `follow_tank`."""
    K, S, N = course.T_C.shape
    dt_h = step_h / _PARTS
    for i in range(K):
        for s in range(S):
            T, on = now_C, is_charged
            for k in range(N):
                target = target_C[i, k]
                begins = target if at_once[i, k] else target - device.band_K
                lowest, used, charged = T, 0.0, 0.0
                rise_K_h = device.rise_K_h[k]
                for _ in range(_PARTS):
                    on = (on and target > T) or begins > T
                    T -= draws_K[s, k] / _PARTS + device.loss_1_h * (T - CELLAR_C) * dt_h
                    if on and target > T:
                        gained = min(target - T, rise_K_h * dt_h)
                        used += gained * _Wh_per_K_compiled(device.energy, T + 0.5 * gained, device.outdoors_K[k])
                        charged += gained / (rise_K_h * step_h)
                        T += gained
                    lowest = min(lowest, T)
                course.T_C[i, s, k], course.lowest_C[i, s, k] = T, lowest
                course.Wh[i, s, k], course.share[i, s, k] = used, charged
            course.is_charged[i, s] = on and target_C[i, N - 1] > T


def learn_tank(record: TankRecord, command: Command | None, machine: str, where: str) -> LearnedTank:
    """What `record` tells of a tank that `machine` heats; `where`: of what in messages.

    Raises:
        DataError: it is too short, holds too few charges, or does not tell what one takes; says why.
    """
    charging = record.charges()
    days = float(np.isfinite(charging).sum() * record.step_s / DAY_S)
    if days < _LEAST_DAYS:
        raise DataError(f"{where}: {days:.1f} days of its temperature were measured, need {_LEAST_DAYS}")
    charges = _Charges.of(record, charging)
    if charges.rise_K.size < _LEAST_CHARGES:
        raise DataError(
            f"{where}: {charges.rise_K.size} charges of {_LEAST_RISE_K:g} K and more were measured from begin to end, "
            f"need {_LEAST_CHARGES}: a longer record, rows more often than {record.step_s / 60.0:g} min, or another "
            "sensor"
        )
    lasts_s = float(np.median(charges.hours)) * HOUR_S
    if record.power_every_s > _MOST_APART * lasts_s:
        raise DataError(
            f"{where}: the power of its machine is read every {record.power_every_s / 60.0:.0f} min and a charge lasts "
            f"{lasts_s / 60.0:.0f}: what one takes cannot be told; log the power more often"
        )
    loss, loss_sd = _standing(record, charging)
    over_K = charges.T_C - CELLAR_C
    rises, T_out_C = charges.rise_K / charges.hours + loss * over_K, float(np.mean(charges.T_out_C))
    rise = _rise(rises, charges.T_out_C - T_out_C)
    machine_K = (rise[0] + rise[1] * (charges.T_out_C - T_out_C)) * charges.hours
    draws_K = _draws(record, charging, charges, machine_K, loss)
    energy, energy_sd = _energy(replace(charges, rise_K=machine_K), T_out_C, where)
    ends = _Ends.of(record, charges, command)
    if ends.scatter_K > _MOST_BAND_SD_K:
        raise DataError(
            f"{where}: charges begin {ends.scatter_K:.1f} K (standard deviation) apart where the target says the same: "
            "something else begins them (a programme of the device, people); let the device charge by its target alone"
        )
    n = charges.rise_K.size
    rise_sd = float(np.std(rises) / np.sqrt(n))
    return LearnedTank(
        machine=machine,
        command=command,
        energy=energy,
        energy_sd=float(np.hypot(energy_sd, energy[0] * rise_sd / rise[0])),
        T_out_mean_C=T_out_C,
        rise=rise,
        rise_sd=rise_sd,
        loss_1_h=loss,
        loss_sd=loss_sd,
        draws_K=draws_K,
        usual_C=ends.usual_C,
        band_K=ends.band_K,
        band_sd=ends.scatter_K / np.sqrt(n),
        charges=n,
        days=days,
        charge_kWh=float(np.mean(charges.Wh)) / 1000.0,
    )


@dataclass(frozen=True, eq=False)
class _Charges:
    """Charges that were measured whole (n,): first step, temperatures, rise, duration, energy, mean temperatures."""

    first: NDArray[np.intp]
    begin_C: Array
    end_C: Array
    rise_K: Array
    hours: Array
    Wh: Array
    T_C: Array
    T_out_C: Array

    @classmethod
    def of(cls, record: TankRecord, charging: Array) -> _Charges:
        T, P, step_h = record.T_C, record.power_W, record.step_s / HOUR_S
        rows = []
        for first, stop in stretches(np.nan_to_num(charging) > 0.0):
            around = slice(max(first - 1, 0), min(stop + 1, P.size))
            if first == 0 or stop == P.size or not np.isfinite(charging[around]).all():
                continue
            share, rise_K = charging[first:stop], float(T[stop] - T[first])
            if not rise_K >= _LEAST_RISE_K or not np.isfinite(T[first : stop + 1]).all():
                continue
            # What the machine took for the rooms in the rest of the first and the last step: as in those beside.
            beside = np.array([P[first - 1], P[stop]])
            rooms_W = float(np.mean(beside[np.isfinite(beside)])) if np.isfinite(beside).any() else 0.0
            Wh = float(np.sum(P[first:stop] - (1.0 - share) * rooms_W)) * step_h
            hours = float(share.sum()) * step_h
            middle_C = float(T[first : stop + 1].mean())
            T_out_C = float(np.mean(record.T_out_C[first : stop + 1]))
            rows.append((first, T[first], T[stop], rise_K, hours, Wh, middle_C, T_out_C))
        table = np.array(rows, dtype=np.float64).reshape(-1, 8)
        table = table[table[:, 4] > 0.0]
        return cls(table[:, 0].astype(np.intp), *table[:, 1:].T)


def _rise(rises_K_h: Array, T_out_K: Array) -> Array:
    """Rise of the machine, K/h, and its slope by outdoor temperatures (n,) about their mean, K/h/K."""
    slope = float(T_out_K @ rises_K_h) / max(float(T_out_K @ T_out_K), 1e-9) if np.std(T_out_K) > 1.0 else 0.0
    slope = float(np.clip(slope, 0.0, _MOST_SLOPE * float(np.median(rises_K_h))))
    return np.array([np.quantile(rises_K_h - slope * T_out_K, _FASTER), slope])


def _energy(charges: _Charges, T_out_C: float, where: str) -> tuple[Array, float]:
    """The law of the energy of a kelvin, (3,) Wh/K about `T_out_C`, and the standard error of its mean."""
    known = np.isfinite(charges.Wh) & np.isfinite(charges.T_out_C)
    rise, Wh = charges.rise_K[known], charges.Wh[known]
    if known.sum() < _LEAST_CHARGES:
        raise DataError(
            f"{where}: power of its machine and outdoor temperature were measured in {int(known.sum())} charges, need "
            f"{_LEAST_CHARGES}: name the power of the machine in the map"
        )
    each = Wh / rise
    mean = float(Wh.sum() / rise.sum())
    spread = float(np.std(each)) if mean > 0.0 else np.inf
    error = spread / np.sqrt(known.sum())
    if not mean > 0.0 or error > _MOST_ERROR * mean:
        raise DataError(
            f"{where}: a kelvin took {mean:.0f} ± {NORMAL_95 * error:.0f} Wh by the meter of its machine: the record "
            "does not tell what a charge costs. Is it the meter of the machine that heats the tank, and is the time "
            "right?"
        )
    x = np.column_stack([np.ones(rise.size), charges.T_C[known] - _MIDDLE_C, charges.T_out_C[known] - T_out_C])
    prior = mean * np.array([1.0, _PER_K, -_PER_K])
    weight = np.array([1e-12, 1.0 / (mean * _PER_K_SD) ** 2, 1.0 / (mean * _PER_K_SD) ** 2])
    noise = max(spread, 1e-3 * mean) ** 2
    found = np.linalg.solve(x.T @ x / noise + np.diag(weight), x.T @ each / noise + weight * prior)
    found[1], found[2] = max(found[1], 0.0), min(found[2], 0.0)
    return np.asarray(found), float(error)


def _standing(record: TankRecord, charging: Array) -> tuple[float, float]:
    """Standing loss, 1/h, and its standard error by days: a low quantile of what falls where nothing is charged.

    Of too few days nothing but the most is known: hours of one day err together.
    """
    n = steps_in(_STILL_H * HOUR_S, record.step_s)
    first = np.arange(0, record.T_C.size - n, max(1, n // 4))
    still = np.array([bool((charging[k : k + n] == 0.0).all()) for k in first])
    first = first[still]
    falls = record.T_C[first] - record.T_C[first + n]
    over = np.maximum(record.T_C[first] - CELLAR_C, 1.0)
    each, day = falls / over / (n * record.step_s / HOUR_S), np.floor(record.time_s[first] / DAY_S)
    each, day = each[np.isfinite(each)], day[np.isfinite(each)]
    of_days = [each[day == one] for one in np.unique(day)]
    if len(of_days) < _LEAST_DAYS:
        return 0.0, _MOST_LOSS
    rng = np.random.default_rng(0)
    drawn = [
        np.quantile(np.concatenate([of_days[i] for i in rng.integers(len(of_days), size=len(of_days))]), _STILL)
        for _ in range(50)
    ]
    return float(np.clip(np.quantile(each, _STILL), 0.0, _MOST_LOSS)), float(np.std(drawn))


def _draws(record: TankRecord, charging: Array, charges: _Charges, machine_K: Array, loss_1_h: float) -> Array:
    """What was drawn by day and hour of the clock (days, 24), K; what was not seen is as usual in that hour.

    Beside a charge it is what falls beyond the standing loss, in one what its rise lacks of that of the machine
    (`machine_K`, of each charge).
    """
    T, step_h = record.T_C, record.step_s / HOUR_S
    place = np.floor(record.clock_s[:-1] / HOUR_S + 1e-6).astype(np.intp)
    place -= 24 * (place[0] // 24)
    n = 24 * (int(place[-1]) // 24 + 1)
    fell = T[:-1] - T[1:] - loss_1_h * (T[:-1] - CELLAR_C) * step_h
    seen = (charging == 0.0) & np.isfinite(fell)
    total = np.bincount(place[seen], fell[seen], minlength=n)
    share = np.bincount(place[seen], minlength=n) * step_h
    lost_K = loss_1_h * (charges.T_C - CELLAR_C) * charges.hours
    total += np.bincount(place[charges.first], machine_K - lost_K - charges.rise_K, minlength=n)
    share += np.bincount(place[charges.first], charges.hours, minlength=n)
    total, share = total.reshape(-1, 24), share.reshape(-1, 24)
    usual = np.maximum(total.sum(axis=0) / np.maximum(share.sum(axis=0), 1e-9), 0.0)
    draws = total + np.maximum(1.0 - share, 0.0) * usual
    whole = (share > 0.0).sum(axis=1) >= _LEAST_HOURS
    return np.asarray(draws[whole] if whole.any() else usual[None])


@dataclass(frozen=True, eq=False)
class _Ends:
    """Where charges begin and end: the device's target by hour of the clock (24,), °C, its band, and the scatter, K."""

    usual_C: Array
    band_K: float
    scatter_K: float

    @classmethod
    def of(cls, record: TankRecord, charges: _Charges, command: Command | None) -> _Ends:
        begins, ends = charges.begin_C, charges.end_C
        told, own = record.command, record.command if record.usual is None else record.usual
        if isinstance(command, TankTarget) and np.isfinite(told).any() and np.isfinite(own).any():
            hour = whole_hour(record.clock_s)
            usual = np.full(24, np.nan)
            for h in range(24):
                values = own[(hour == h) & np.isfinite(own)]
                usual[h] = np.median(values) if values.size else np.nan
            usual[np.isnan(usual)] = np.nanmedian(own)
            # A charge that begins with a new target tells of that, not of the band.
            before = told[np.maximum(charges.first - 1, 0)]
            same = np.isfinite(told[charges.first]) & (np.abs(told[charges.first] - before) < 1e-6)
            bands = (told[charges.first] - begins)[same]
            if bands.size:
                return cls(usual, float(np.clip(np.median(bands), 0.0, 20.0)), _robust_sd(bands))
        # Without its target, where its charges end; those that are told to charge begin earlier.
        by_itself = np.ones(begins.size, dtype=bool)
        if isinstance(command, TankCharge):
            by_itself = ~(np.nan_to_num(told[charges.first]) > 0.0)
        by_itself = by_itself if by_itself.any() else np.ones(begins.size, dtype=bool)
        target = float(np.median(ends))
        bands = target - begins[by_itself]
        return cls(np.full(24, target), float(np.clip(np.median(bands), 0.0, 20.0)), _robust_sd(bands))


def _robust_sd(values: Array) -> float:
    low, high = np.quantile(values, (0.25, 0.75))
    return float(high - low) / 1.349
