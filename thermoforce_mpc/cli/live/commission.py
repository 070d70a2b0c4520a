"""`tf-mpc commission`: take a building into service, step by step."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange
from thermoforce_mpc.errors import ConfigError, InputError, NoConnection, PlantError

if TYPE_CHECKING:
    from thermoforce_mpc.connections.sole import Sets
    from thermoforce_mpc.live import LiveBuilding
    from thermoforce_mpc.live.commissioning import CommissioningBook, CommissioningFiles, PointsFound
    from thermoforce_mpc.live.trial import TrialPlan
    from thermoforce_mpc.measurements.map.mapping import MeasurementMap

# Time between two looks whether all points came, s, where a connection only hears what is sent.
LOOK_S = 1.0
USUAL_MODEL = "my_house"
"""The model's folder, as pages and `--help` have it."""
# Usual distances of a point's readings from which on the next one is waited for.
_LATE = 3.0


@click.command()
@click.argument("config", metavar="CONFIG.yaml")
@click.option("--map", "map_file", type=PATH, help="Map of the points.  [default: map.yaml beside CONFIG.yaml]")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="connection.KEY.")
@click.option("--yes", is_flag=True, help="Try every command without asking.")
@click.option(
    "--dry-run", is_flag=True, help="Read and check; say what would be tried. Sets nothing, keeps what MQTT tells."
)
@click.option("--again", is_flag=True, help="Try commands again that were tried.")
@click.option(
    "--hold", "hold_min", type=FiniteRange(1.0, 720.0), metavar="MIN",
    help="Length of a trial, at least hold_min of its command in the map.  [default: that]",
)  # fmt: skip
@click.option(
    "--wait", "wait_s", type=FiniteRange(0.0, 86400.0), default=60.0, metavar="S",
    help="How long points that are only heard (MQTT) are waited for.",
)  # fmt: skip
@click.option("--watchdog", "grace_s", type=FiniteRange(0.0, 3600.0), default=60.0, help="See `tf-mpc control`.")
@click.option(
    "--model", help=f"Where the model is, or will be.  [default: the one model folder that is here, else {USUAL_MODEL}]"
)
@click.option("--control", "control_out", default="control", show_default=True, help="--out of `tf-mpc control`.")
@click.option("--out", type=PATH, default=Path("commission"), help="Folder of what was found, log and report.")
@click.option("--json", "json_file", type=PATH, help="Write what was found as JSON.")
def commission(
    config: str,
    map_file: Path | None,
    assignments: tuple[str, ...],
    yes: bool,
    dry_run: bool,
    again: bool,
    hold_min: float | None,
    wait_s: float,
    grace_s: float,
    model: str | None,
    control_out: str,
    out: Path,
    json_file: Path | None,
) -> None:
    """Take a building into service: CONFIG.yaml names its connection, as `tf-mpc init --for` writes it.

    Reads every point: what came, how old it is, unit and range; and checks them against one another and the weather
    (°F for °C, kW for W, rooms swapped, a temperature taken for a set-point). Then tries each command once after a yes:
    a value near what is set, for as long as the device must hold one, watched, and put back however it ends (Ctrl-C,
    kill: a watchdog in a process of its own). Then it says what is next, record or probing, model, shadow, control,
    with its command.

    Start it again at any time: trials that were done are not repeated. It keeps commission.json, report.md and logs in
    --out. Exit code 1 where something is to be mended, 2 where trials wait for a yes and nobody is at a terminal.

    \b
    Examples:
      tf-mpc commission connection.yaml --dry-run
      tf-mpc commission connection.yaml
      tf-mpc commission connection.yaml --yes --json commission.json
    """
    from thermoforce_mpc.connections.registry import build_connection, connection_settings
    from thermoforce_mpc.connections.sole import set_by
    from thermoforce_mpc.files import storage_errors, write_json, write_whole
    from thermoforce_mpc.live import LiveBuilding, WallClock
    from thermoforce_mpc.live.commissioning import CommissioningBook, CommissioningReport, stages
    from thermoforce_mpc.live.trial import planned_trials
    from thermoforce_mpc.measurements.map.mapping import load_map
    from thermoforce_mpc.records.run_folder import logging_to, sole_use
    from thermoforce_mpc.report.display import RunDisplay
    from thermoforce_mpc.scenario.settings import parse_overrides

    chosen: Mapping[str, Any] = parse_overrides(assignments)
    if unknown := [key for key in chosen if key != "connection"]:
        raise ConfigError(f"--set {unknown[0]}: write connection.KEY=VALUE")
    if yes and dry_run:
        raise ConfigError("--yes: nothing is tried with --dry-run; leave one of them out")
    name, settings = connection_settings(config, chosen.get("connection", {}))
    map_file = Path(config).with_name("map.yaml") if map_file is None else map_file
    rules = load_map(map_file)
    step_s = _step_s(rules)
    with ExitStack() as held:
        say: Callable[[str], None] = RunDisplay().say
        if not dry_run:
            with storage_errors(out):
                out.mkdir(parents=True, exist_ok=True)
            held.enter_context(sole_use(out))
            held.enter_context(logging_to(out, say))
        connection = held.enter_context(closing(build_connection(name, settings)))
        building, clock = LiveBuilding(connection, rules, step_s), WallClock()
        sets = set_by(connection, name, settings)
        book = CommissioningBook(
            out / "commission.json", {"map": rules.model_dump(mode="json"), "connection": settings}
        )
        notes = [book.begun_anew] if book.begun_anew else []
        if book.under_way:
            notes.append(_of_under_way(book, out) if dry_run else _restored(building, book, sets))
        found = _read(building, rules, wait_s, say)
        _show(found, say)
        keys = [building.key(one) for one in building.names]
        plans = planned_trials(
            building, found.points, found.bounds_C, building.held(keys), None if hold_min is None else 60.0 * hold_min
        )
        files = _files(config, map_file, out, model or _model_here(), control_out, name, settings, connection)
        refused = ""
        if found.problems:
            say("Nothing is tried before this is mended")
        elif dry_run:
            for plan in plans:
                say(f"Would try {plan.in_words}")
        else:
            refused = _try(building, rules, plans, book, sets, (name, settings), out, grace_s, yes, again, say)
        report = CommissioningReport(
            clock.now().tz_convert(rules.time.zone or "UTC"), found, tuple(plans), book.trials,
            tuple(stages(found, plans, book, files)), tuple(notes),
        )  # fmt: skip
        for note in notes:
            say(note)
        for stage in report.stages:
            say(f"{stage.name:8} {stage.status:6} {stage.words}")
            if stage.command and stage.status in ("next", "mend"):
                say(f"         {stage.command}")
        if not dry_run:
            write_whole(out / "report.md", report.to_markdown())
            say(f"Report: {out / 'report.md'}")
        if json_file is not None:
            write_json(json_file, report.to_json(), follow=True)
    if refused:
        raise ConfigError(refused)
    if not report.is_well:
        raise SystemExit(1)


