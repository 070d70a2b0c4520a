"""Options shared by several commands, and their conversion to a scenario."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from thermoforce_mpc.commands.tank import LearnedTank
    from thermoforce_mpc.execution import DaskEngine, LocalEngine
    from thermoforce_mpc.measurements.map.mapping import MeasurementMap
    from thermoforce_mpc.scenario.scenario import Scenario

Function = Callable[..., Any]
PATH = click.Path(path_type=Path)
# Opens the engine that a user asked for; told what is to be said.
Opening = Callable[[Callable[[str], None]], "LocalEngine | DaskEngine"]


class FiniteRange(click.FloatRange):
    """A finite number in a range. Of click's own, NaN is in every range and infinity in those without an end."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """`value` as a number of the range."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is no number that can be used", param, ctx)
        return number


def added(*options: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Adds options, shown in this order; the command gets them as keyword arguments."""

    def add(function: Function) -> Function:
        for option in reversed(options):
            function = option(function)
        return function

    return add


code_option = click.option(
    "--code", metavar="FILE", multiple=True, help="Code (Python, policy, FMU) that a file given here names; repeatable."
)
base_options = added(
    click.option("--testcase", metavar="NAME", help="Test case: a name (see `tf-mpc testcases`) or YAML file."),
    click.option("--config", metavar="FILE", help="Scenario to start from: a YAML file or a shipped name."),
    click.option("--days", type=float, help="Scored days.  [default: 14]"),
    click.option("--url", metavar="URL", help="Use the BOPTEST service at URL instead of the emulator."),
    click.option("--fmu", metavar="FILE", help="Use the test case's wrapped.fmu instead of the emulator."),
    click.option("--weather", metavar="FILE", help="'synthetic', or a .mos or .epw file (emulator only)."),
    click.option("--seed", type=int, help="Seed of probing, training and forecast errors."),
    click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any scenario key."),
    code_option,
)
window_options = added(
    click.option(
        "--period",
        metavar="P",
        help="peak_heat_day, typical_heat_day, another window of the plant (peak_cool_day, mix_day, cold_week, ...).  "
        "[default: the peak of the building's season]",
    ),
    click.option("--start", metavar="DAY", help="First day instead, as 2026-01-17 or 44 (of the year)."),
    click.option("--price", metavar="TARIFF", help="constant, dynamic or highly_dynamic."),
    click.option("--prices", metavar="FILE", help="CSV (time s, price per kWh): highly dynamic tariff."),
    click.option(
        "--forecast-uncertainty",
        "uncertainty",
        metavar="LEVEL",
        help="BOPTEST's weather forecast errors: none, low, medium or high.",
    ),
)
probed_option = click.option(
    "--probing",
    type=PATH,
    help="Run folder whose probing is taken instead of probing, or one of its journals probing/*.jsonl.",
)
learned_options = added(
    click.option("--model", type=PATH, help="Saved model to use instead of probing first."), probed_option
)
_UNIT_H = {"h": 1.0, "d": 24.0, "min": 1 / 60}


def _hours(context: click.Context, option: click.Parameter, text: str | None) -> float | None:
    if text is None:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(h|d|min)?", text.strip())
    if match is None:
        raise click.BadParameter(f"'{text}': expected hours or days, such as 24h or 2d")
    return float(match[1]) * _UNIT_H[match[2] or "h"]


mpc_options = added(
    click.option("--horizon", "horizon_h", metavar="H", callback=_hours, help="Horizon, as 24h or 2d."),
    click.option(
        "--comfort-weight",
        type=FiniteRange(min=0, min_open=True),
        help="Cost of a K·h of discomfort per m² of floor, in the currency.  [default: 0.026]",
    ),
    click.option("--solver", metavar="NAME", help="auto, ipopt, qp, sqp or milp."),
    click.option(
        "--forecaster",
        metavar="NAME",
        help="Free response or forecaster by name (see `tf-mpc free-responses`), a folder, a hub's owner/model, or a "
        "class of yours, as my.py:Mine.",
    ),
)


class _Prices(click.Path):
    """A file of prices, or the name of a tariff of the simulated buildings."""

    name = "prices"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not Path(value).exists() and not Path(value).suffix:
            from thermoforce_mpc.scenario.building import PRICES

            if str(value) in PRICES:
                return Path(value)
            self.fail(f"'{value}' is neither a file nor a tariff; tariffs are {', '.join(PRICES)}", param, ctx)
        return super().convert(value, param, ctx)


own_prices_option = click.option(
    "--prices",
    metavar="FILE|TARIFF",
    type=_Prices(exists=True, dir_okay=False, path_type=Path),
    help="Instead of the map's prices: CSV (time, price per kWh; MWh or ct in the column's name), a bill (.yaml), or a "
    "tariff of the simulated buildings: constant, dynamic (two levels) or highly_dynamic (hourly, synthetic).",
)


def billed_objective(prices: Path | None, rules: MeasurementMap) -> dict[str, Any]:
    """Keys of the controller's objective that a bill in `--prices` and the map ask for.

    Generation and other loads count where the map has them in its forecast, or the bill pays for what is fed in.
    """
    from controllers.mpc.config import objective_of
    from thermoforce_mpc.errors import ConfigError
    from thermoforce_mpc.scenario.bill import SUFFIXES, read_bill

    others = rules.forecast.load is not None or rules.forecast.generation is not None
    keys: dict[str, Any] = {}
    if prices is not None and prices.suffix in SUFFIXES:
        bill = read_bill(prices)
        if bill.peak is not None and others and rules.meter is None:
            raise ConfigError(
                f"--prices {prices}: its peak is of all behind the meter, where the map has other loads or generation "
                "(forecast), but not what was read there so far: name the key meter, and forecast.load"
            )
        keys = objective_of(bill)
    return keys | {"at_the_meter": True} if others else keys


def currency_of_prices(prices: Path | None, rules: MeasurementMap) -> str:
    """The currency of what plans cost: that of a bill in `--prices`, else of the map; '' where neither says it."""
    from thermoforce_mpc.scenario.bill import SUFFIXES, read_bill

    billed = read_bill(prices).currency if prices is not None and prices.suffix in SUFFIXES else ""
    return billed or rules.currency


def _forecaster(name: str) -> dict[str, Any]:
    """Keys of a free response, or of a backbone by name, directory or hub name; refuses what can be none of these."""
    from thermoforce_mpc.errors import ConfigError, suggestion
    from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as BACKBONES
    from thermoforce_mpc.model.free_response.registry import REGISTRY
    from thermoforce_mpc.scenario.own_code import is_own_code

    if name in REGISTRY or is_own_code(name):
        return {"name": name}
    if name not in BACKBONES and "/" not in name and not Path(name).exists():
        raise ConfigError(
            f"--forecaster: unknown '{name}'{suggestion(name, (*REGISTRY.names, *BACKBONES.names))}; free responses: "
            f"{', '.join(REGISTRY.names)}; backbones: {', '.join(BACKBONES.names)}, a directory, or a hub name with '/'"
        )
    return {"options": {"backbone": name}}


equal_comfort_option = click.option(
    "--equal-comfort/--no-equal-comfort",
    default=None,
    help="Search the set-point at which the thermostat is as comfortable, in further runs of it.  "
    "[default: on the embedded plant]",
)


def execution_options(*former: str) -> Callable[[Function], Function]:
    """Add `--jobs` (and its `former` names) and `--scheduler`; the command gets them as `engine`, see `open_engine`.

    Why nothing goes on is told on stderr, also where the caller's `say` is silent.
    """

    def add(function: Function) -> Function:
        @functools.wraps(function)
        def command(*args: Any, jobs: int | None, scheduler: str | None, **options: Any) -> Any:
            from thermoforce_mpc.execution import open_engine

            warn = functools.partial(click.echo, err=True)
            return function(*args, engine=functools.partial(open_engine, jobs, scheduler, warn=warn), **options)

        n, one = click.IntRange(min=1), "Parallel processes.  [default: one per core]"
        at = "Run on the workers of this Dask scheduler, such as tcp://host:8786 (extra [fleet])."
        options = added(
            click.option("--jobs", *former, "jobs", type=n, help=one),
            click.option("--scheduler", metavar="ADDRESS", help=at),
        )
        return options(command)

    return add


model_option = click.option("--model", required=True, type=PATH, help="Model folder of `tf-mpc identify`.")
map_option = click.option("--map", "map_file", required=True, type=PATH, help="Map of the measurements.")
measured_options = added(
    click.option("--data", "files", required=True, multiple=True, metavar="FILE", help="Measurements; repeatable."),
    map_option,
)


def course_options(level: str) -> Callable[[Function], Function]:
    """Add the levels to ask about, `--level` (`level`: its help) or `--schedule`, and where the course goes to."""
    return added(
        click.option("--level", type=FiniteRange(-1.0, 1.0), help=level),
        click.option("--schedule", type=PATH, help="CSV with columns time and u (or one per actuator)."),
        out_option("the course"),
        plot_option(),
    )


class _FileOf(click.Path):
    """A file to write, refused before the work where it cannot be, or its name says no format that we write."""

    def __init__(self, *endings: str) -> None:
        super().__init__(path_type=Path, dir_okay=False)
        self._endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from thermoforce_mpc.files import check_writable

        path = Path(str(super().convert(value, param, ctx)))
        if path.suffix not in self._endings:
            self.fail(f"{path}: end the name in {' or '.join(self._endings)}", param, ctx)
        if param is None or path != param.default:
            check_writable(path)
        return path


def out_option(what: str) -> Callable[[Function], Function]:
    """Option `--out`."""
    return click.option("--out", type=_FileOf(".csv", ".json"), help=f"Write {what}: .csv or .json.")


def plot_option(default: Path | None = None, of: str = "") -> Callable[[Function], Function]:
    """Option `--plot`."""
    what = f"Picture{of and ' of '}{of}: .png or .svg."
    return click.option("--plot", type=_FileOf(".png", ".svg"), default=default, help=what)


# Keys of a scenario by option.
# Test cases whose plants need nothing beside the package.
_READY = "bestest_hydronic_heat_pump, bestest_hydronic, bestest_air, house:3rooms or generated:2026:0"
_KEYS = {
    **{name: name for name in ("testcase", "period", "days", "price", "seed", "equal_comfort")},
    "start": "period",
    "controller": "controller.name",
    "model": "identification.model",
    "probing": "identification.probed",
    "horizon_h": "controller.options.horizon_h",
    "solver": "controller.options.solver",
    "comfort_weight": "controller.options.objective.comfort_weight_per_m2",
    "url": "plant.url",
    "fmu": "plant.path",
    "weather": "plant.weather",
    "prices": "plant.prices_file",
    "uncertainty": "plant.forecast_uncertainty",
}


def check_named_code(
    files: Iterable[Mapping[str, Any]], words: Iterable[Mapping[str, Any]], code: Iterable[str], name: str
) -> None:
    """As `check_code`, of the keys of scenarios: `files`, of the file `name`, and `words`, of the command line."""
    from thermoforce_mpc.experiment.outside import check_code, code_of

    found = {one.value: one for keys in files for one in code_of(keys)}
    if found:
        check_code(found.values(), [*code, *(one.value for keys in words for one in code_of(keys))], name)


def _note_option(option: str, key: str) -> None:
    """Keep which option of the command gave a key, for the words of errors."""
    from thermoforce_mpc.cli.commands import NAMED_BY

    context = click.get_current_context(silent=True)
    if context is not None:
        flags = [param.opts[-1] for param in context.command.params if param.name == option]
        context.meta.setdefault(NAMED_BY, {}).update(dict.fromkeys([key], flags[0]) if flags else {})


def _options_of(given: Mapping[str, Any]) -> Iterable[str]:
    """Dotted keys of the options of the controller that is given, or the default one."""
    from controllers.registry import find_entry
    from thermoforce_mpc.errors import ConfigError
    from thermoforce_mpc.scenario.settings import all_keys

    controller = given.get("controller")
    name = controller.get("name") if isinstance(controller, Mapping) else controller
    try:
        config = find_entry(str(name or "thermoforce_mpc")).config()
    except ConfigError:  # a name that is not known is said by itself
        return ()
    return all_keys(config, "controller.options.")


def scenario_from(options: dict[str, Any], defaults: Mapping[str, Any] | None = None) -> Scenario:
    """Build the scenario of a command from its file, `defaults`, its options and `--set`; the last that says counts.

    Raises `ConfigError` too where the file or `defaults` name code that the command line does not, see `check_code`.
    """
    from thermoforce_mpc.plants.testcases import load_scenario
    from thermoforce_mpc.registry import names_in
    from thermoforce_mpc.scenario.settings import find_config, merge, nested, parse_overrides

    for one, other, what in (("period", "start", "both name the window"), ("url", "fmu", "select different plants")):
        if options.get(one) is not None and options.get(other) is not None:
            raise click.UsageError(f"--{one} and --{other} {what}: give one of them")
    keys: dict[str, Any] = {}
    for option, key in _KEYS.items():
        if (value := options.get(option)) is not None:
            _note_option(option, key)
            keys = merge(keys, nested(key, str(value) if isinstance(value, Path) else value))
    if options.get("url") is not None:
        keys = merge(keys, {"plant": {"kind": "boptest", "path": None}})
    if options.get("fmu") is not None:
        keys = merge(keys, {"plant": {"kind": "fmu"}})
    if options.get("forecaster") is not None:
        keys = merge(keys, {"controller": {"options": {"free_response": _forecaster(options["forecaster"])}}})
    if options.get("baselines") is not None:
        keys["baselines"] = list(names_in(options["baselines"]))
    path: Path | None = find_config("scenarios", options["config"]) if options.get("config") else None
    keys = merge(keys, parse_overrides(options.get("assignments", ())))
    given = merge(defaults or {}, keys)
    if path is None and "testcase" not in given:
        raise click.UsageError(
            f"no test case: give --testcase NAME or --config FILE; nothing else is needed for {_READY} (`tf-mpc "
            "testcases` lists all)"
        )
    scenario = load_scenario(path, given, functools.partial(_options_of, given))
    check_named_code([scenario.model_dump()], [keys], options.get("code", ()), str(path or options.get("variants")))
    if "url" in keys.get("plant", ()):
        from thermoforce_mpc.plants.boptest.plant import allow_token

        allow_token(scenario.plant.url)
    return scenario


def said_tank(learn: Callable[[], LearnedTank | None], say: Callable[[str], None]) -> LearnedTank | None:
    """The tank of hot water that `learn` finds, which is said; None without one, or where nothing tells what it is."""
    from thermoforce_mpc.errors import DataError

    try:
        tank = learn()
    except DataError as error:
        say(f"Hot water is left to the device, and plans do not count on its charges: {error}")
        return None
    if tank is not None:
        say(f"Hot water: {tank.in_words}")
    return tank
