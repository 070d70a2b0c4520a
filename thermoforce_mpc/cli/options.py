"""Options shared by several commands, and their conversion to a scenario."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from thermoforce_mpc.execution import DaskEngine, LocalEngine
    from thermoforce_mpc.scenario.scenario import Scenario

Function = Callable[..., Any]
# Opens the engine that a user asked for; told what is to be said.
Opening = Callable[[Callable[[str], None]], "LocalEngine | DaskEngine"]


class FiniteRange(click.FloatRange):
    """A number in a range. Of click's own, NaN is in every range and infinity in those without an end."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """`value` as a number of the range; refused where it is NaN or infinite."""
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


base_options = added(
    click.option("--testcase", metavar="NAME", help="Test case: a name (see `tf-mpc testcases`) or YAML file."),
    click.option("--config", metavar="FILE", help="Scenario to start from: a YAML file or a shipped name."),
    click.option("--days", type=float, help="Scored days.  [default: 14]"),
    click.option("--url", metavar="URL", help="Use the BOPTEST service at URL instead of the emulator."),
    click.option("--fmu", metavar="FILE", help="Use the test case's wrapped.fmu instead of the emulator."),
    click.option("--weather", metavar="FILE", help="'synthetic', or a .mos or .epw file (emulator only)."),
    click.option("--seed", type=int, help="Seed of probing, training and forecast errors."),
    click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any scenario key."),
)
"""Options that select building and plant, for one run and for many."""

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
"""Options that select one window, tariff and level of forecast errors."""

probed_option = click.option(
    "--probing",
    type=click.Path(path_type=Path),
    help="Run folder whose probing is taken instead of probing, or one of its journals probing/*.jsonl.",
)
learned_options = added(
    click.option("--model", type=click.Path(path_type=Path), help="Saved model to use instead of probing first."),
    probed_option,
)
"""Options that say where a model comes from."""


_UNIT_H = {"h": 1.0, "d": 24.0, "min": 1 / 60}


def _hours(context: click.Context, option: click.Parameter, text: str | None) -> float | None:
    """A length of time in h from `24h`, `2d` or `24`."""
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
        help="Free response or forecaster by name (see `tf-mpc free-responses`), a folder, or a hub's owner/model.",
    ),
)
"""What people change most in an MPC, options of the controller by names of their own."""


def _forecaster(name: str) -> dict[str, Any]:
    """Keys of a free response, or of a backbone by name, directory or hub name; refuses what can be none of these."""
    from thermoforce_mpc.errors import ConfigError, suggestion
    from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as BACKBONES
    from thermoforce_mpc.model.free_response.registry import REGISTRY

    if name in REGISTRY:
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
    """Add `--jobs` (and its `former` names) and `--scheduler`: where many tasks are run.

    The command gets them as `engine`, which opens it: `with engine(say) as where: …`, see `open_engine`.
    Why nothing goes on is told on stderr, also where `say` is silent.
    """

    def add(function: Function) -> Function:
        @functools.wraps(function)
        def command(*args: Any, jobs: int | None, scheduler: str | None, **options: Any) -> Any:
            from thermoforce_mpc.execution import open_engine

            warn = functools.partial(click.echo, err=True)
            return function(*args, engine=functools.partial(open_engine, jobs, scheduler, warn=warn), **options)

        at = click.option(
            "--scheduler",
            metavar="ADDRESS",
            help="Run on the workers of this Dask scheduler, such as tcp://host:8786 (extra [fleet]).",
        )
        n = click.IntRange(min=1)
        return click.option("--jobs", *former, "jobs", type=n, help="Parallel processes.  [default: one per core]")(
            at(command)
        )

    return add


measured_model_options = added(
    click.option("--model", required=True, type=click.Path(path_type=Path), help="Model folder of `tf-mpc identify`."),
    click.option("--data", "files", required=True, multiple=True, metavar="FILE", help="Measurements; repeatable."),
    click.option("--map", "map_file", required=True, type=click.Path(path_type=Path), help="Map of the measurements."),
)
"""A saved model, and what was measured there (as `files` and `map_file`)."""


