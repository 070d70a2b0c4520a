"""`tf-mpc explain`: what a run decided at an instant, and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from thermoforce_mpc.cli.options import PATH, FiniteRange
from thermoforce_mpc.commands.loop import saving_in_words
from thermoforce_mpc.commands.tank import tank_in_words
from thermoforce_mpc.data import HOUR_S, steps_in
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.experiment.explaining import (
    ExplainedStep,
    alternatives_json,
    alternatives_of,
    claims_of,
    decision_at,
    hour_ends,
)
from thermoforce_mpc.files import plain_json, write_json
from thermoforce_mpc.records.live_journal import UNNAMED_CURRENCY
from thermoforce_mpc.records.run_folder import in_use
from thermoforce_mpc.report.whole_tables import plain_table, print_whole

if TYPE_CHECKING:
    from controllers.mpc.alternatives import Alternatives

_AS_PLANNED = {"solved", "bridged", "acceptable"}
_RUNGS = {
    "solved": "the plan of the solver, checked",
    "bridged": "the plan of the solver, checked, with a substitute for a reading or a forecast (see the notes)",
    "acceptable": "fallback: levels of a solver that did not reach its optimum, checked",
    "shifted": "fallback: the previous plan, shifted by a step",
    "thermostat": "fallback: the thermostat rule",
    "native": "fallback: the plant's own control, where nothing is known to act on",
    "guard": "the comfort guard, which overrode the plan",
    "gate": "the building's own control or the rule: the model may not control",
    "watch": "the building's own control or the rule: the model did not hold",
    "rule": "a rule, no plan",
}


@click.command()
@click.argument("run", type=PATH)
@click.option(
    "--at", metavar="TIME", help="'16 06:30' (day from 0), '01-17 06:30', '1405800s', or a date.  [default: last step]"
)
@click.option("--controller", metavar="NAME", help="Which of the run.  [default: the scenario's own]")
@click.option("--hours", type=FiniteRange(0.1), default=12.0, help="Hours of the plan to show.")
@click.option("--json", "json_file", type=PATH, help="Write all of it to this JSON file.")
def explain(run: Path, at: str | None, controller: str | None, hours: float, json_file: Path | None) -> None:
    """Tell what the run in folder RUN decided at an instant, and why: readings, forecast, plan, what bound, what acted.

    Beside the plan stand its alternatives: what the same model predicts for the same hours had everything been off, at
    full level, as in the step before, run by the fallback's thermostat rule, or by loops that hold the comfort bounds
    (what a building's own control does at its best). A row shows what each part of the objective counts, and their sum,
    which the plan makes least; the part `discomfort` is counted from the bounds with the plan's margins inside.

    Read from the journal, so that it works while a run is under way and after one that failed.

    \b
    Examples:
      tf-mpc explain runs/my-run
      tf-mpc explain runs/my-run --at '16 06:30' --hours 24
    """
    decision = decision_at(run, at, controller)
    claims = claims_of(run, decision)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    for line in _lines(decision, claims, under_way=in_use(run)):
        console.print(line)
    if decision.plan:
        print_whole(_table(decision, hours), console)
    alternatives = alternatives_of(run, decision)
    if isinstance(alternatives, str):
        console.print(f"alternatives: none are known, {alternatives}")
    else:
        print_whole(_alternatives(decision, alternatives), console)
        console.print(f"action: {_reason(decision, alternatives)}")
        for note in alternatives.notes:
            console.print(f"alternatives: {note}")
    if json_file:
        told = _json(decision) | {"claims": list(claims), "learned": decision.learned()}
        write_json(json_file, told | {"alternatives": alternatives_json(alternatives)}, follow=True)
        console.print(f"JSON: {json_file}")


def _alternatives(decision: ExplainedStep, alternatives: Alternatives) -> Table:
    names, step_s = decision.step.names, decision.boundary.step_s
    first = steps_in(HOUR_S, step_s)
    hours = alternatives.courses[0].u.shape[1] * step_s / HOUR_S
    columns = ["", *(part.replace(" ", "\n", 1) for part in alternatives.courses[0].parts), "= total"]
    columns += ["energy\nkWh", "discomfort\nK·h"]
    columns += ["u, first hour" if names.single else f"u, first hour\n{name}" for name in names.actuators]
    columns += ["ends at\n°C" if names.single else f"ends at\n{zone}" for zone in names.zones]
    title = f"Alternatives over {hours:g} h, the whole plan, by the same model: what is minimised"
    table = plain_table(columns, title)
    for course in alternatives.courses:
        row = [course.name, *(f"{part:.2f}" for part in course.parts.values()), f"{course.total:.2f}"]
        row += [f"{course.energy_kWh:.1f}", f"{course.discomfort_Kh:.2f}"]
        row += [f"{level:.2f}" for level in course.u[:, :first].mean(axis=1)]
        row += [f"{T:.2f}" for T in course.T_zone_C[:, -1]]
        table.add_row(*row)
    return table


def _reason(decision: ExplainedStep, alternatives: Alternatives) -> str:
    status = decision.step.told["status"]
    if status not in _AS_PLANNED or not alternatives.reason:
        return f"not that of a plan: {_RUNGS.get(status, status)}"
    others = sorted(set(decision.step.told["acting"]) - _AS_PLANNED)
    but = f"; at some actuators not the plan's, but {' and '.join(others)}" if others else ""
    return f"the plan's first step, of {alternatives.reason}{but}"


def _lines(decision: ExplainedStep, claims: Sequence[str], *, under_way: bool) -> list[str]:
    step = decision.step
    record, names = step.told, step.names
    begun = decision.building.in_words(step.time_s)
    lines = [f"{decision.controller}, step {record['index']}: {begun} ({step.time_s:.0f} s)"]
    if step.before is not None:
        zones = ", ".join(f"{zone} {_C(T)}" for zone, T in zip(names.zones, step.before.T_zone_C, strict=True))
        lines.append(f"measured: {zones}; outdoors {_C(step.before.T_out_C)}, sun {step.before.solar_W_m2:.0f} W/m²")
    lines += [f"in doubt: {note}" for note in step.notes]
    lines.append(f"acted: {record['status']} – {_RUNGS.get(record['status'], 'see docs/how-it-works/fallback.md')}")
    if len(set(record["acting"])) > 1:
        acting = zip(names.actuators, record["acting"], strict=True)
        lines.append("at each actuator: " + ", ".join(f"{name} {status}" for name, status in acting))
    lines.append(f"why: {record['why']}")
    if record["refused"]:
        lines.append(f"refused before the plant: {record['refused']}")
    if record["solver_status"]:
        lines.append(f"solver: {record['solver_status']}, {record['iterations']} iterations")
    lines += [f"bound: {bound}" for bound in decision.bounds()]
    lines += [f"margin: {margin}" for margin in decision.margins_in_words()]
    lines += [f"found before the run: {claim}" for claim in claims]
    lines += [f"learned: {news}" for news in decision.learned()]
    plan = decision.step.plan
    if plan.saving is not None:
        currency = decision.building.currency.replace(UNNAMED_CURRENCY, "")
        lines.append(f"saving of its commands: {saving_in_words(plan.saving, currency=currency)}")
    if plan.hot_water is not None:
        value = plan.hot_water.command[0]
        set_to = "left to its device" if value is None else f"set to {value:g}"
        lines.append(f"tank: {set_to}. {tank_in_words(plan.hot_water)}")
    blocks = []
    for block in record["blocks"]:
        told = block.get("command") or [None] * len(block["u"])
        levels = [_set(u, command) for u, command in zip(block["u"], told, strict=True)]
        if len(levels) > 1:
            levels = [f"{name} {level}" for name, level in zip(names.actuators, levels, strict=True)]
        blocks.append(f"{', '.join(levels)} for {block['duration_s'] / 60:g} min")
    lines.append("applied: " + "; then ".join(blocks))
    if step.after:
        end = step.after[-1]
        zones = ", ".join(f"{zone} {_C(T)}" for zone, T in zip(names.zones, end.T_zone_C, strict=True))
        planned = ""
        if decision.plan:
            planned = f" (planned {', '.join(_C(float(T)) for T in decision.T_zone_C[:, 0])})"
        lines.append(f"came: {zones}{planned} at {decision.building.in_words(end.time_s)}")
    else:
        lines.append(f"came: nothing is recorded{' yet' if under_way else ', the run ended here'}")
    return lines


def _set(u: float | None, command: float | list[float] | None) -> str:
    """What an actuator was told: its level, or a command with the level that is expected of it."""
    if command is None:
        return "own control" if u is None else f"{u:.2f}"
    values = " to ".join(f"{value:g}" for value in (command if isinstance(command, list) else [command]))
    return values if u is None else f"set to {values} (level {u:.2f} expected)"


def _table(decision: ExplainedStep, hours: float) -> Table:
    tank = decision.step.plan.hot_water
    boundary, names, plan = decision.boundary, decision.step.names, decision.plan
    n = plan["u"].shape[-1]
    ends = hour_ends(n, boundary.step_s, hours)
    every = ends.step
    all_h = n * boundary.step_s / HOUR_S
    part = f", the first {hours:g} of {all_h:g} h (--hours {all_h:g} shows all)" if hours < all_h else ""
    columns = ["until", "outdoors\n°C", "sun\nW/m²", "price\nper kWh"]
    columns += ["u" if names.single else f"u\n{name}" for name in names.actuators]
    for zone in names.zones:
        of = "" if names.single else f"\n{zone}"
        columns += [f"T{of or chr(10) + '°C'}", f"80 %{of}", f"bounds{of}"]
    columns += ["tank\n°C", "9 of 10\ndays", "set"] if tank is not None else []
    table = plain_table(columns, f"Plan{part}")
    T = decision.T_zone_C
    for end in ends:
        step = slice(end - every, end)
        row = [
            decision.building.in_words(boundary.time_s[end]),
            f"{np.mean(boundary.T_out_C[step]):.1f}",
            f"{np.mean(boundary.solar_W_m2[step]):.0f}",
            f"{np.mean(boundary.price_per_kWh[0, step]):.3f}",
        ]
        row += [f"{np.mean(plan['u'][a, step]):.2f}" for a in range(len(names.actuators))]
        for z in range(len(names.zones)):
            at, forced_K = (z, end - 1), plan["T_forced_K"]
            low, high = (compose(plan[name][at], forced_K[at]) for name in ("T_free_low_C", "T_free_high_C"))
            bounds = f"{boundary.lower_C[z, end]:g}–{boundary.upper_C[z, end]:g}"
            row += [f"{T[z, end - 1]:.2f}", f"{low:.1f}–{high:.1f}", bounds]
        if tank is not None:
            value = tank.command[end - every]
            row += [f"{tank.T_C[end - 1]:.1f}", f"> {tank.low_C[end - 1]:.1f}", "" if value is None else f"{value:g}"]
        table.add_row(*row)
    return table


def _json(decision: ExplainedStep) -> dict[str, Any]:
    packed = ("plan", "forecast", "asked", "hot_water")
    content = {key: value for key, value in decision.step.told.items() if key not in packed}
    if (tank := decision.step.plan.hot_water) is not None:
        values = asdict(tank).items()
        content["hot_water"] = plain_json({name: np.asarray(one, dtype=np.float64).tolist() for name, one in values})
    content |= {"controller": decision.controller, "bounds": decision.bounds(), "notes": list(decision.step.notes)}
    content["plan"] = {name: values.tolist() for name, values in decision.plan.items()}
    signals = ("time_s", "T_out_C", "solar_W_m2", "lower_C", "upper_C", "price_per_kWh")
    content["forecast"] = {name: np.asarray(getattr(decision.boundary, name)).tolist() for name in signals}
    return content


def _C(value: float) -> str:
    return "no reading" if math.isnan(value) else f"{value:.2f} °C"
