"""Commands of `tf-mpc bench` that run controllers on buildings."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.cli.options import FILE, FOLDER, JSON, KEEP, NEW_FOLDER, QUICK, say
from benchmarks.cli.show import show
from benchmarks.detectors import KEPT
from thermoforce_mpc.cli.options import FiniteRange, Opening, execution_options
from thermoforce_mpc.comparison.cells import comma_list
from thermoforce_mpc.errors import ConfigError


@click.command("buildings")
@click.option("--houses", type=click.IntRange(1), default=40, show_default=True, help="Number of generated houses.")
@click.option("--offices", type=click.IntRange(0), default=6, show_default=True, help="Number of random offices.")
@click.option("--seed", type=click.IntRange(0), default=2026, show_default=True, help="Seed of the population.")
@execution_options()
@click.option(
    "--out",
    type=NEW_FOLDER,
    help="Folder for a plot of each window and outcomes.json with every figure.",
)
@KEEP
@QUICK
@JSON
def buildings_command(
    houses: int,
    offices: int,
    seed: int,
    engine: Opening,
    out: Path | None,
    keep: Path | None,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Run the default configuration on generated houses, against a thermostat and the houses' own control.

    Two weeks a house: the coldest and a sunny one in spring. Offices follow, beside thermostats that are off at night.
    Costs in EUR/m² and discomfort in K·h of the week.
    """
    from benchmarks.closed_loop.buildings import run_buildings_bench

    with engine(say) as where:
        result = run_buildings_bench(
            houses=houses, offices=offices, seed=seed, engine=where, quick=quick, out=out, keep=keep, progress=say
        )
    show(result, json_file)


@click.command("boptest")
@click.option("--fmus", required=True, type=FOLDER, help="Folder with FMUs of test cases, NAME.fmu.")
@click.option(
    "--price",
    type=click.Choice(["constant", "dynamic", "highly_dynamic"]),
    default="constant",
    show_default=True,
    help="Tariff.",
)
@execution_options()
@QUICK
@JSON
def boptest_command(fmus: Path, price: str, engine: Opening, quick: bool, json_file: Path | None) -> None:
    """Run the default configuration on test cases from their FMUs, over all their scenarios, beside native control.

    Cost per m² in the test case's currency and discomfort in K·h of two weeks (extra [fmu]).
    """
    from benchmarks.closed_loop.boptest import run_boptest_bench

    with engine(say) as where:
        show(run_boptest_bench(fmus, price=price, engine=where, quick=quick, progress=say), json_file)


@click.command("worth")
@click.option("--windows", default="16,44,108", show_default=True, help="Start days of the heat pump case.")
@click.option("--houses", type=click.IntRange(0), default=4, show_default=True, help="Number of generated houses.")
@click.option("--days", type=FiniteRange(0, min_open=True), default=7.0, show_default=True, help="Days a window.")
@click.option("--history", default="1,3", show_default=True, help="Days of history that the controller gets.")
@click.option("--free-responses", default="", help="Further ones, comma-separated: NAME or NAME:BACKBONE.")
@click.option(
    "--uncertainty",
    type=click.Choice(["none", "low", "medium", "high"]),
    default="none",
    show_default=True,
    help="Weather forecast errors of the heat pump case.",
)
@KEEP
@execution_options()
@JSON
def worth_command(
    windows: str,
    houses: int,
    days: float,
    history: str,
    free_responses: str,
    uncertainty: str,
    keep: Path | None,
    engine: Opening,
    json_file: Path | None,
) -> None:
    """Run free responses in closed loop, in houses with people, between linear weather and the true future.

    Cost per m² and discomfort in K·h of a window, and the share of the oracle's gain over linear weather.
    """
    from benchmarks.closed_loop.worth import run_worth_bench

    try:
        days_of_history = [int(number) for number in comma_list(history, "--history")]
    except ValueError as error:
        raise ConfigError(f"--history {history}: expected whole days separated by commas, such as 1,3") from error
    if min(days_of_history) < 1:
        raise ConfigError(f"--history {history}: a day at least")
    with engine(say) as where:
        result = run_worth_bench(
            windows=comma_list(windows, "--windows"),
            houses=houses,
            days=days,
            history_d=days_of_history,
            methods=comma_list(free_responses, "--free-responses") if free_responses else (),
            uncertainty=uncertainty,
            engine=where,
            keep=keep,
            progress=say,
        )
    show(result, json_file)


@click.command("zones")
@click.option("--fmus", type=FOLDER, help="Folder with twozone_apartment_hydronic.fmu; without it, it is left out.")
@execution_options()
@click.option("--only-speed", is_flag=True, help="Time a step alone, without buildings.")
@QUICK
@JSON
def zones_command(fmus: Path | None, engine: Opening, only_speed: bool, quick: bool, json_file: Path | None) -> None:
    """Run the default configuration on buildings of several zones, and time a step over the number of zones.

    Five zones are solved in do-mpc too (extra [bench]).
    """
    from benchmarks.zones.bench import run_zones_bench

    with engine(say) as where:
        result = run_zones_bench(fmus=fmus, engine=where, quick=quick, only_speed=only_speed, progress=say)
    show(result, json_file)


