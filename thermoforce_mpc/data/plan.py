"""Output of a controller: what to apply, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data.clock import Array
from thermoforce_mpc.data.names import SINGLE, Names, of_each
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.errors import DataError

if TYPE_CHECKING:  # loaded only where tables go out
    import pandas as pd

NOT_ECONOMICAL = "cannot be avoided economically"
"""What a plan says of discomfort that it accepts though heat could avoid it."""
UNDECIDED = "undecided"
"""First word of `Plan.solver_status`, before a colon and the error, where a controller has no answer to one."""

# Arrays of a `Plan` over its horizon.
_PLANNED = ("u", "T_free_C", "T_forced_K", "T_free_low_C", "T_free_high_C", "slack_K", "power_W", "lower_C", "upper_C")

Levels = float | None | Sequence[float | None]
"""Levels of the actuators: one each, or a number for one actuator; None for native control (of all, if alone)."""

CommandValue = float | tuple[float, float]
"""What a building's own control is told: a number in the unit of its command, or room set-points (heating, cooling)."""

Commands = Sequence[Any] | None
"""Commands of the actuators, one each; one actuator's alone, a pair or in a sequence of one."""


@dataclass(frozen=True)
class HeldCommand:
    """A command from `start_s` to `end_s`, s on the clock of its plan; `value` None: what acts is left to itself."""

    start_s: float
    end_s: float
    value: float | None


@dataclass(frozen=True)
class PlannedSaving:
    """What a plan saves against the building left alone, by the same model, over the horizon.

    `saved`: currency, with its 90 % band `low` to `high` and what is stored at the end; `cost` and `energy_kWh` of the
    plan and `alone`; `outside_Kh`: K·h outside the comfort bounds in all zones. `gain`: `saved` with what differences
    in comfort, and in power above a cap, count in the plan. `peak`: what of `cost` is for power above the highest so
    far.
    """

    saved: float
    low: float
    high: float
    cost: float
    cost_alone: float
    energy_kWh: float
    energy_alone_kWh: float
    outside_Kh: float
    outside_alone_Kh: float
    gain: float
    peak: float = 0.0
    peak_alone: float = 0.0

    @property
    def stored(self) -> float:
        """What is stored at the end more than left alone is worth, currency; it is in `saved`."""
        return self.saved - (self.cost_alone - self.cost)


@dataclass(frozen=True, eq=False)
class HotWaterPlan:
    """What is set at a tank of hot water over N steps, and what is expected of it.

    `command` (N,): in the unit of its command, None where the device is left to itself. At the end of each step (N,)
    its mean `T_C` and `low_C`, below which it is on one of ten days; the lowest that is wanted, `lower_C`; over each
    step the `share` that its machine charges it, and mean electric `power_W`. `cost` and `below_Kh` (below what is
    wanted, on one of ten days) over the horizon, with those of the tank left `alone`; `solves`: plans of the rooms that
    were made for it; `gap`: what tank and rooms cost more than the cheapest tank and rooms with the whole machine;
    `T_now_C`: the temperature that it begins with.
    """

    command: tuple[float | None, ...]
    T_C: Array
    low_C: Array
    lower_C: Array
    share: Array
    power_W: Array
    cost: float
    cost_alone: float
    below_Kh: float
    below_alone_Kh: float
    solves: int = 0
    gap: float = 0.0
    T_now_C: float = float("nan")


@dataclass(frozen=True, init=False)
class Block:
    """One stretch of constant actuation: `u` (A,) holds the level of each actuator in [0, 1], None for native control.

    Levels of an actuator that heats and cools lie in [−1, 1]. `command` (A,): what the building's own loops are told
    meanwhile, None where the level itself is set: a number in the unit of the command, or the heating and the cooling
    set-point of a room, °C; u is then the mean level that the plan expects of them. One actuator's level and command
    may be given without a tuple.
    """

    u: tuple[float | None, ...]
    duration_s: float
    command: tuple[CommandValue | None, ...]

    def __init__(self, u: Levels, duration_s: float, command: Commands = None) -> None:
        levels: tuple[Any, ...] = tuple(u) if isinstance(u, Sequence) and not isinstance(u, str) else (u,)
        commands = tuple(map(_as_told, commands_of_each(command, len(levels))))
        if len(commands) != len(levels):
            raise DataError(f"a block of {len(levels)} levels has {len(commands)} commands")
        object.__setattr__(self, "u", tuple(map(_as_level, levels)))
        object.__setattr__(self, "duration_s", _as_number(duration_s, "duration_s"))
        object.__setattr__(self, "command", commands)

    @classmethod
    def native(cls, n_actuators: int, duration_s: float) -> Block:
        """All actuators under the plant's own control."""
        return cls((None,) * n_actuators, duration_s)

    @property
    def told(self) -> tuple[CommandValue | None, ...]:
        """What is set at each actuator (A,): its command, where it has one, else its level; None: native control."""
        pairs = zip(self.u, self.command, strict=True)
        return tuple(level if level is None or command is None else command for level, command in pairs)

    def as_array(self) -> Array:
        """Levels (A,), NaN under native control."""
        return np.array([np.nan if level is None else level for level in self.u])


def _as_level(value: Any) -> float | None:
    return None if value is None else _as_number(value, "a level (u)")


def _as_number(value: Any, what: str) -> float:
    """A number; raises `DataError` for what is none."""
    try:
        if not isinstance(value, str):
            return float(value)
    except (TypeError, ValueError):
        pass
    raise DataError(f"block: {what} is {value!r:.60}, expected a number (None as a level: left to itself)")


