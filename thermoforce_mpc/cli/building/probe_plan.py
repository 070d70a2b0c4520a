"""`tf-mpc data probe-plan`: days of probing by hand after which a table tells the effect of acting."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.files import written
from thermoforce_mpc.simulation.views.display import RunDisplay

if TYPE_CHECKING:
    from thermoforce_mpc.identification.probing.by_hand import ProbeSchedule

FILES = click.argument("files", nargs=-1, required=True, metavar="FILE...")
MAP = click.option("--map", "map_file", required=True, type=click.Path(path_type=Path), help="Map of the table (YAML).")


def _hours(context: click.Context, parameter: click.Parameter, value: str) -> tuple[int, int]:
    try:
        first, last = (int(part) for part in value.split("-"))
    except ValueError as error:
        raise click.BadParameter("write two hours, such as 7-22") from error
    return first, last


def _levels(context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in value.split(","))
    except ValueError as error:
        raise click.BadParameter("write levels, such as 0,1 or 0,0.5,1") from error


@click.command("probe-plan")
@FILES
@MAP
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("probe.csv"), show_default=True, help="Schedule (CSV)."
)
@click.option("--days", type=int, default=1, show_default=True, help="Days to probe, 1 to 7.")
@click.option("--levels", default="0,1", show_default=True, callback=_levels, help="Levels to set, off first.")
@click.option("--awake", default="7-22", show_default=True, callback=_hours, help="Hours between which levels are set.")
@click.option("--start", metavar="DATE", help="First day.  [default: the first morning after the data]")
@click.option("--fit/--no-fit", default=True, show_default=True, help="Fit a linear model to see what is known.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the draws.")
def probe_plan_command(
    files: tuple[str, ...],
    map_file: Path,
    out: Path,
    days: int,
    levels: tuple[float, ...],
    awake: tuple[int, int],
    start: str | None,
    fit: bool,
    seed: int,
) -> None:
    """Write a probing after which FILE and it together tell the effect of acting, to run by hand.

    The schedule has one line per change: the time, and the level of every actuator from then on; an empty cell leaves
    the actuator to the building's own control, as at night and at the end. Actuators whose effect a linear model of
    FILE tells already are left alone; where it tells all, nothing is written.

    Keep measuring while you run it, append the rows to your file, and identify again; where a day was not enough, add
    another.
    """
    from thermoforce_mpc.identification.probing.by_hand import probe_schedule
    from thermoforce_mpc.identification.probing.operation import MOST_DAYS, findings, telling_part
    from thermoforce_mpc.measurements.load import read_measurements

    display = RunDisplay()
    measured = read_measurements(files, map_file).served()
    begin_s, hours = _start(measured.record, awake, start)
    record, note = telling_part(measured.record, measured.layout)
    if note:
        display.say(note)
    fitted = findings(record, measured.layout) if fit else []
    for finding in fitted:
        display.say(f"Found for {finding.actuator} by a linear model: {finding.words}")
    lower, upper = (_last_known(getattr(measured.conditions, name)) for name in ("lower_C", "upper_C"))
    recent = measured.record.last(round(MOST_DAYS * DAY_S / measured.record.step_s))
    plan = probe_schedule(
        recent,
        measured.layout,
        days=days,
        lower_C=lower,
        upper_C=upper,
        levels=levels,
        awake=hours,
        start_s=begin_s,
        competent=[finding.competent for finding in fitted] if fitted else None,
        seed=seed,
    )
    if not plan.probed:
        display.say("Nothing needs to be probed.")
        return
    _write(out, plan, display)


def _write(out: Path, plan: ProbeSchedule, display: RunDisplay) -> None:
    """Print the schedule with what it is expected to cost, and write it."""
    from thermoforce_mpc.data.dataframes import table
    from thermoforce_mpc.identification.probing.by_hand import as_changes

    display.say(f"{plan.by_hand_h} h by hand at {', '.join(plan.probed)}, expected:")
    for z, zone in enumerate(plan.record.names.zones):
        low, high = plan.lower_C[z], plan.upper_C[z]
        display.say(
            f"  {zone}: {plan.discomfort_Kh[z]:.1f} K·h outside {low:.1f} to {high:.1f} °C, up to "
            f"{plan.excursion_K[z]:.1f} K from its usual temperature, for a building as the priors expect it. Leave "
            f"the schedule where it gets below {low - 1:.0f} or above {high + 1:.0f} °C, and note when"
        )
    time_s, u = as_changes(plan)
    names = plan.record.names.actuators
    changes = table(time_s, plan.record.origin, **dict(zip(names, u, strict=True)))
    with written(out) as aside:
        changes.to_csv(aside)
    for at, row in changes.iterrows():
        cells = ", ".join(f"{name} {'own control' if np.isnan(u) else f'{100 * u:.0f} %'}" for name, u in row.items())
        display.say(f"  {at}  {cells}")
    display.say(f"Schedule: {out}")


def _last_known(rows: Array) -> Array:
    """The last known value of each row (Z, n), NaN where it has none."""
    return np.array([row[np.isfinite(row)][-1] if np.isfinite(row).any() else np.nan for row in rows])


def _start(record: Record, awake: tuple[int, int], start: str | None) -> tuple[float, tuple[int, int]]:
    """The first awake hour of the first day, s since the record's new year, and the awake hours in its standard time.

    Raises:
        DataError: `start` is no date, or lies before the end of the record.
    """
    import pandas as pd

    origin, end = record.origin, record.stamps()[-1]
    summer = (end.utcoffset() - origin.utcoffset()).total_seconds() if origin.tzinfo else 0.0
    hours = (max(0, awake[0] - round(summer / HOUR_S)), awake[1] - round(summer / HOUR_S))
    if start is None:
        now_s = float(record.time_s[-1])
        return np.ceil((now_s - hours[0] * HOUR_S) / DAY_S) * DAY_S + hours[0] * HOUR_S, hours
    try:
        day = pd.Timestamp(start)
        dated = not pd.isna(day)
    except ValueError:
        dated = False
    if not dated:
        raise DataError(f"--start {start}: no date; write for example 2025-01-31")
    at = (day.normalize().tz_localize(None) - origin.tz_localize(None)).total_seconds() + HOUR_S * hours[0]
    if at < record.time_s[-1]:
        raise DataError(f"--start {start}: lies before the end of the data, {end}; name a later day")
    return float(at), hours
