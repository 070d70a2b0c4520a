"""Whether meter and level go together; where they do not, whether the level is none or the meter holds another load.

A level is what acts: with the outdoor temperature it tells what the machine takes. Where it does not, the rooms tell
why. What the meter shows beside the level and warms the rooms is heating that the level does not know of: the column is
a set-point, or what was asked for. What warms nobody is another load: hot water, or a whole house on the meter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record
from thermoforce_mpc.identification.checks.regression import explained, fitted
from thermoforce_mpc.identification.checks.remark import Remark

# Share of the variance of its power that a machine's levels explain at least, with the outdoor temperature. Part load,
# cycling and water temperatures leave 3 to 9 % (test cases and generated houses), another load or a set-point more.
_LEAST_EXPLAINED = 0.8
# Off is below this level, two steps and more; then a share of full power is no stand-by, and a share of all energy,
# taken at so many times, no chance.
_OFF, _BURST, _LEAST_ENERGY, _LEAST_TIMES = 0.02, 0.15, 0.02, 4
# Standard deviations from which rooms are warmed by what is beside the level.
_WARMS = 5.0
# Without a meter: hours for which a level is held, steps and changes of such, and share of the variance of the zone
# temperature that it explains. Heat makes a room warmer and warmer; a set-point keeps it.
_HELD_H, _HELD_STEPS, _HELD_CHANGES, _KEPT = 3.0, 50, 6, 0.85
_LEAST_ROWS = 96


def level_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Levels that are none, and meters that hold another load."""
    found: list[Remark] = []
    doubted: set[int] = set()
    for m, machine in enumerate(layout.names.machines):
        fed = layout.fed_by(m)
        remark = _of_meter(record, layout, fed, record.power_W[m], f"power of {machine}") if fed else None
        if remark is not None:
            found.append(remark)
            doubted.update(fed)
    for a, actuator in enumerate(layout.names.actuators):
        if a in doubted:
            continue
        if np.isfinite(record.heat_W[a]).any():
            remark = _of_meter(record, layout, [a], np.abs(record.heat_W[a]), f"heat of {actuator}", of_heat=True)
        elif not np.isfinite(record.power_W[layout.machine_of[a]]).any():
            remark = _tracking(record, layout, a)
        else:
            remark = None
        found += [remark] if remark is not None else []
    return found


def _of_meter(
    record: Record, layout: Layout, fed: list[int], meter_W: Array, where: str, *, of_heat: bool = False
) -> Remark | None:
    """A remark on one meter beside the levels of what it feeds; of heat, which lags, while they are off."""
    u = record.u[fed]
    rows = np.isfinite(u).all(axis=0) & np.isfinite(meter_W) & np.isfinite(record.T_out_C[:-1])
    if rows.sum() < _LEAST_ROWS or not (np.ptp(u[:, rows], axis=1) > 0.0).any():
        return None
    T_out = record.T_out_C[:-1]
    columns = np.array([np.ones(rows.sum()), *(c[rows] for row in u for c in (row, np.square(row), row * T_out))]).T
    share, left = explained(columns, meter_W[rows])
    beside = np.full(record.n_steps, np.nan)
    beside[rows] = left
    energy, times = _while_off(u, meter_W, rows)
    at_rest = energy > _LEAST_ENERGY and times >= _LEAST_TIMES
    if not at_rest and (of_heat or share >= _LEAST_EXPLAINED):
        return None
    names = " and ".join(record.names.label("u", a) for a in fed)
    says = f"{names} explain{'s' if len(fed) == 1 else ''} {100 * max(share, 0.0):.0f} % of the {where}"
    if at_rest:
        says += f", {100 * energy:.0f} % of its energy flows while {'it is' if len(fed) == 1 else 'they are'} off"
    warms = _warming(record, layout, fed, beside)
    if warms > _WARMS:
        return Remark(
            "level is no level",
            names,
            f"{says}, and what flows beside warms the room",
            "a set-point, or what was asked for, is no level: name what the machine did (valve, speed, on and off), or "
            "leave the level out, and heat or power over the full one is taken for it",
            warms,
        )
    return Remark(
        "meter holds another load",
        where,
        f"{says}, and what flows beside warms no room",
        "take the other load (hot water, the household) off, meter it apart, or name the standing load as off_W",
        float(np.sqrt(rows.sum() * max(1.0 - share, 0.0))),
    )


