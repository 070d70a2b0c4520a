"""`tf-mpc control`: control a real building through a connection."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import dataclass
from datetime import timedelta
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange, billed_objective, map_option, own_prices_option, said_tank
from thermoforce_mpc.errors import ConfigError, ThermoForceError

if TYPE_CHECKING:
    from controllers.mpc.config import MPCConfig
    from thermoforce_mpc.commands.command import Command
    from thermoforce_mpc.commands.loop import LearnedCommand
    from thermoforce_mpc.data import CommandValue
    from thermoforce_mpc.live import Decision, LiveBuilding, People
    from thermoforce_mpc.live.probing import ProbingPlan
    from thermoforce_mpc.live.shadow import ShadowBook
    from thermoforce_mpc.measurements.map.mapping import MeasurementMap
    from thermoforce_mpc.model.thermal_model import ThermalModel
    from thermoforce_mpc.protocols import Connection
    from thermoforce_mpc.records.live_journal import LiveJournal

_LOG = logging.getLogger(__name__)
# A note on the same matter is said again after so long, or where there is twice as much of it.
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
@click.option(
    "--page", metavar="HOST:PORT|ingress",
    help="Serve a page that shows and asks; ingress: within an add-on of Home Assistant. Beyond 127.0.0.1 it needs a "
    "token, in TF_MPC_PAGE_TOKEN or a file of mode 600.",
)  # fmt: skip
@click.option("--page-token-file", type=PATH, help="Where that token stands.")
@click.option("--page-name", "page_names", multiple=True, help="Name by which browsers ask for the page; repeatable.")
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
    page: str | None,
    page_token_file: Path | None,
    page_names: tuple[str, ...],
) -> None:
    """Control a real building: every control step read its measurements and forecast, plan, and set what it says.

    Set are levels, or the commands that the map names (set-points, offsets, contacts), in their unit.

    Begin with --dry-run, which reads, decides once and says what it would set, then --mode advise or shadow for some
    days. Ctrl-C, SIGTERM and a closed terminal give every actuator back to the building's own control; so does a step
    in which nothing can be decided, and a watchdog in a process of its own where this one is stopped or killed.

    Each decision is printed with its reason, and kept in --out, for `tf-mpc watch`, `explain` and `report`. Start it
    again after a power failure: it goes on from what was measured, and from what it knew, which is kept in state.npz
    for a day (faults noticed, highest power, minimum times, levels set, a probing under way).

    What people ask (`tf-mpc ask`, over MQTT, or on the page of --page) counts from the next step on. A set-point that
    somebody changed at the device is left alone for 4 h, and a note says so.

    --connection is a name, or a YAML file with `name` and `options`, as `tf-mpc init --for` writes one.

    One controller at a time: a second one of what the connection sets is refused, whatever its --out.

    Exit code 3 where the building cannot be reached at the start, or does not take its levels back at the end.

    \b
    Examples:
      tf-mpc control --model my_house --map map.yaml --dry-run
      tf-mpc control --model my_house --map map.yaml --mode shadow
      tf-mpc control --map map.yaml --probe --set connection.measurements=logs/*.csv
    """
    from controllers.mpc.config import MPCConfig
    from thermoforce_mpc.connections.registry import build_connection, connection_settings
    from thermoforce_mpc.connections.sole import set_by
    from thermoforce_mpc.connections.watchdog import Watchdog
    from thermoforce_mpc.files import storage_errors
    from thermoforce_mpc.live.probing import ProbingPlan
    from thermoforce_mpc.live.shared import ACTING
    from thermoforce_mpc.measurements.map.mapping import load_map
    from thermoforce_mpc.model.thermal_model import load_model
    from thermoforce_mpc.records.people import SHOWN
    from thermoforce_mpc.records.run_folder import logging_to, sole_use
    from thermoforce_mpc.report.display import RunDisplay
    from thermoforce_mpc.scenario.scenario import ProbingSpec
    from thermoforce_mpc.scenario.settings import merge, parse_overrides, validate
    from thermoforce_mpc.service.page_process import Page, PageSettings

    chosen: Mapping[str, Any] = parse_overrides(assignments)
    if probe and mode not in ACTING:
        raise ConfigError(f"--probe: is --mode probe, and --mode is {mode}; leave one of them out")
    mode = "probe" if probe else mode
    _check_words(mode, model, chosen, dry_run)
    connection, settings = connection_settings(connection, chosen.get("connection", {}))
    rules = load_map(map_file)
    billed = {"objective": billed_objective(prices, rules)}
    options = validate(MPCConfig, merge(billed, chosen.get("controller", {})), "--set controller")
    plan, thermal = None, None
    if mode == "probe":
        spec = validate(ProbingSpec, chosen.get("identification", {}), "--set identification")
        plan = ProbingPlan.of(spec, options, rules)
    if model is not None:
        thermal = load_model(model)
    if page is None and (page_token_file or page_names):
        raise ConfigError("--page-token-file, --page-name: are for --page HOST:PORT, which is missing")
    shown = None if page is None else PageSettings.of(page, out, rules.time.zone, page_token_file, page_names)
    display = RunDisplay()
    say = _until_lost(display.say)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        held.enter_context(sole_use(out))
        building = held.enter_context(closing(build_connection(connection, settings)))
        held.enter_context(logging_to(out, say))
        if shown is not None and not dry_run:
            (out / SHOWN).unlink(missing_ok=True)  # of the run before
            held.enter_context(closing(Page(shown, say)))
        sets, watchdog = set_by(building, connection, settings), None
        if mode in ACTING and not dry_run:
            watchdog = Watchdog(connection, settings, sets, grace_s, out / "watchdog.jsonl")
            held.enter_context(closing(watchdog))
        common = {"steps": steps, "delay_s": 0.0 if dry_run else delay_s, "sets": sets, "watchdog": watchdog}
        run = _Run(out, building, connection, map_file, rules, options, prices, say, display.phase, common)
        if plan is not None:
            model = run.probed(plan)
            thermal = None if model is None else load_model(model)
        if model is not None and thermal is not None:
            run.control(model, thermal, mode, dry_run)


def _check_words(mode: str, model: Path | None, chosen: Mapping[str, Any], dry_run: bool) -> None:
    """Refuse what makes no sense in a mode; raises `ConfigError`."""
    if unknown := [key for key in chosen if key not in ("connection", "controller", "identification")]:
        raise ConfigError(
            f"--set {unknown[0]}: write connection.KEY=VALUE, controller.KEY=VALUE or identification.KEY=VALUE"
        )
    if model is None and mode != "probe":
        raise ConfigError("--model: missing; give the folder that `tf-mpc identify` wrote, or --mode probe to find one")
    if model is not None and mode == "probe":
        raise ConfigError("--model: leave it out; a model is found by --mode probe")
    if "identification" in chosen and mode != "probe":
        raise ConfigError("--set identification: is for --mode probe")
    if mode == "probe" and dry_run:
        raise ConfigError("--dry-run: nothing is decided once with --mode probe; leave one of them out")


@dataclass(frozen=True)
class _Run:
    """What probing and control of a building share; `common`: arguments of `thermoforce_mpc.live.control`.

    `phase`: a context that says now and then that something goes on, where it takes long.
    """

    out: Path
    building: Connection
    connection: str
    map_file: Path
    rules: MeasurementMap
    options: MPCConfig
    prices: Path | None
    say: Callable[[str], None]
    phase: Callable[[str], AbstractContextManager[Any]]
    common: Mapping[str, Any]

    def live(self, step_s: float, people: People | None = None) -> LiveBuilding:
        """The building at a step, s, and what people ask of it."""
        from thermoforce_mpc.live import LiveBuilding

        return LiveBuilding(self.building, self.rules, step_s, self.prices, people, self.map_file)

    def journal(self, model: Path | None, controller: str = "thermoforce_mpc") -> LiveJournal:
        """The journal of a controller, with its model."""
        from thermoforce_mpc.live import real_run
        from thermoforce_mpc.records.live_journal import LiveJournal

        of = real_run(self.out, model, self.map_file, self.rules, self.options, self.connection, controller)
        return LiveJournal(self.out, of)

    def probed(self, plan: ProbingPlan) -> Path | None:
        """The model that a probing found, before or now; None where --steps ended it."""
        from thermoforce_mpc.live import KeptState
        from thermoforce_mpc.live.probing import probe_building, probing_key

        folder = self.out / "probed"
        if folder.exists():
            self.say(f"Probed before: {folder}")
            return folder
        names = ", ".join(self.rules.names.actuators)
        self.say(f"Probing of {names} by connection {self.connection}; log: {self.out}/log.jsonl")
        found = probe_building(
            self.live(plan.probing.step_s),
            plan,
            say=self.say,
            kept=KeptState(self.out / "state.npz", probing_key(plan, self.rules)),
            journal=self.journal(None, "probing"),
            told=_told(self.say, {}),
            **self.common,
        )
        return None if found is None else found.save(folder)

    def control(self, model: Path, thermal: ThermalModel, mode: str, dry: bool) -> None:
        """Control with the model `thermal` of the folder `model`, or say what it would do."""
        from controllers.mpc.controller import ThermoForceMPC
        from controllers.state_classes import controller_key
        from thermoforce_mpc.live import KeptState, LiveBuilding, People, control
        from thermoforce_mpc.live.shadow import ShadowBook
        from thermoforce_mpc.live.shared import ACTING, shared_with
        from thermoforce_mpc.scenario.bill import SUFFIXES, read_bill

        acts = mode in ACTING
        with self.phase(f"measurements of connection {self.connection} are read, and what they tell of commands"):
            commands = commands_of(self.building, self.rules, self.options.step_s or thermal.operator.step_s)
            building = LiveBuilding(self.building, self.rules, self.options.step_s or thermal.operator.step_s)
            tank = None if self.rules.hot_water is None else said_tank(building.tank, self.say)
            mpc = ThermoForceMPC(thermal, self.options, commands=commands, hot_water=tank)
        by_name = {name: learned.command for name, learned in commands.items()}
        if tank is not None and tank.command is not None:
            from thermoforce_mpc.commands.tank import TANK_NAME

            by_name[TANK_NAME] = tank.command
        key = controller_key(thermal, mpc.config, by_name)
        names = ", ".join(thermal.names.actuators)
        does = {"advise": "Advice for", "shadow": "Shadow of"}.get(mode, "Control of")
        self.say(f"{does} {names} by connection {self.connection}; log: {self.out}/log.jsonl")
        people = People(self.out / "people.json", self.rules.time.zone)
        self.say(f"Actuation: {mpc.actuation_in_words}")
        thermal.say_claims(self.say)
        told = _told(self.say, commands)
        billed = mode == "shadow" and self.prices is not None and self.prices.suffix in SUFFIXES
        if billed and self.prices and (left := read_bill(self.prices).of_whole_house):
            self.say(f"{self.prices}: {', '.join(left)}: not counted in what it would have saved")
        live = self.live(mpc.step_s, people)
        if not acts and not dry:
            shadowed = (self.out, thermal, mpc, commands, key, live.tank_log)
            book = ShadowBook(*shadowed) if mode == "shadow" else None
            told = _advised(told, self.out / "advice.json", book, self.say)
        with ExitStack() as until_told:
            until_told.enter_context(self.phase("measurements are read and a plan is made"))

            def told_first(decision: Decision) -> None:
                until_told.close()
                told(decision)

            control(
                live,
                mpc,
                dry=dry,
                kept=None if dry else KeptState(self.out / "state.npz", key),
                journal=None if dry else self.journal(model),
                told=shared_with(
                    self.building,
                    people,
                    told_first,
                    lambda decision: in_words(decision, commands),
                    self.out,
                    mode,
                    commands,
                    None if tank is None else tank.command,
                ),
                acts=acts,
                **self.common,
            )


def _advised(
    told: Callable[[Decision], None], advice: Path, book: ShadowBook | None, say: Callable[[str], None]
) -> Callable[[Decision], None]:
    """Says each decision that is not set, writes it to a file, and once a day what the days so far would have saved."""

    from thermoforce_mpc.files import write_json

    def advised(decision: Decision) -> None:
        told(decision)
        try:
            write_json(advice, _advice(decision), follow=True)
            if book is not None and (words := book.day_over(decision.instant)):
                say(words)
        except Exception as error:  # what is not set ends no control, whatever is wrong with what it is compared with
            expected = isinstance(error, ThermoForceError)
            _LOG.warning("no account of what is not set: %s", error, exc_info=None if expected else error)

    return advised


def _advice(decision: Decision) -> dict[str, Any]:
    """What would be set in the step, and what is planned: mean levels, and temperatures at the ends of steps, °C."""
    plan, names = decision.plan, decision.plan.names
    blocks = [
        {"seconds": block.duration_s, "levels": dict(zip(names.actuators, block.told, strict=True))}
        for block in decision.blocks
    ]
    if plan.hot_water is not None:
        blocks = [one | {"hot_water": plan.hot_water.command[0]} for one in blocks]
    planned = {"u": plan.u.tolist(), "T_zone_C": plan.T_zone_C.tolist()} if plan.u.size else {}
    why = decision.refused or plan.why
    return {"from": decision.instant.isoformat(), "blocks": blocks, "why": why, "planned": planned}


def _told(say: Callable[[str], None], commands: Mapping[str, LearnedCommand]) -> Callable[[Decision], None]:
    """Says each decision, and what is noted of its readings when that matter was not said for a day, or doubled."""
    from thermoforce_mpc.data.notes import NotesTold

    said = NotesTold(_SAID_AGAIN.total_seconds())

    def told(decision: Decision) -> None:
        say(in_words(decision, commands))
        for note in decision.notes:
            if said.is_news(note, decision.instant.timestamp()):
                say(f"  note: {note}")

    return told


def commands_of(building: Connection, rules: MeasurementMap, step_s: float) -> dict[str, LearnedCommand]:
    """The commands of the map with what the building's measurements tell of them; none are read where it names none.

    Raises `DataError` where they do not tell it, and `PlantError` where the building cannot be reached.
    """
    from thermoforce_mpc.live import LiveBuilding

    if not any(rules.command_of(name) for name in rules.actuators):
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
        shares = [f"{_set_in_words(told, command)} for {round(s / 60, 1):g} min" for told, s in turns]
        parts.append(f"{name} {', '.join(shares)}")
    if (told_tank := _tank_in_words(decision)) is not None:
        parts.append(told_tank)
    why = decision.refused or decision.plan.why
    return f"{decision.instant:%a %d %b %H:%M %Z}  {'; '.join(parts)}: {why}"


def _tank_in_words(decision: Decision) -> str | None:
    """What is set at the tank; None without one."""
    plan = decision.plan.hot_water
    if plan is None:
        return None
    value = None if decision.refused else plan.command[0]
    return f"hot water {'own control' if value is None else f'{value:g}'}"


def _set_in_words(told: CommandValue | None, command: Command | None) -> str:
    if not isinstance(told, float):
        return "own control"
    return f"{100 * told:.0f} %" if command is None else command.in_words(told)
