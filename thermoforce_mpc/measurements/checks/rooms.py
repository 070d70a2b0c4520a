"""Whether rooms, and what is set in them, are those of the map.

| compared | as it should be | else |
|---|---|---|
| the warming of a room, and the levels of all | its own warms it | two rooms swapped: each is warmed by the other's |
| room temperatures, and set-points of all rooms | near its own | two rooms swapped |
| the values of a command | in steps of its resolution | a measured temperature taken for a set-point |
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from thermoforce_mpc.commands.command import StepwiseCommand
from thermoforce_mpc.commands.kinds import AnyCommand
from thermoforce_mpc.commands.loop import CommandRecord
from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.measurements.checks.common import Remark, fitted

# Standard deviations by which the other room's level warms a room, and its own at most.
_WARMS, _LEAST_ROWS = 5.0, 96
# Rooms are nearer to one another's set-points than to their own by so much, K, both together, and as near as this each.
_NEARER_K, _NEAR_K = 2.0, 1.5
# A command between two of its steps by this share of one is none; in so many of its readings, of so many values.
_BESIDE, _MOST_BESIDE, _VALUES = 0.1, 0.3, 6
# As near to a room's temperature it is that, K.
_SAME_K = 0.3


def room_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Pairs of rooms of which each is warmed by the other's level, and not by its own."""
    own = {layout.home[a]: a for a in range(len(layout.home)) if layout.home.count(layout.home[a]) == 1}
    if len(own) < 2:
        return []
    sure = {zone: _warmed_by(record, layout, zone, list(own.values())) for zone in own}
    found = []
    for one, other in combinations(own, 2):
        mine = max(sure[one][own[one]], sure[other][own[other]])
        crossed = min(sure[one][own[other]], sure[other][own[one]])
        if crossed > _WARMS and crossed > 2.0 * max(mine, 0.0):
            names = f"{record.names.zones[one]} and {record.names.zones[other]}"
            found.append(
                Remark(
                    "rooms swapped", names, "each is warmed by the level of the other, and not by its own",
                    "exchange their columns of temperature, or those of their levels, in the map", crossed,
                    (own[one], own[other]),
                )
            )  # fmt: skip
    return found


def _warmed_by(record: Record, layout: Layout, zone: int, actuators: list[int]) -> dict[int, float]:
    """How many standard deviations say that each level warms (or cools, by its sign) a zone within two steps."""
    T = record.T_zone_C[zone]
    k = np.arange(2, record.n_steps - 2)
    levels = [layout.signs[a] * 0.5 * (record.u[a][k] + record.u[a][k + 1]) for a in actuators]
    columns = np.array(
        [np.ones(k.size), T[k], T[k] - T[k - 2], record.T_out_C[k], record.solar_W_m2[k], *levels]
    ).T  # fmt: skip
    change = T[k + 2] - T[k]
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(change)
    none = dict.fromkeys(actuators, 0.0)
    if rows.sum() < _LEAST_ROWS:
        return none
    beta, covariance, _ = fitted(columns[rows], change[rows])
    sd = np.sqrt(np.maximum(np.diag(covariance)[-len(actuators) :], 1e-18))
    moved = np.ptp(columns[rows][:, -len(actuators) :], axis=0) > 0.0
    return {
        a: float(b / s) if m else 0.0 for a, b, s, m in zip(actuators, beta[-len(actuators) :], sd, moved, strict=True)
    }


def command_remarks(
    record: Record, layout: Layout, set_to: Mapping[str, CommandRecord], commands: Mapping[str, AnyCommand]
) -> list[Remark]:
    """Commands that are none, and rooms near one another's set-points; `set_to` and `commands` by actuator."""
    found: list[Remark] = []
    of_rooms: dict[int, tuple[str, Array]] = {}
    for a, name in enumerate(layout.names.actuators):
        command = commands.get(name)
        if command is None or name not in set_to:
            continue
        if (remark := _no_command(record, layout, name, command, set_to[name].at)) is not None:
            found.append(remark)
        elif command.of_zone == -1.0 and command.reference_of(home := layout.names.zones[layout.home[a]]) == home:
            of_rooms.setdefault(layout.home[a], (name, set_to[name].at))
    for one, other in combinations(of_rooms, 2):
        straight = [_apart_K(record, zone, of_rooms[zone][1]) for zone in (one, other)]
        crossed = [_apart_K(record, one, of_rooms[other][1]), _apart_K(record, other, of_rooms[one][1])]
        if sum(straight) - sum(crossed) > _NEARER_K and max(crossed) < _NEAR_K:
            names = f"{record.names.zones[one]} and {record.names.zones[other]}"
            found.append(
                Remark(
                    "rooms swapped",
                    names,
                    f"they are {straight[0]:.1f} and {straight[1]:.1f} K from their own set-points, {crossed[0]:.1f} "
                    f"and {crossed[1]:.1f} K from one another's",
                    "exchange their columns of temperature, or those of their set-points, in the map",
                )
            )
    return found


def _apart_K(record: Record, zone: int, setpoint_C: Array) -> float:
    apart = np.abs(record.T_zone_C[zone] - setpoint_C)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) if known.size else float("nan")


def _no_command(record: Record, layout: Layout, name: str, command: AnyCommand, at: Array) -> Remark | None:
    """A remark where the values of a command lie between its steps, as those of a sensor do."""
    known = at[np.isfinite(at)]
    if not isinstance(command, StepwiseCommand) or not known.size:
        return None
    steps = command.as_told(known) / command.resolution
    beside = np.abs(steps - np.round(steps)) > _BESIDE
    values = np.unique(np.round(known[beside], 3)).size
    if beside.mean() <= _MOST_BESIDE or values < min(_VALUES, known.size):
        return None
    near = [zone for z, zone in enumerate(record.names.zones) if _apart_K(record, z, at) < _SAME_K]
    what = f"as the temperature of {near[0]} has" if near else "as a sensor has"
    return Remark(
        "command is no command",
        f"command of {name} (column {command.column})",
        f"{values} values between its steps of {command.resolution:g} {command.told_in}, {what}".replace("  ", " "),
        "name the column that says what was set, or set resolution",
    )