def course_options(level: str) -> Callable[[Function], Function]:
    """Add the levels to ask about, `--level` (`level`: its help) or `--schedule`, and where the course goes to,
    `--out` (.csv or .json) and `--plot`.
    """

    return added(
        click.option("--level", type=float, help=level),
        click.option(
            "--schedule", type=click.Path(path_type=Path), help="CSV with columns time and u (or one per actuator)."
        ),
        out_option("the course"),
        plot_option(),
    )


def out_option(what: str) -> Callable[[Function], Function]:
    """Option `--out`, refused before the work where the name says no format that we write."""
    file = click.Path(path_type=Path, dir_okay=False)
    return click.option("--out", type=file, callback=_csv_or_json, help=f"Write {what}: .csv or .json.")


def plot_option(default: Path | None = None, of: str = "") -> Callable[[Function], Function]:
    """Option `--plot`, refused before the work where the name says no format that we draw."""
    return click.option(
        "--plot",
        type=click.Path(path_type=Path, dir_okay=False),
        callback=_png_or_svg,
        default=default,
        show_default=default is not None,
        help=f"Picture{of and ' of '}{of}: .png or .svg.",
    )


def _png_or_svg(context: click.Context, option: click.Parameter, plot: Path | None) -> Path | None:
    if plot is not None and plot.suffix not in (".png", ".svg"):
        raise click.BadParameter(f"{plot}: end the name in .png or .svg")
    return plot


def _csv_or_json(context: click.Context, option: click.Parameter, out: Path | None) -> Path | None:
    if out is not None and out.suffix not in (".csv", ".json"):
        raise click.BadParameter(f"{out}: end the name in .csv or .json")
    return out


# Keys of a scenario by option.
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


def scenario_from(options: dict[str, Any], defaults: Mapping[str, Any] | None = None) -> Scenario:
    """Build the scenario of a command from its file, `defaults`, its options and `--set`; later ones take precedence.

    Raises:
        ConfigError: a value is wrong; names the file or option, the key and the allowed values.
    """
    from thermoforce_mpc.plants.testcases import load_scenario
    from thermoforce_mpc.scenario.settings import find_config, merge, nested, parse_overrides

    for one, other, what in (("period", "start", "both name the window"), ("url", "fmu", "select different plants")):
        if options.get(one) is not None and options.get(other) is not None:
            raise click.UsageError(f"--{one} and --{other} {what}: give one of them")
    keys: dict[str, Any] = {}
    for option, key in _KEYS.items():
        if (value := options.get(option)) is not None:
            keys = merge(keys, nested(key, str(value) if isinstance(value, Path) else value))
    if options.get("url") is not None:
        keys = merge(keys, {"plant": {"kind": "boptest", "path": None}})
    if options.get("fmu") is not None:
        keys = merge(keys, {"plant": {"kind": "fmu"}})
    if options.get("forecaster") is not None:
        keys = merge(keys, {"controller": {"options": {"free_response": _forecaster(options["forecaster"])}}})
    if options.get("baselines") is not None:
        keys["baselines"] = [name.strip() for name in options["baselines"].split(",") if name.strip()]
    path: Path | None = find_config("scenarios", options["config"]) if options.get("config") else None
    keys = merge(keys, parse_overrides(options.get("assignments", ())))
    given = merge(defaults or {}, keys)
    if path is None and "testcase" not in given:
        raise click.UsageError("no test case: give --testcase NAME or --config FILE (see `tf-mpc testcases`)")
    scenario = load_scenario(path, given)
    if "url" in keys.get("plant", ()):
        from thermoforce_mpc.plants.boptest.token import allow_token

        allow_token(scenario.plant.url)
    return scenario