def _try(
    building: LiveBuilding,
    rules: MeasurementMap,
    plans: list[TrialPlan],
    book: CommissioningBook,
    sets: Sets,
    connection: tuple[str, dict[str, Any]],
    out: Path,
    grace_s: float,
    yes: bool,
    again: bool,
    say: Callable[[str], None],
) -> str:
    """Try what is not tried yet and is said yes to; what keeps it from that, '' where nothing does."""
    from thermoforce_mpc.live import WallClock
    from thermoforce_mpc.live.trial import tried
    from thermoforce_mpc.measurements.points import read_points

    clock = WallClock()
    for plan in plans:
        known = book.trials.get(plan.key)
        if known is not None and known.is_done and not again:
            say(f"Tried before: {known.key}: {known.words}")
            continue
        if plan.refused:
            say(plan.in_words)
            continue
        if not yes and not sys.stdin.isatty():
            return (
                "trials: nobody is here to say yes: give --yes, or start it in a terminal; --dry-run says what is tried"
            )
        if not yes and not click.confirm(f"Set {plan.in_words}?"):
            say(f"{plan.key}: not tried")
            continue
        say(f"Trying {plan.in_words}")
        book.begin(plan, clock.now())
        try:
            outcome = tried(
                building,
                plan,
                read=lambda now: read_points(building.table(), rules, now),
                clock=clock,
                sets=sets,
                connection=connection,
                log=out / "watchdog.jsonl",
                grace_s=grace_s,
                say=say,
            )
        except PlantError:  # it could not be put back
            raise
        except BaseException:  # Ctrl-C, or another controller's building: it is as it was
            book.end(None)
            raise
        book.end(outcome)
        say(f"{outcome.key}: {outcome.words}")
        for doubt in outcome.doubts:
            say(f"  look: {doubt}")
    return ""


