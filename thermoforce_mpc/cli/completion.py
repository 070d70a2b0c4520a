"""What TAB completes in the place of a value. Nothing is loaded of what the names stand for: TAB is to be quick.

That the names are those of the registries is tested (tests/cli/test_completion.py); those of plugins are read where
they are announced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from thermoforce_mpc.files import named_configs

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

CONTROLLERS = ("thermoforce_mpc", "thermoforce_paper", "rc_mpc", "rc_mpc_paper", "dpc", "thermostat", "pi", "native")
FREE_RESPONSES = ("residual", "chronos", "linear_weather", "rc", "persistence")
BACKBONES = (
    "shipped", "shipped_weather", "fracast", "chronos-bolt-tiny", "chronos-bolt-mini", "chronos-bolt-small",
    "chronos-bolt-base", "chronos-2-small", "chronos-2", "tirex-2", "timesfm", "timesfm-3", "toto-2", "ttm",
    "flowstate",
)  # fmt: skip
PLANTS = (
    "emulator", "bestest_hydronic", "bestest_air", "rooms", "generated", "energyplus", "small_office", "boptest", "fmu",
)  # fmt: skip
CONNECTIONS = ("files", "home-assistant", "mqtt")
MADE_TESTCASES = ("house", "office", "generated")
PERIODS = (
    "peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day", "cold_week",
    "sunny_week",
)  # fmt: skip
PRICES = ("constant", "dynamic", "highly_dynamic")
UNCERTAINTIES = ("none", "low", "medium", "high")
SOLVERS = ("auto", "ipopt", "qp", "sqp", "milp")
SCHEMAS = ("scenario", "testcase", "comparison", "fleet", "map")
# Files of which a folder that holds one is a run's.
_OF_RUNS = ("journal.jsonl", "manifest.json")
_RUNS = Path("runs")

Names = Callable[[], Iterable[str]]


def _testcases() -> list[str]:
    names = [name.replace("energyplus_", "energyplus:", 1) for name in named_configs("testcases")]
    return [*names, *(f"{name}:" for name in _with_plugins("testcases", MADE_TESTCASES))]


def _with_plugins(group: str, own: Iterable[str]) -> list[str]:
    from thermoforce_mpc.registry import PREFIX, announced

    return list(dict.fromkeys([*own, *announced(f"{PREFIX}.{group}")]))


def _forecasters() -> list[str]:
    return [*_with_plugins("free_responses", FREE_RESPONSES), *_with_plugins("backbones", BACKBONES)]


def _runs(typed: str) -> Iterator[str]:
    """Run folders in the folder that was typed so far, or where nothing was, those of `tf-mpc run` too."""
    folder, dash, name = typed.rpartition("/")
    places = [(Path(folder + dash), folder + dash)]
    if not typed:
        places.append((_RUNS, "runs/"))
    for place, before in places:
        try:
            below = sorted(place.iterdir())
        except OSError:
            continue
        for path in below:
            if path.name.startswith(name) and any((path / file).is_file() for file in _OF_RUNS):
                yield before + path.name


_controllers, _fleets = partial(_with_plugins, "controllers", CONTROLLERS), partial(named_configs, "fleets")
# Names by option or argument; of a command alone by both.
_NAMES: dict[str | tuple[str, str], Names] = {
    "testcase": _testcases,
    "config": partial(named_configs, "scenarios"),
    "variants": partial(named_configs, "comparisons"),
    "fleet": _fleets,
    "plant": partial(_with_plugins, "plants", PLANTS),
    "connection": partial(_with_plugins, "connections", CONNECTIONS),
    "forecaster": _forecasters,
    "kind": lambda: SCHEMAS,
    "solver": lambda: SOLVERS,
    **dict.fromkeys(("controller", "varied", "controllers", "baselines", "beside"), _controllers),
    **dict.fromkeys(("period", "windows"), lambda: PERIODS),
    **dict.fromkeys(("price", "tariffs"), lambda: PRICES),
    **dict.fromkeys(("uncertainty", "forecast_uncertainty"), lambda: UNCERTAINTIES),
    ("controllers", "name"): _controllers,
    ("plants", "name"): partial(_with_plugins, "plants", PLANTS),
    ("connections", "name"): partial(_with_plugins, "connections", CONNECTIONS),
    ("free-responses", "name"): _forecasters,
}  # fmt: skip
_LIST, _FILE, _RUN_FOLDERS = "A,B", "FILE", ("run", "probing")

Completing = Callable[[click.Context, click.Parameter, str], "list[CompletionItem]"]


def completing(command: str, parameter: click.Parameter) -> Completing | None:
    """What completes the values of a parameter of a command; None where click's own way does."""
    name, metavar = str(parameter.name), parameter.metavar or ""
    if name in _RUN_FOLDERS and isinstance(parameter.type, click.Path):
        return _run_folders
    if not isinstance(parameter.type, click.types.StringParamType):
        return None
    names = _NAMES.get((command, name)) or _NAMES.get(name)
    file = _FILE in metavar or name in ("testcase", "fleet")
    if names is None and not file:
        return None

    def complete(context: click.Context, option: click.Parameter, typed: str) -> list[CompletionItem]:
        before, comma, last = typed.rpartition(",") if metavar == _LIST else ("", "", typed)
        found = [] if names is None else [one for one in names() if one.startswith(last)]
        return _items([before + comma + one for one in found], typed if file else None)

    return complete


def _run_folders(context: click.Context, option: click.Parameter, typed: str) -> list[CompletionItem]:
    return _items(_runs(typed), typed)


def _items(values: Iterable[str], file: str | None) -> list[CompletionItem]:
    """The values; where there are none, what the shell finds among files for `file`."""
    from click.shell_completion import CompletionItem

    items = [CompletionItem(value) for value in values]
    return items if items or file is None else [CompletionItem(file, type="file")]
