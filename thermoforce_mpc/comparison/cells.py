"""Cells of a comparison: one variant on one window under one tariff and forecast error level, with its hash key."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from thermoforce_mpc.comparison.input_files import file_hashes, named_files
from thermoforce_mpc.comparison.variants import Variant, variant_scenario
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.keys import digest, source_fingerprint
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.identifying import IdentificationTask, SavedModel
from thermoforce_mpc.experiment.outside import python_of
from thermoforce_mpc.experiment.windows import check_windows
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.registry import plugin_sources
from thermoforce_mpc.scenario.own_code import is_policy, policy_settings
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario
from thermoforce_mpc.version import VERSION

# Increased whenever the cell file or the inputs of a result change, so that files of old formats are not reused.
FORMAT = 2
# What stands between a window and its seed in the name of one that is run with several.
SEED = ", seed "


@dataclass(frozen=True)
class Cell:
    """One run of a comparison: `scenario` determines its result, `key` is the hash of all its inputs. It travels to
    where it is run, is resolved there, and holds no more than what can travel.

    `task` is the identification it needs (None: no model, or a saved one) and `identification_key` its hash; cells with
    equal identification settings share one model. `trajectory`: whether its course is kept.
    """

    variant: str
    window: str
    price: str
    uncertainty: str
    scenario: Scenario
    key: str
    task: IdentificationTask | None
    identification_key: str | None
    needs_model: bool
    trajectory: bool = False

    @property
    def title(self) -> str:
        """Name of the cell in progress output."""
        return f"{self.variant} · {self.window} · {self.price}{self._forecasts}"

    @property
    def identification_title(self) -> str:
        """Name of its identification in progress output."""
        days = self.scenario.identification.days
        return f"identifying · {self.variant} · {self.window} · {days:g} days{self._forecasts}"

    @property
    def _forecasts(self) -> str:
        return "" if self.uncertainty == "none" else f" · {self.uncertainty} forecast error"

    @property
    def group(self) -> tuple[str, str, str]:
        """Window, tariff and forecast error level; cells of one group are compared with each other."""
        return self.window, self.price, self.uncertainty


def expand(
    base: Scenario,
    variants: Mapping[str, Variant],
    windows: Sequence[str],
    prices: Sequence[str],
    uncertainties: Sequence[str] = ("none",),
    inputs: Inputs | None = None,
    seeds: int = 1,
) -> list[Cell]:
    """All cells, validated; raises `ConfigError` naming the variant and the wrong key, or the window.

    `inputs`: hashes that several calls share. `seeds`: how many from the scenario's on; with several every window is
    one for each seed, named after both.
    """
    own = base.controller
    if own.options and own.name not in {variant.controller for variant in variants.values()}:
        raise ConfigError(
            f"controller.options: they are options of '{own.name}', and no variant has this controller; give options "
            "to the variants, or leave these out"
        )
    check_windows(windows, base.plant, load_testcase(base.testcase))
    inputs = inputs or Inputs()
    cells: list[Cell] = []
    several = range(base.seed, base.seed + seeds)
    for window, seed, price, uncertainty, (name, variant) in product(
        windows, several, prices, uncertainties, variants.items()
    ):
        seeded = base if seed == base.seed else base.model_copy(update={"seed": seed})
        try:
            cell = _cell(name, variant_scenario(seeded, variant, window, price, uncertainty), inputs)
        except ConfigError as error:
            raise ConfigError(f"variant '{name}': {error}") from error
        cells.append(cell if seeds == 1 else replace(cell, window=f"{cell.window}{SEED}{seed}"))
    return cells


class Inputs:
    """Content hashes of input files and saved models, cached by path, and what makes the results (`made`)."""

    def __init__(self) -> None:
        self._hashes: dict[str, str] = {}
        self.made: dict[str, Any] = {"format": FORMAT, "version": VERSION}
        try:
            plugins = plugin_sources()
        except OSError as error:
            problem = f"a plugin's file cannot be read ({error.strerror or error})"
            raise ConfigError(f"{error.filename}: {problem}") from error
        if plugins:
            self.made["plugins"] = plugins

    def __call__(self, path: str) -> str:
        """Content hash of a file or folder; raises `ConfigError`."""
        if path not in self._hashes:
            hashes = file_hashes(path)
            self._hashes[path] = hashes.get("") or digest(hashes)
        return self._hashes[path]


def varied(cell: Cell, name: str, options: Mapping[str, Any], inputs: Inputs) -> Cell:
    """The cell of the same controller on the same window with other options; raises `ConfigError`."""
    controller = cell.scenario.controller.model_copy(update={"options": dict(options)})
    return _cell(name, cell.scenario.model_copy(update={"controller": controller}), inputs)


def _cell(name: str, scenario: Scenario, hash_of: Inputs) -> Cell:
    """The cell of a scenario. Its keys are hashes of all inputs of the run and of the identification.

    For a controller without a model the identification settings are not part of the key, so that its runs are reused
    beside any other. That of an identification includes the source: models have no result file that reports a change.
    """
    experiment = Experiment.of(scenario)
    controller, source = experiment.own.name, experiment.own.model_from
    task, identification_key = None, None
    model: str | dict[str, Any] | None = None
    if isinstance(source, SavedModel):
        model = hash_of(source.folder)
    elif source is not None:
        task = source
        probed = hash_of(task.probed_files) if task.probed_files else None
        model = task.to_json() | {"plant": _plant_by_content(task.plant, hash_of), "probed": probed}
        identification_key = digest({**hash_of.made, "source": source_fingerprint(), "task": model})
    options = experiment.own.chosen.config.model_dump(mode="json")
    named = python_of({"controller": {"name": controller, "options": options}, "kpis": scenario.kpis})
    named += [str(policy_settings(file)) for file in named if is_policy(file)]
    files = {path: hash_of(path) for path in (*named_files(controller, options), *named)}
    # What a controller is compared with decides nothing of its run. Keys that came later count where they are given.
    decides = scenario.model_dump(mode="json", exclude={"equal_comfort"}) | {
        "testcase": experiment.testcase.model_dump(mode="json"),
        "plant": _plant_by_content(scenario.plant, hash_of),
        "controller": {"name": controller, "options": options, "files": files},
        "identification": model,
    }
    key = digest({**hash_of.made, "scenario": decides})
    return Cell(
        name,
        scenario.period,
        scenario.price,
        scenario.plant.forecast_uncertainty,
        scenario,
        key,
        task,
        identification_key,
        needs_model=source is not None,
    )


def _plant_by_content(spec: PlantSpec, hash_of: Callable[[str], str]) -> dict[str, Any]:
    without = None if spec.options else {"options"}
    return spec.model_dump(mode="json", exclude=without) | {
        field: hash_of(path) for field, path in spec.files().items()
    }