def _of_under_way(book: CommissioningBook, out: Path) -> str:
    """What is known of a trial that was begun."""
    from thermoforce_mpc.records.run_folder import in_use

    what = f"the trial of {book.under_way.get('key')} at {book.under_way.get('at')}"
    if in_use(out):
        return f"{what} is under way, by another process"
    return f"{what} was not ended: it is put back at the next start without --dry-run"


def _restored(building: LiveBuilding, book: CommissioningBook, sets: Sets) -> str:
    """Put back what a trial set that was not ended (the machine stood, say); what was done."""
    from thermoforce_mpc.connections.sole import sole_control
    from thermoforce_mpc.live.trial import put_back

    was = book.under_way
    what = f"the trial of {was.get('key')} at {was.get('at')} was not ended"
    try:
        near = None if was.get("near") is None else float(was["near"])
        key, name = str(was["key"]), str(was["actuator"])
        with sole_control(sets):
            done = put_back(building, key, name, (float(was["value"]),), float(was["before"]), near)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{what}, and commission.json does not say what it was: set it back by hand, and remove the file"
        ) from error
    book.end(None)
    return f"{what}: {done}"


def _read(building: LiveBuilding, rules: MeasurementMap, wait_s: float, say: Callable[[str], None]) -> PointsFound:
    """The points; of a connection that only hears what is sent, when all came or, at most, `wait_s` s are over.

    Raises `NoConnection` at once, and `PlantError` where it does not answer in that time.
    """
    from thermoforce_mpc.live import WallClock
    from thermoforce_mpc.live.commissioning import read_house

    clock, until, said = WallClock(), time.monotonic() + wait_s, False
    hears = getattr(building.connection, "begin", None)
    while True:
        begins = time.monotonic()
        try:
            found = read_house(building, rules, clock.now())
            # What stands in a record from before says what was then.
            missing = [
                point.key for point in found.points
                if not point.values.size or (point.every_s <= wait_s and point.age_s > _LATE * point.every_s)
            ]  # fmt: skip
            problem: Exception | None = None
        except NoConnection:
            raise
        except (PlantError, InputError) as error:
            missing, problem = ["points"], error
        lasted_s = time.monotonic() - begins  # of an attempt, as the next one may
        if hears is None or not missing or time.monotonic() + LOOK_S + lasted_s > until:
            if problem is not None:
                raise problem
            return found
        if not said:
            said = True
            say(f"Waits up to {wait_s:.0f} s for {', '.join(missing)}{f': {problem}' if problem else ''}")
        time.sleep(LOOK_S)


def _show(found: PointsFound, say: Callable[[str], None]) -> None:
    from rich.console import Console

    from thermoforce_mpc.live.commissioning import rows_of
    from thermoforce_mpc.report.whole_tables import plain_table, print_whole

    table = plain_table(("point", "column", "now", "age", "range of a day", ""), "Points")
    for row in rows_of(found.points):
        table.add_row(*row)
    print_whole(table, Console())
    for title, texts in (("wrong", found.problems), ("look", found.doubts)):
        for text in texts:
            say(f"  {title}: {text}")


def _files(
    config: str, map_file: Path, out: Path, model: str, control_out: str, name: str, settings: Mapping[str, Any],
    connection: Any,
) -> CommissioningFiles:  # fmt: skip
    from thermoforce_mpc.live.commissioning import CommissioningFiles

    table = {"files": settings.get("measurements", "house.csv"), "mqtt": settings.get("record", "mqtt.csv")}
    return CommissioningFiles(
        config, str(map_file), str(out), model, control_out, str(table.get(name, "house.csv")),
        has_history=hasattr(connection, "history"), records=hasattr(connection, "begin"),
    )  # fmt: skip


def _model_here() -> str:
    """The one folder here that holds a model; else what the pages call it."""
    from thermoforce_mpc.model.saved import JSON_NAME

    found = sorted(Path().glob(f"*/{JSON_NAME}"))
    return str(found[0].parent) if len(found) == 1 else USUAL_MODEL


def _step_s(rules: MeasurementMap) -> float:
    """The step of the map, s, by default a quarter of an hour."""
    import pandas as pd

    return 900.0 if rules.step is None else float(pd.Timedelta(rules.step).total_seconds())