def _as_told(value: Any) -> Any:
    """A command as `CommandValue`; what is none stays, for the check before the plant."""
    if isinstance(value, int | float | np.integer | np.floating | np.bool_):
        return float(value)
    if isinstance(value, tuple | list | np.ndarray) and np.shape(value) == (2,):
        return tuple(map(_as_told, value))
    return value


def commands_of_each(command: Commands, n: int) -> tuple[Any, ...]:
    """Commands as a tuple, one for each of `n` actuators, where as many were given; a pair for one actuator is one."""
    if command is None:
        return (None,) * n
    if n == 1 and len(command) == 2:
        return (tuple(command),)
    return tuple(command)


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


# What acts where a plan may not: the plant's own control, or the on/off rule in its place.
_NOT_FOLLOWED = (PlanStatus.GATE, PlanStatus.WATCH, PlanStatus.NATIVE, PlanStatus.THERMOSTAT)


@dataclass(frozen=True)
class Plan:
    """A decision and its reason.

    `blocks` is what to apply until the next plan. The arrays describe the horizon of N steps: planned `u` (A, N),
    predicted `T_free_C` and `T_forced_K` at the end of each step and comfort `slack_K` (violation allowed for) (Z, N),
    and predicted `power_W` (M, N); they are empty for rules. `time_s` (N,) is the start of each step, counted from
    `origin` where the record has time stamps. `T_free_now_C` (Z,) is the control-free temperature the plan starts from;
    `lower_C` and `upper_C` (Z, N) are the comfort bounds with the margins that it kept inside them. `margins` of the
    first step by name: K inside the lower and the upper bound of each zone (2, Z); `offset` (Z,), K, is added to the
    prediction, `unused_capacity` (M,) the share of each machine that is not planned for. `settings` (A,): the commands
    of each actuator over the horizon, none where its level is set; () where none has a command; `saving`: what they
    save. `acting` (A,): source of the action of each actuator; `status` is that of the plan, or of what took its place
    at one of them. `why` is one sentence for people; `news` (part of it) what was learned in this step of sensors,
    meters or the model; `solver_status` is the solver's, `variables` how many its programme had,
    `parameters` how many of the operator's, `own` the values of your own variables by name
    (`controller.options.terms`). `state` goes to the controller's next plan of this run and is opaque to others.
    `hot_water`: what is set at the tank of its machine; None without one.
    `ends`: why the run ends with this plan, of which nothing is applied; '' where it goes on.
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
    news: str = ""
    solver_status: str = ""
    iterations: int = 0
    variables: int = 0
    parameters: int = 0
    own: Mapping[str, Array] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    margins: Mapping[str, Array] = field(default_factory=dict)
    names: Names = SINGLE
    acting: tuple[PlanStatus, ...] = ()
    lower_C: Array = field(default_factory=lambda: np.empty(0))
    upper_C: Array = field(default_factory=lambda: np.empty(0))
    settings: tuple[tuple[HeldCommand, ...], ...] = ()
    saving: PlannedSaving | None = None
    hot_water: HotWaterPlan | None = None
    state: object = field(default=None, repr=False)
    ends: str = ""

    def __post_init__(self) -> None:
        if self.status not in list(PlanStatus):
            raise DataError(f"plan: status is {self.status!r}, expected one of {', '.join(PlanStatus)}")
        object.__setattr__(self, "status", PlanStatus(self.status))
        if not self.acting:
            object.__setattr__(self, "acting", (self.status,) * len(self.names.actuators))
        for name in _PLANNED:
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if not values.size:
                values = np.empty((self.names.rows(name), 0))
            object.__setattr__(self, name, values[None] if values.ndim == 1 else values)
        now = self.T_free_now_C if np.size(self.T_free_now_C) else np.full(len(self.names.zones), np.nan)
        object.__setattr__(self, "T_free_now_C", of_each(now, "T_free_now_C", self.names))

    @property
    def T_zone_C(self) -> Array:
        """Predicted zone temperatures at the end of each step, free plus forced (paper eq:compose), (Z, N), °C."""
        return compose(self.T_free_C, self.T_forced_K)

    @property
    def followed(self) -> NDArray[np.bool_]:
        """Whether each actuator is left to the plan (A,): its own control or a rule acts where a model may not."""
        return np.array([status not in _NOT_FOLLOWED for status in self.acting])

    @property
    def u_to_set(self) -> Array:
        """Levels to set (A, N): `u`, NaN for actuators that are not left to the plan."""
        return np.where(self.followed[:, None], self.u, np.nan)

    def with_news(self, *news: str) -> Plan:
        """The plan that also says what was learned in its step; empty texts say nothing."""
        text = "; ".join(filter(None, news))
        if not text:
            return self
        return replace(self, news="; ".join(filter(None, (text, self.news))), why=f"{text}; {self.why}")

    def to_dataframe(self) -> pd.DataFrame:
        """The planned horizon, one row per step at its start; no rows where nothing was solved.

        Columns: `u`, NaN where it is not to be set (`u_to_set`), and mean electric `power_W` over the step; at its end
        `T_zone_C`, the 80 % band `T_low_C` to `T_high_C` of the free response, `T_free_C`, `T_forced_K` and the comfort
        violation `slack_K`. With several zones, actuators or machines, one of each per name: `T_zone_C[bath]`.
        """
        from thermoforce_mpc.data.dataframes import table

        columns = self.names.columns(
            u=self.u_to_set,
            power_W=self.power_W,
            T_zone_C=self.T_zone_C,
            T_low_C=compose(self.T_free_low_C, self.T_forced_K),
            T_high_C=compose(self.T_free_high_C, self.T_forced_K),
            T_free_C=self.T_free_C,
            T_forced_K=self.T_forced_K,
            slack_K=self.slack_K,
        )
        return table(self.time_s, self.origin, **columns)
