"""`tf-mpc control`: control a real building through a connection."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from datetime import timedelta
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange, map_option, own_prices_option
from thermoforce_mpc.errors import ConfigError, ThermoForceError
from thermoforce_mpc.records.run_folder import write_json

if TYPE_CHECKING:
    from thermoforce_mpc.commands.command import Command
    from thermoforce_mpc.commands.loop import LearnedCommand
    from thermoforce_mpc.data import CommandValue
    from thermoforce_mpc.live import Decision
    from thermoforce_mpc.live.shadow import ShadowBook
    from thermoforce_mpc.measurements.map.mapping import MeasurementMap
    from thermoforce_mpc.protocols import Connection

_LOG = logging.getLogger(__name__)
# A note that stays the same is said again after so long.
_SAID_AGAIN = timedelta(days=1)


@click.command()
@click.option(
    "--mode",
    type=click.Choice(["control", "advise", "shadow", "probe"]),
    default="control",
    show_default=True,
    help="advise: say what would be set, and set nothing; shadow: also what it would have saved, day by day; probe: "
    "try levels within the comfort bounds until a model may act, then control with it.",
)
@click.option("--probe", is_flag=True, help="The same as --mode probe.")
@click.option("--model", type=PATH, help="Model folder of `tf-mpc identify`; not with --mode probe.")
@map_option
@own_prices_option
@click.option("--connection", default="files", metavar="NAME|FILE", help="See `tf-mpc connections`.")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="connection.KEY, controller.KEY, or with --mode probe identification.KEY, as in a scenario.",
)
@click.option("--dry-run", is_flag=True, help="Decide once, set nothing.")
@click.option("--steps", type=click.IntRange(min=1), help="End after so many control steps.  [default: never]")
@click.option(
    "--delay", "delay_s", type=FiniteRange(0.0, 300.0), default=30.0,
    help="Seconds after the beginning of a step at which its last reading is there.",
)  # fmt: skip
@click.option(
    "--watchdog", "grace_s", type=FiniteRange(0.0, 3600.0), default=60.0,
    help="Seconds after the end of what was set at which a process of its own gives the building back, if this one did "
    "not.",
)  # fmt: skip
@click.option("--out", type=PATH, default=Path("control"), help="Folder of journal, log and state.")
def control(
    mode: str,
    probe: bool,
    model: Path | None,
    map_file: Path,
    prices: Path | None,
    connection: str,
    assignments: tuple[str, ...],
    dry_run: bool,
    steps: int | None,
    delay_s: float,
    grace_s: float,
    out: Path,
) -> None:
    """Control a real building: every control step read its measurements and forecast, plan, and set what it says.

    Set are levels, or the commands that the map names (set-points, offsets, contacts), in their unit.

    Begin with --dry-run, which reads, decides once and says what it would set, then --mode advise or shadow for some
    days. Ctrl-C, SIGTERM and a closed terminal give every actuator back to the building's own control; so does a step
    in which nothing can be decided, and a watchdog in a process of its own where this one is stopped or killed.

    Each decision is printed with its reason, and kept in --out, for `tf-mpc watch`, `explain` and `report`. Start it
    again after a power failure: it goes on from what was measured, and from what it knew, which is kept in state.npz
    for a day (faults noticed, highest power, minimum times, levels set, a probing under way).

    --connection is a name, or a YAML file with `name` and `options`, as `tf-mpc init --for` writes one.

    One controller at a time: a second one of what the connection sets is refused, whatever its --out.

    Exit code 3 where the building cannot be reached at the start, or does not take its levels back at the end.

    \b
    Examples:
      tf-mpc control --model my_house --map map.yaml --dry-run
      tf-mpc control --model my_house --map map.yaml --mode shadow
      tf-mpc control --map map.yaml --probe --set connection.measurements=logs/*.csv
    """
    from contextlib import ExitStack

    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from controllers.state_classes import controller_key
    from thermoforce_mpc.cli import hangup_ends
    from thermoforce_mpc.connections.registry import build_connection, connection_settings
    from thermoforce_mpc.connections.sole import set_by
    from thermoforce_mpc.connections.watchdog import Watchdog
    from thermoforce_mpc.files import storage_errors
    from thermoforce_mpc.live import KeptState, LiveBuilding, control, real_run
    from thermoforce_mpc.live.probing import ProbingPlan, probe_building, probing_key
    from thermoforce_mpc.live.shadow import ShadowBook
    from thermoforce_mpc.measurements.map.mapping import load_map
    from thermoforce_mpc.model.thermal_model import load_model
    from thermoforce_mpc.records.live_journal import LiveJournal
    from thermoforce_mpc.records.run_folder import sole_use
    from thermoforce_mpc.records.run_log import logging_to
    from thermoforce_mpc.report.display import RunDisplay
    from thermoforce_mpc.scenario.scenario import ProbingSpec
    from thermoforce_mpc.scenario.settings import parse_overrides, validate

    chosen: Mapping[str, Any] = parse_overrides(assignments)
    mode = "probe" if probe else mode
    if unknown := [key for key in chosen if key not in ("connection", "controller", "identification")]:
        raise ConfigError(
            f"--set {unknown[0]}: write connection.KEY=VALUE, controller.KEY=VALUE or identification.KEY=VALUE"
        )
    if (model is None) != (mode == "probe"):
        raise ConfigError(
            "--model: give the folder of a model" if model is None else "--model: is found by --mode probe"
        )
    if "identification" in chosen and mode != "probe":
        raise ConfigError("--set identification: is for --mode probe")
    connection, settings = connection_settings(connection, chosen.get("connection", {}))
    rules, options = load_map(map_file), validate(MPCConfig, chosen.get("controller", {}), "--set controller")
    plan = None
    if mode == "probe":
        if dry_run:
            raise ConfigError("--dry-run: nothing is decided once with --mode probe; leave one of them out")
        spec = validate(ProbingSpec, chosen.get("identification", {}), "--set identification")
        plan = ProbingPlan.of(spec, options, rules)
    thermal = None if model is None else load_model(model)
    say = _until_lost(RunDisplay().say)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        held.enter_context(hangup_ends())
        held.enter_context(sole_use(out))
        building = held.enter_context(closing(build_connection(connection, settings)))
        held.enter_context(logging_to(out, say))
        sets, acts = set_by(building, connection, settings), mode in ("control", "probe")
        watchdog = None
        if acts and not dry_run:
            watchdog = held.enter_context(
                closing(Watchdog(connection, settings, sets, grace_s, out / "watchdog.jsonl"))
            )

        def run_of(folder: Path | None, name: str = "thermoforce_mpc") -> LiveJournal:
            return LiveJournal(out, real_run(out, folder, map_file, rules, options, connection, name))

        common: dict[str, Any] = {"delay_s": delay_s, "sets": sets, "watchdog": watchdog}
        if plan is not None:
            model = out / "probed"
            if not model.exists():
                say(f"Probing of {', '.join(rules.names.actuators)} by connection {connection}; log: {out}/log.jsonl")
                found = probe_building(
                    LiveBuilding(building, rules, plan.probing.step_s, prices),
                    plan,
                    say=say,
                    steps=steps,
                    kept=KeptState(out / "state.npz", probing_key(plan, rules)),
                    journal=run_of(None, "probing"),
                    told=_told(say, {}),
                    **common,
                )
                if found is None:
                    return
                found.save(model)
            thermal = load_model(model)
        assert model is not None
        assert thermal is not None
        commands = commands_of(building, rules, options.step_s or thermal.operator.step_s)
        mpc = ThermoForceMPC(thermal, options, commands=commands)
        key = controller_key(thermal, mpc.config, {name: learned.command for name, learned in commands.items()})
        does = {"control": "Control", "probe": "Control", "advise": "Advice for", "shadow": "Shadow of"}[mode]
        does += " of" * acts
        say(f"{does} {', '.join(thermal.names.actuators)} by connection {connection}; log: {out}/log.jsonl")
        say(f"Actuation: {mpc.actuation_in_words}")
        if acts:
            told = _told(say, commands)
        else:
            book = ShadowBook(out, thermal) if mode == "shadow" and not dry_run else None
            told = _advised(_told(say, commands), None if dry_run else out / "advice.json", book, say)
        control(
            LiveBuilding(building, rules, mpc.step_s, prices),
            mpc,
            steps=steps,
            dry=dry_run,
            kept=None if dry_run else KeptState(out / "state.npz", key),
            journal=None if dry_run else run_of(model),
            told=told,
            acts=acts,
            **(common | {"delay_s": 0.0 if dry_run else delay_s}),
        )


def _advised(
    told: Callable[[Decision], None], advice: Path | None, book: ShadowBook | None, say: Callable[[str], None]
) -> Callable[[Decision], None]:
    """Says each decision that is not set, writes it to a file, and once a day what the days so far would have saved."""

    def advised(decision: Decision) -> None:
        told(decision)
        try:
            if advice is not None:
                write_json(advice, _advice(decision), follow=True)
            if book is not None and (words := book.day_over(decision.instant)):
                say(words)
        except (ThermoForceError, ValueError) as error:
            _LOG.warning("no account of what is not set: %s", error)

    return advised


def _advice(decision: Decision) -> dict[str, Any]:
    """What would be set in the step, and what is planned: mean levels, and temperatures at the ends of steps, °C."""
    plan, names = decision.plan, decision.plan.names
    blocks = [
        {"seconds": block.duration_s, "levels": dict(zip(names.actuators, block.told, strict=True))}
        for block in decision.blocks
    ]
    planned = {"u": plan.u.tolist(), "T_zone_C": plan.T_zone_C.tolist()} if plan.u.size else {}
    why = decision.refused or plan.why
    return {"from": decision.instant.isoformat(), "blocks": blocks, "why": why, "planned": planned}


def _told(say: Callable[[str], None], commands: Mapping[str, LearnedCommand]) -> Callable[[Decision], None]:
    """Says each decision, and what is noted of its readings when that was not said for a day."""
    said: dict[str, Any] = {}

    def told(decision: Decision) -> None:
        say(in_words(decision, commands))
        for note in decision.notes:
            if note not in said or decision.instant - said[note] >= _SAID_AGAIN:
                said[note] = decision.instant
                say(f"  note: {note}")

    return told


def commands_of(building: Connection, rules: MeasurementMap, step_s: float) -> dict[str, LearnedCommand]:
    """The commands of the map with what the building's measurements tell of them; none are read where it names none.

    Raises `DataError` where they do not tell it, and `PlantError` where the building cannot be reached.
    """
    from thermoforce_mpc.live import LiveBuilding

    if not any(actuator.command for actuator in rules.actuators.values()):
        return {}
    return LiveBuilding(building, rules, step_s).commands()


def _until_lost(say: Callable[[str], None]) -> Callable[[str], None]:
    """`say` until the terminal or pipe is gone, or its disk full: that ends no control, and all is in the log."""
    lost = False

    def say_until_lost(text: str) -> None:
        nonlocal lost
        if lost:
            return
        try:
            say(text)
        except (OSError, SystemExit) as error:  # rich exits where nobody reads a pipe any more
            lost = True
            with suppress(OSError, ValueError):  # what is left in its buffer is written at the end of the program
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            _LOG.warning("nothing is printed any more (%s); this log goes on", error.__context__ or error)

    return say_until_lost


def in_words(decision: Decision, commands: Mapping[str, LearnedCommand] | None = None) -> str:
    """A decision in one line: when, what is set in turn, and why; `commands`: of actuators that are set by one."""
    commands = commands or {}
    names = decision.plan.names.actuators
    parts = []
    for a, name in enumerate(names):
        turns = [
            (told, sum(block.duration_s for block in blocks))
            for told, blocks in groupby(decision.blocks, key=lambda block: block.told[a])
        ]
        command = commands[name].command if name in commands else None
        shares = [f"{_set_in_words(told, command)} for {s / 60:g} min" for told, s in turns]
        parts.append(f"{name} {', '.join(shares)}")
    why = decision.refused or decision.plan.why
    return f"{decision.instant:%a %d %b %H:%M %Z}  {'; '.join(parts)}: {why}"


def _set_in_words(told: CommandValue | None, command: Command | None) -> str:
    if not isinstance(told, float):
        return "own control"
    return f"{100 * told:.0f} %" if command is None else command.in_words(told)