def _while_off(u: Array, meter_W: Array, rows: NDArray[np.bool_]) -> tuple[float, int]:
    """Share of the energy beyond stand-by that flows while all levels (k, n) are off, and the number of times."""
    off = rows & (np.abs(np.where(np.isfinite(u), u, 1.0)) < _OFF).all(axis=0)
    resting = off & np.append(False, off[:-1])  # the first step after it was on holds its end
    full_W = float(np.percentile(meter_W[rows], 99.0))
    if resting.sum() < _LEAST_TIMES or full_W <= 0.0:
        return 0.0, 0
    standby_W = float(np.percentile(meter_W[resting], 25.0))
    beyond = np.where(resting, meter_W - standby_W, 0.0)
    taken = beyond > _BURST * (full_W - standby_W)
    total = float(np.clip(meter_W[rows], 0.0, None).sum())
    times = int((np.diff(np.append(0, taken.astype(int))) > 0).sum())
    return float(beyond[taken].sum()) / total if total > 0.0 else 0.0, times


def _warming(record: Record, layout: Layout, fed: list[int], beside_W: Array) -> float:
    """How many standard deviations say that `beside_W` (n,), NaN where not known, warms a room of `fed` in an hour."""
    ahead = max(1, round(HOUR_S / record.step_s))
    k = np.arange(2, record.n_steps - ahead)
    most = 0.0
    for a in fed:
        T = record.T_zone_C[layout.home[a]]
        columns = [np.ones(k.size), T[k], T[k] - T[k - 2], record.T_out_C[k], record.solar_W_m2[k]]
        columns += [record.u[b][k] for b in fed] + [beside_W[k - 1] + beside_W[k]]
        table, target = np.array(columns).T, layout.signs[a] * (T[k + ahead] - T[k])
        rows = np.isfinite(table).all(axis=1) & np.isfinite(target)
        if rows.sum() < _LEAST_ROWS:
            continue
        beta, covariance, _ = fitted(table[rows], target[rows])
        if covariance[-1, -1] > 0.0:
            most = max(most, float(beta[-1] / np.sqrt(covariance[-1, -1])))
    return most


def _tracking(record: Record, layout: Layout, a: int) -> Remark | None:
    """A remark where the zone keeps to a level, held for hours, as it would to a set-point; nothing is metered."""
    u, T = record.u[a], record.T_zone_C[layout.home[a], 1:]
    hold = max(1, round(_HELD_H * HOUR_S / record.step_s))
    if u.size <= hold:
        return None
    window = np.lib.stride_tricks.sliding_window_view(u, hold + 1)
    held = np.append(np.zeros(hold, dtype=bool), np.ptp(window, axis=1) < 1e-3) & np.isfinite(T)
    levels = u[held]
    changes = int((np.abs(np.diff(levels)) > 1e-3).sum()) if levels.size else 0
    if held.sum() < _HELD_STEPS or changes < _HELD_CHANGES:
        return None
    columns = np.array([np.ones(levels.size), levels]).T
    beta, covariance, _ = fitted(columns, T[held])
    share, _ = explained(columns, T[held])
    if share < _KEPT or beta[1] * layout.signs[a] <= 0.0:
        return None
    return Remark(
        "level is no level",
        record.names.label("u", a),
        f"after {_HELD_H:g} h at one level the zone temperature is {beta[0]:.1f} + {beta[1]:.1f} u °C, "
        f"{100 * share:.0f} % of its variance, whatever the weather",
        "a set-point is no level: name what the machine did (valve, speed, on and off), or its heat or power",
        float(beta[1] / np.sqrt(covariance[1, 1])),
    )