@click.command("faults")
@click.option("--stand-back", type=click.Choice(["native", "rule"]), default="native", help="Who acts after an alarm.")
@QUICK
@JSON
def faults_command(stand_back: str, quick: bool, json_file: Path | None) -> None:
    """Measure how soon the watch notices faults of the embedded plant that last a day, and what they cost."""
    from benchmarks.faults.bench import run_faults_bench

    show(run_faults_bench(quick=quick, progress=say, stand_back=stand_back), json_file)


@click.command("fallback")
@QUICK
@JSON
def fallback_command(quick: bool, json_file: Path | None) -> None:
    """Measure what broken sensors, forecasts and solvers cost on the embedded plant, with protection and without."""
    from benchmarks.faults.fallback import run_fallback_bench

    show(run_fallback_bench(quick=quick, progress=say), json_file)


@click.command("detectors")
@click.option("--weeks", type=click.IntRange(0), help="House-weeks of clean plants.  [default: 200, with --only 0]")
@click.option("--faults", type=click.IntRange(0), help="Plants with each fault.  [default: 4]")
@click.option("--seed", type=click.IntRange(0), help="Seed of the plants that are drawn.  [default: 62]")
@click.option("--only", multiple=True, metavar="NAME", help="Faults whose names begin so; repeatable.")
@click.option(
    "--against",
    type=FILE,
    is_flag=False,
    flag_value=KEPT,
    help="JSON of an earlier run: tell the weeks of the same kind, number, seed and fault that got dearer by more than "
    "0.3 %, less comfortable by 0.1 K·h, have more steps without a plan, or fail. Without a file: "
    "benchmarks/detectors/weeks.json. Without --weeks, --faults and --seed: all weeks of that run, and one of each "
    "fault that is new in the panel since.",
)
@KEEP
@execution_options()
@QUICK
@JSON
def detectors_command(
    weeks: int | None,
    faults: int | None,
    seed: int | None,
    only: tuple[str, ...],
    against: Path | None,
    keep: Path | None,
    engine: Opening,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Count what each rule claims of clean plants and what that costs, what it finds of its fault and saves.

    Rules that change what the controller does because of what it believes of the plant: sun on a sensor, blocked hours,
    other loads on meters, watch, gate, guard, sensors, units, open windows. Plants: the embedded house in four seasons,
    generated houses, air units that heat and cool, offices and houses of rooms; each week probed, identified and
    controlled with all defaults, and again without a rule that claimed something. A week takes about half a minute of a
    core.

    \b
    Example:
      tf-mpc bench detectors --weeks 24 --faults 1 --jobs 2 --keep runs/detectors --json detectors.json
      tf-mpc bench detectors --only meters --only guard --faults 6 --seed 7
      tf-mpc bench detectors --against --jobs 2
    """
    from benchmarks.detectors.bench import run_detectors_bench

    with engine(say) as where:
        result = run_detectors_bench(
            weeks=weeks,
            faults=faults,
            seed=seed,
            only=only,
            engine=where,
            quick=quick,
            against=against,
            keep=keep,
            progress=say,
        )
    show(result, json_file)


@click.command("commands")
@click.option("--seed", type=click.IntRange(0), default=100, show_default=True, help="Seed of the first house.")
@click.option("--houses", type=click.IntRange(1), default=6, show_default=True, help="Houses.")
@click.option("--days", type=click.IntRange(1, 21), default=14, show_default=True, help="Cold days under control.")
@click.option(
    "--kinds", multiple=True, help="How the houses are set; repeatable.  [default: the first three]",
    type=click.Choice(
        ["set-points", "curve offset", "SG-Ready", "flow temperature", "enable", "set-point of the house"]
    ),
)  # fmt: skip
@KEEP
@execution_options()
@QUICK
@JSON
def commands_command(
    seed: int,
    houses: int,
    days: int,
    kinds: tuple[str, ...],
    keep: Path | None,
    engine: Opening,
    quick: bool,
    json_file: Path | None,
) -> None:
    """Control houses that only take commands, such as set-points or SG-Ready, and compare with left alone.

    Houses of rooms, each with a heat pump behind its own controller (curve, hysteresis, minimum times, defrosting, hot
    water): 27 ordinary days, three of polite trials, then cold days both ways at a day-ahead price.

    \b
    Example:
      tf-mpc bench commands --seed 100 --houses 6 --days 7 --jobs 2
    """
    from benchmarks.commands.bench import USUAL_KINDS, run_commands_bench

    with engine(say) as where:
        found = run_commands_bench(
            engine=where,
            houses=houses,
            seed=seed,
            days=days,
            kinds=kinds or USUAL_KINDS,
            quick=quick,
            keep=keep,
            progress=say,
        )
    show(found, json_file)


@click.command("hot-water")
@click.option("--seed", type=click.IntRange(0), default=300, show_default=True, help="Seed of the first house.")
@click.option("--houses", type=click.IntRange(1), default=4, show_default=True, help="Houses.")
@click.option("--days", type=click.IntRange(1, 21), default=3, show_default=True, help="Cold days under control.")
@click.option("--rooms/--tank-only", default=True, show_default=True, help="Also with set-points of the rooms planned.")
@execution_options()
@QUICK
@JSON
def hot_water_command(
    seed: int, houses: int, days: int, rooms: bool, engine: Opening, quick: bool, json_file: Path | None
) -> None:
    """Plan the tank of houses whose heat pump heats it or the rooms, and compare with the device's own control.

    Houses of `bench commands` that take set-points. What the tank is is learned from 28 days of its temperature and the
    one meter; then the same days left alone, with the target of the tank planned, and with the rooms planned too.

    \b
    Example:
      tf-mpc bench hot-water --seed 300 --houses 4 --days 3 --jobs 2
    """
    from benchmarks.commands.tank import run_tank_bench

    with engine(say) as where:
        found = run_tank_bench(
            engine=where, houses=houses, seed=seed, days=days, rooms=rooms, quick=quick, progress=say
        )
    show(found, json_file)


@click.command("mqtt")
@click.option("--seed", type=click.IntRange(0), default=100, show_default=True, help="Seed of the house.")
@click.option("--days", type=click.IntRange(2, 21), default=14, show_default=True, help="Days, one of them in shadow.")
@click.option(
    "--by", "kinds", multiple=True, type=click.Choice(["set-points", "curve offset", "SG-Ready"]),
    help="How the house is set; repeatable.  [default: all three]",
)  # fmt: skip
@click.option("--only-faults", is_flag=True, help="Without days behind a broker at which nothing fails.")
@QUICK
@JSON
def mqtt_command(
    seed: int, days: int, kinds: tuple[str, ...], only_faults: bool, quick: bool, json_file: Path | None
) -> None:
    """Put houses behind a real MQTT broker (mosquitto, on loopback), at speed, and let things fail around them.

    A house behind its heat pump's own controller is commissioned, shadowed for a day and controlled: in process, behind
    the broker, and behind it while the broker is restarted, the network cut for an hour, readings unavailable for an
    hour, the record torn, the clock stepped by a minute and the controller killed. Costs and discomfort are compared,
    and what the device was told is judged: nothing out of range, twice, late or kept by the broker at the end.

    \b
    Example:
      tf-mpc bench mqtt --days 14 --by SG-Ready
    """
    from benchmarks.chaos.over_mqtt import run_over_mqtt

    named = {"kinds": kinds} if kinds else {}
    found = run_over_mqtt(seed=seed, days=days, quick=quick, only_faults=only_faults, progress=say, **named)
    show(found, json_file)


@click.command("contest")
@click.argument("contest", type=click.Choice(["feedback", "modulation", "policies"]))
@click.option("--houses", type=click.IntRange(0), default=30, show_default=True, help="Number of generated houses.")
@click.option("--seed", type=click.IntRange(0), default=66, show_default=True, help="Seed of the population.")
@click.option("--windows", default="16,44,108", show_default=True, help="Start days of the heat pump case.")
@click.option("--weather", type=FILE, help="Its weather.")
@click.option("--days", type=FiniteRange(0, min_open=True), default=7.0, show_default=True, help="Days a window.")
@KEEP
@execution_options()
@JSON
def contest_command(
    contest: str,
    houses: int,
    seed: int,
    windows: str,
    weather: Path | None,
    days: float,
    keep: Path | None,
    engine: Opening,
    json_file: Path | None,
) -> None:
    """Judge a choice on drawn houses and windows of the heat pump case: cost, discomfort and both, beside the default.

    \b
    feedback     the gain sees the predicted temperature
    modulation   the gain is kept if it helps, always, or never
    policies     dpc, PPO (trained on the building itself; extra [rl]) and a thermostat
    """
    from benchmarks.closed_loop.contest import run_contest

    if not houses and not windows:
        raise ConfigError("--houses 0 and no --windows: no building is left to judge on; give either")
    with engine(say) as where:
        result = run_contest(
            contest,
            houses=houses,
            seed=seed,
            days=days,
            windows=comma_list(windows, "--windows") if windows else (),
            weather=weather,
            engine=where,
            keep=keep,
            progress=say,
        )
    show(result, json_file)
