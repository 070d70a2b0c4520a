"""Input checks shared by all simulated plants, with common messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from thermoforce_mpc.data import (
    DAY_S,
    SINGLE,
    YEAR_S,
    Array,
    Block,
    Commands,
    CommandValue,
    Levels,
    Names,
    Period,
    commands_of_each,
)
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import plain_number
from thermoforce_mpc.scenario.actuator import Actuator, RoomSetpoints


def day_period(name: str, named: Iterable[str]) -> Period:
    """Return two weeks from start day `name`; raises `InputError`, with the windows `named`, for anything else."""
    if not is_day(name):
        raise InputError(f"period '{name}': expected {', '.join(named) or 'nothing else'} or a start day")
    day = float(name)
    if not 0.0 <= day < 365.0:
        raise InputError(f"period '{name}': a start day lies between 0 and 365")
    return Period(f"day {day:g}", day * DAY_S)


def is_day(name: str) -> bool:
    """Whether the name of a window is a number: its start day."""
    try:
        plain_number(name)
    except ValueError:
        return False
    return True


def check_start(start_s: float, warmup_s: float) -> None:
    """Raise `InputError` unless both are finite, nonnegative seconds and the start lies inside the year."""
    for label, value in (("start", start_s), ("warm-up", warmup_s)):
        if not (isinstance(value, int | float) and math.isfinite(value) and value >= 0):
            raise InputError(f"{label} of {value!r} s: expected a finite, nonnegative number of seconds")
    if start_s >= YEAR_S:
        raise InputError(f"start of {start_s:g} s lies beyond the year ({YEAR_S:g} s)")


def check_levels(
    u: Levels,
    duration_s: float,
    command: Commands = None,
    *,
    names: Names = SINGLE,
    u_min: float | Sequence[float] = 0.0,
) -> Block:
    """Return levels and commands as given to a plant, one entry for each of its A actuators.

    Args:
        u: levels (A,), None for the plant's own control; a number for one actuator, None for all.
        duration_s: how long to apply them, s.
        command: of each actuator, a number or a heating and a cooling set-point, °C, see `Block`; None for all.
        names: names of the actuators.
        u_min: lowest level, of all actuators or of each.

    Raises:
        InputError: entries that are not one per actuator, a level not in [`u_min`, 1], a command that is neither a
            finite number nor two rising ones, or a duration that is not positive and less than a year; names the
            actuator.
    """
    n, alone = len(names.actuators), len(names.actuators) == 1
    levels: tuple[Any, ...] = (None,) * n if u is None else (u,) if np.ndim(u) == 0 else tuple(u)  # type: ignore[arg-type]
    commands = commands_of_each(command, n)
    for what, values in (("levels", levels), ("commands", commands)):
        if len(values) != n:
            raise InputError(
                f"{what} of {len(values)} actuators: expected one for each of {', '.join(names.actuators)}"
            )
    each = np.broadcast_to(u_min, n)
    for name, level, least, told in zip(names.actuators, levels, each, commands, strict=True):
        of = "" if alone else f" for '{name}'"
        if level is not None and not (_is_number(level) and least <= level <= 1.0):
            raise InputError(f"level of {level!r}{of}: expected a number from {least:g} to 1, or None")
        if np.shape(told) == (2,):
            if not (all(map(_is_number, told)) and told[0] <= told[1]):
                raise InputError(
                    f"room set-points of {told!r} °C{of}: expected a heating set-point not above the cooling one"
                )
        elif told is not None and not _is_number(told):
            raise InputError(f"command of {told!r}{of}: expected a finite number or two rising set-points, °C")
    if not (_is_number(duration_s) and 0 < duration_s < YEAR_S):
        raise InputError(f"step of {duration_s!r} s: expected a positive number, less than a year")
    return Block(levels, float(duration_s), commands)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and bool(np.isfinite(value))


def plant_inputs(
    actuator: Actuator | RoomSetpoints, u: float | None, command: CommandValue | None, T_zone_C: float
) -> dict[str, float]:
    """Return an actuator's inputs for a level with the room at `T_zone_C` or, for room set-points, the command, °C.

    Raises `InputError` for a command that the actuator does not have, or a level between the limits for a loop without
    set-points.
    """
    pair = command if isinstance(command, tuple) else None
    if command is not None and pair is None:
        raise InputError(f"command of {command!r}: the actuator takes levels or room set-points")
    if isinstance(actuator, RoomSetpoints):
        if pair is None and u is not None and u not in (-1.0, 0.0, 1.0) and u != actuator.u_min:
            raise InputError(f"level of {u:g} without room set-points: a loop can only be driven to its limits")
        return actuator.inputs(u, pair)
    if pair is not None:
        raise InputError(f"room set-points of {pair!r}: the actuator '{actuator.point}' has none")
    return actuator.inputs(u, T_zone_C)


def forecast_times(now_s: float, horizon_s: float, interval_s: float) -> Array:
    """Return the instants from `now_s` to `horizon_s` ahead every `interval_s`, s, shape (N + 1,).

    Raises `InputError` where horizon or interval is not positive, or the horizon is shorter than the interval.
    """
    if not (math.isfinite(horizon_s) and math.isfinite(interval_s) and 0 < interval_s <= horizon_s):
        raise InputError(f"forecast of {horizon_s!r} s every {interval_s!r} s: expected 0 < interval <= horizon")
    steps = np.arange(math.floor(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
    return np.asarray(now_s + steps * interval_s, dtype=np.float64)


def check_record_step(step_s: float) -> None:
    """Raise `InputError` unless a record can be asked for at steps of `step_s`: finite and positive, s."""
    if not (math.isfinite(step_s) and step_s > 0):
        raise InputError(f"history at {step_s!r} s: expected a positive number of seconds")


def record_times(begin_s: float, now_s: float, step_s: float) -> Array:
    """Return the ends of steps back from `now_s` to `begin_s`, s, shape (n + 1,); raises as `check_record_step`."""
    check_record_step(step_s)
    n = math.floor((now_s - begin_s) / step_s + 1e-9)
    return np.asarray(now_s - np.arange(float(n), -1.0, -1.0) * step_s)
