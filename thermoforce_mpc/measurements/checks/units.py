"""Whether temperatures, heat and power are in their units, by what no building and no machine can do.

| compared | possible | else |
|---|---|---|
| heat over power of its machine | 0.7 (an old boiler) to what a heat pump may reach | Wh per step, kW beside W |
| the same in all weathers | above 1.1, a heat pump, goes with the outdoor temperature, below not | the same |
| heat per floor area and K to outdoors | up to 4 W/m²K | Wh per step beside W |
| full load | 15 W to 300 kW; by floor area 1.5 to 500 W/m² | kW beside W |
| outdoor temperature while heating | mostly below that of the room | °F, or both exchanged |
| most temperatures of a sensor | those of a room, or of weather | K, °C or °F for another |
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, ZERO_C_K, Array, Layout, Record, steps_in
from thermoforce_mpc.data.clock import in_celsius
from thermoforce_mpc.data.limits import LOAD_W_PER_M2, RULES, SignalRule
from thermoforce_mpc.data.series import means_of
from thermoforce_mpc.measurements.checks.common import Remark, fitted

# Heat per energy: least of any heater over a season; share of Carnot's between outdoor air and water of 35 °C that no
# heat pump passes, and no less than 6.5, of one with a borehole.
_LEAST_RATIO, _CARNOT, _WATER_C, _BOREHOLE = 0.7, 0.5, 35.0, 6.5
# A ratio above this is that of a heat pump, whose COP rises by 2 to 3 % a kelvin outdoors (EN 14511 data sheets).
# That of a boiler or an electric heater is steady, and rises by 0.4 % where it condenses (EN 15502): its logarithm
# varies by less than 0.05. What rises by more than any heat pump's is another thing: load, losses, a schedule.
_NO_HEAT_PUMP, _LEAST_SLOPE_PER_K, _MOST_SLOPE_PER_K, _STEADY = 1.1, 0.01, 0.05, 0.05
# A meter of whole kWh tells heat at other times than it came, as in the breaks of a boiler: where so few values of it
# differ (2 to 4 % at .1 and 1 kWh, more than half at 1 Wh), heat and power of a while are compared, s.
_FEW_VALUES, _WHILE_S = 0.1, 4.0 * HOUR_S
# Days whose ratios must agree, and standard deviations of their spread that count: loads that go with the weather are
# errors of all days. Few days say little of the spread; how sure it must make the doubt (Student's t).
_LEAST_DAYS, _CLEAR_OF_DAYS, _SURE = 3, 4.0, 0.995
# Largest heat loss per floor area, W/m²K: houses before any insulation have 3.5 with their ventilation (TABULA).
_MOST_LOSS_W_M2K = 4.0
# Full power or heat, W: a pump takes 15 W, a house without a floor area less than 300 kW.
_LEAST_W, _LEAST_W_M2, _MOST_W = 15.0, 1.5, 3e5
# Share of the heating that may happen while it is as warm outdoors as in the room, less 1 K.
_MOST_WARM_SHARE, _WARM_K, _COLDER_K = 0.3, 1.0, 3.0
_ON, _LEAST_ROWS, _CLEAR = 0.1, 24, 2.0
# Steps in which a machine must have run to tell its size: of a mild day with one short start the largest load but for
# one in a hundred is what idles.
_LEAST_RUNNING = 8
# Without known levels a machine runs where its load goes up and down by this factor.
_UP_AND_DOWN = 10.0


def unit_remarks(record: Record, layout: Layout) -> list[Remark]:
    """Units of temperatures, heat and power that cannot be right, in a record as it was read."""
    rows = [(record.names.label("T_zone_C", z), T, RULES["T_zone_C"]) for z, T in enumerate(record.T_zone_C)]
    found = [one for row in [*rows, ("T_out_C", record.T_out_C, RULES["T_out_C"])] if (one := _of_temperature(*row))]
    outdoors = _of_outdoors(record, layout)
    if outdoors:  # then it tells nothing of losses and machines
        record = replace(record, T_out_C=np.full_like(record.T_out_C, np.nan))
    for m, machine in enumerate(layout.names.machines):
        found += _of_machine(record, layout, m, machine)
    return found + outdoors


def _of_temperature(where: str, values_C: Array, rule: SignalRule) -> Remark | None:
    """Readings (n,) of which most are impossible, and another unit that makes them usual."""
    possible_C, usual_C = rule.range, rule.usual
    known = values_C[np.isfinite(values_C)]
    outside = known[(known < possible_C[0]) | (known > possible_C[1])]
    if 2 * outside.size <= known.size:
        return None
    middle = float(np.median(outside))
    as_K = middle + ZERO_C_K  # what was sent, where K is converted
    for sent, unit, value_C in (
        (as_K, "°C where the protocol says K", as_K),
        (as_K, "°F where the protocol says K", in_celsius(as_K)),
        (middle, "K where °C is expected", middle - ZERO_C_K),
        (middle, "°F where °C is expected", in_celsius(middle)),
    ):
        if usual_C[0] <= value_C <= usual_C[1]:
            words = f"{outside.size} readings of {sent:.4g}: {unit}?"
            remedy = "until the plant gives the unit that is expected (a map: `unit`), they count as not measured"
            return Remark("unit of temperature", where, words, remedy)
    return None


def _running(record: Record, fed: list[int], load_W: Array) -> Array:
    """Load (n,) of a machine while it ran: by its levels, or all of it where they are not known and it goes up and
    down; empty where it hardly ran.
    """
    u = record.u[fed]
    rows = (np.abs(np.nan_to_num(u)) > _ON).any(axis=0)
    if rows.any():
        return load_W[rows] if rows.sum() >= _LEAST_RUNNING else load_W[:0]
    known = load_W[np.isfinite(load_W)]
    moves = not np.isfinite(u).all() and known.size > 0 and _most(known) > _UP_AND_DOWN * np.percentile(known, 5.0)
    return load_W if moves else load_W[:0]


def _of_machine(record: Record, layout: Layout, m: int, machine: str) -> list[Remark]:
    fed = layout.fed_by(m)
    power, heat = record.power_W[m], np.abs(record.heat_W[fed]).sum(axis=0)
    of_heat = " + ".join(record.names.label("heat_W", a) for a in fed)
    found = []
    for what, load in ((record.names.label("power_W", m), power), (of_heat, heat)):
        if size := _size(load, _running(record, fed, load), _area_m2(layout, fed)):
            found.append(Remark("unit of power", what, *size))
    if found or not fed:
        return found
    both = np.isfinite(heat) & np.isfinite(power)
    on = both & (power > _ON * _most(power)) & (heat > _ON * _most(heat))
    if on.sum() >= _LEAST_ROWS and not np.allclose(power[both], heat[both], rtol=1e-6):
        where = f"{of_heat} and {record.names.label('power_W', m)}"
        cools = any(layout.signs[a] < 0 for a in fed) or bool((record.heat_W[fed] < 0.0).any())
        found += _of_ratio(record, heat, power, both, on, where, cools=cools)
    if not found and np.isfinite(heat).any():
        found += _of_loss(record, layout, fed, heat, of_heat)
    return found


def _size(load_W: Array, running_W: Array, area_m2: float) -> tuple[str, str] | None:
    """What is impossible about the size of a load (n,), `running_W` (k,) while its machine ran, and the remedy."""
    full, most = _most(running_W), _most(load_W)
    if full <= 0.0:
        return None
    if full < _LEAST_W or full / area_m2 < _LEAST_W_M2:
        return f"never above {full:.3g} W", "kW is likelier than W: multiply by 1000 (unit: kW)"
    if most / area_m2 > LOAD_W_PER_M2 or (not np.isfinite(area_m2) and most > _MOST_W):
        return f"up to {most:.3g} W", "W is likelier than kW: divide by 1000 (unit: W), or give the floor area"
    return None


def _of_ratio(
    record: Record, heat: Array, power: Array, both: Array, on: Array, where: str, *, cools: bool
) -> list[Remark]:
    """What is wrong with heat over energy; how it goes with the weather tells of machines that only heat: a chiller
    gives two to five units of cold, in any weather or the less the warmer it is.
    """
    ratio = float(heat[both].sum() / power[both].sum())
    T_out = record.T_out_C[:-1]
    warm = _mean(T_out[on])
    possible = max(_BOREHOLE, _CARNOT * (_WATER_C + ZERO_C_K) / max(_WATER_C - warm, 1.0))
    step_h = record.step_s / HOUR_S
    if ratio < _LEAST_RATIO or ratio > possible:
        words = f"no machine gives less than {_LEAST_RATIO:g} or more than {possible:.1f}"
        return [_ratio_remark(ratio, step_h, where, words)]
    if cools or step_h == 1.0:
        return []
    time_s = record.time_s[:-1]
    if np.unique(heat[both].round(1)).size < _FEW_VALUES * both.sum():
        n = steps_in(_WHILE_S, record.step_s)
        heat, power, T_out, time_s = (means_of(one, n) for one in (heat, power, T_out, time_s))
        on = np.asarray((power > _ON * _most(power)) & (heat > _ON * _most(heat)))
    rows = on & np.isfinite(T_out)
    if rows.sum() < _LEAST_ROWS:
        return []
    days = time_s[rows] // DAY_S
    if np.unique(days).size < _LEAST_DAYS:
        return []
    # At equal temperatures and loads: mild days are those of part load, which has a ratio of its own.
    by_weather = np.array([np.ones(rows.sum()), T_out[rows]]).T
    at_load = np.column_stack([by_weather, heat[rows] / _most(heat[rows])])
    target = np.log(heat[rows] / power[rows])
    slope, margin, residual = _slope(at_load, target, days)
    if ratio <= _NO_HEAT_PUMP:
        rises = slope - margin > _LEAST_SLOPE_PER_K and slope < _MOST_SLOPE_PER_K
        wrong = rises and _NO_HEAT_PUMP < ratio / step_h < possible
        words = "as of a boiler, and yet it rises with the outdoor temperature as that of a heat pump does"
    else:
        # A machine of constant power gives heat that goes with the weather, and a ratio that goes with the heat.
        whole, of_whole, _ = _slope(by_weather, target, days)
        steady = residual.std() <= _STEADY and max(slope + margin, whole + of_whole) < _LEAST_SLOPE_PER_K
        wrong = steady and _LEAST_RATIO <= ratio * step_h <= _NO_HEAT_PUMP
        words = "too much for a boiler, and it does not go with the outdoor temperature as that of a heat pump does"
    return [_ratio_remark(ratio, step_h, where, words)] if wrong else []


def _slope(columns: Array, target: Array, days: Array) -> tuple[float, float, Array]:
    """The second coefficient of `columns` (n, k), what it may be off, and the residuals (n,); `days` (n,): of rows."""
    from scipy.special import stdtrit

    beta, covariance, residual = fitted(columns, target)
    clear = max(_CLEAR_OF_DAYS, float(stdtrit(np.unique(days).size - 1, _SURE)))
    margin = max(_CLEAR * float(np.sqrt(covariance[1, 1])), clear * _sd_of_days(columns, residual, days))
    return float(beta[1]), margin, residual


def _sd_of_days(columns: Array, residual: Array, days: Array) -> float:
    """Standard deviation of the second coefficient by the spread from day to day (n,): errors of a day are one."""
    scores, each = columns * residual[:, None], np.unique(days)
    of_days = np.stack([scores[days == day].sum(axis=0) for day in each])
    inverse = np.linalg.pinv(columns.T @ columns)
    variance = (inverse @ of_days.T @ of_days @ inverse)[1, 1] * each.size / (each.size - 1)
    return float(np.sqrt(variance))


def _ratio_remark(ratio: float, step_h: float, where: str, why: str) -> Remark:
    factors = {"Wh per step": step_h, "kW": 1e-3} if ratio > 1.0 else {"Wh per step": 1.0 / step_h, "kW": 1e3}
    fits = {unit: factor for unit, factor in factors.items() if _LEAST_RATIO <= ratio * factor <= _BOREHOLE}
    unit = next(iter(fits), "Wh per step")
    factor = max(fits.get(unit, step_h), 1.0 / fits.get(unit, step_h))
    return Remark(
        "unit of power",
        where,
        f"{ratio:.3g} units of heat come from one of energy; {why}",
        f"one is {unit} taken for W, or the reverse (factor {factor:g}): check which, by the size of the machine",
    )


def _of_loss(record: Record, layout: Layout, fed: list[int], heat: Array, where: str) -> list[Remark]:
    area = _area_m2(layout, fed)
    difference = _mean(record.T_zone_C[[layout.home[a] for a in fed]]) - _mean(record.T_out_C)
    if (record.heat_W[fed] < 0.0).any():  # cooling takes out the sun and what people bring, in any weather
        return []
    if not np.isfinite(area) or not abs(difference) >= _COLDER_K or record.step_s == HOUR_S:
        return []
    loss = _mean(heat) / area / abs(difference)
    if loss <= _MOST_LOSS_W_M2K:
        return []
    step_h = record.step_s / HOUR_S
    return [
        Remark(
            "unit of power",
            where,
            f"{loss:.2g} W for each m² and K to outdoors, more than {_MOST_LOSS_W_M2K:g}",
            f"W taken for Wh per step is likely (factor {1.0 / step_h:g}), or the floor area is too small",
        )
    ]


def _of_outdoors(record: Record, layout: Layout) -> list[Remark]:
    heats = [a for a, sign in enumerate(layout.signs) if sign > 0 and layout.u_min[a] >= 0.0]
    if not heats:
        return []
    u, T_zone = record.u[heats].mean(axis=0), record.T_zone_C[:, :-1].mean(axis=0)
    T_out = record.T_out_C[:-1]
    rows = np.isfinite(u) & np.isfinite(T_zone) & np.isfinite(T_out)
    if rows.sum() < _LEAST_ROWS or u[rows].sum() <= 0.0:
        return []
    warm = rows & (T_out > T_zone - _WARM_K)
    share = float(u[warm].sum() / u[rows].sum())
    outdoors_C, rooms_C = float(np.median(T_out[rows])), float(np.median(T_zone[rows]))
    rule = RULES["T_zone_C"]
    # Of rooms without a temperature of any room their unit is asked by their readings.
    if share < _MOST_WARM_SHARE or rooms_C < rule.range[0]:
        return []
    why = f"{100 * share:.0f} % of the heating happens while it is as warm outdoors as in the rooms "
    if rooms_C < rule.usual[0]:
        remedy = "check column and unit of the rooms"
        if rule.usual[0] <= outdoors_C <= rule.usual[1]:
            remedy = "are the columns of rooms and outdoors exchanged?"
        why += f"(medians {outdoors_C:.0f} and {rooms_C:.0f} °C)"
        return [Remark("unit of temperature", "T_zone_C", why, remedy)]
    as_fahrenheit = float(in_celsius(outdoors_C))
    if as_fahrenheit > rooms_C - _COLDER_K:
        return []
    remedy = f"°F is likelier, a median of {as_fahrenheit:.0f} °C: set unit: °F, or give (x − 32) / 1.8"
    return [Remark("unit of temperature", "T_out_C", f"{why}(median {outdoors_C:.0f} °C)", remedy)]


def _area_m2(layout: Layout, fed: list[int]) -> float:
    """Floor area of the zones that `fed` serve, m²; NaN where one is not known."""
    return float(sum(layout.floor_area_m2[z] for z in {layout.home[a] for a in fed}))


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _most(load: Array) -> float:
    known = np.abs(load[np.isfinite(load)])
    return float(np.percentile(known, 99.0)) if known.size else 0.0
