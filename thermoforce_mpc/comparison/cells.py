"""What a comparison runs: variants (named controllers with options), and the cells that they make.

Variants come from the command line or a YAML file. A cell is one variant on one window under one tariff and forecast
error level, with its hash key.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, Field, field_validator

from controllers.registry import controller_config, find_entry
from thermoforce_mpc.comparison.input_files import file_hashes, named_files
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.execution.keys import digest, source_fingerprint
from thermoforce_mpc.experiment.experiment import Experiment, check_windows
from thermoforce_mpc.experiment.identifying import IdentificationTask, SavedModel
from thermoforce_mpc.experiment.outside import python_of
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.registry import names_in, plugin_sources
from thermoforce_mpc.scenario.own_code import is_policy, policy_settings
from thermoforce_mpc.scenario.scenario import PlantSpec, Scenario, full_name
from thermoforce_mpc.scenario.settings import StrictModel, find_config, merge, nested, read_yaml, suggestion, validate
from thermoforce_mpc.scenario.testcase import Price, TestCase
from thermoforce_mpc.version import VERSION

# Options of an objective that are limits of the building, not aims of a controller.
_LIMITS = ("power_cap_kW", "power_cap_price_per_kWh", "peak_price_per_kW")
# Keys of a scenario that are axes of a comparison, or of a variant itself.
_ELSEWHERE = {
    "testcase", "controller", "period", "price", "baselines", "equal_comfort", "identification", "step_s", "kpis",
}  # fmt: skip
_SWEPT = {"identification", "step_s"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.,=+%-]*")


class Variant(StrictModel):
    """One variant: a controller with options and identification settings."""

    controller: str = Field(description="name in the registry, see `tf-mpc controllers`")
    options: dict[str, Any] = Field(default_factory=dict, description="options of that controller")
    step_s: float | None = Field(None, ge=300, le=14400, description="control step, s; null: the controller's own")
    identification: dict[str, Any] = Field(
        default_factory=dict,
        description="keys that override the scenario's `identification`: model, days, probing, options",
    )
    scenario: dict[str, Any] = Field(
        default_factory=dict,
        description="other keys of the scenario: days, comfort, seed, plant",
        examples=[{"seed": 2}],
    )

    @field_validator("scenario")
    @classmethod
    def _not_elsewhere(cls, value: dict[str, Any]) -> dict[str, Any]:
        allowed = Scenario.model_fields.keys() - _ELSEWHERE
        for key in value:
            if key not in allowed:
                raise ValueError(f"'{key}' is set elsewhere, or is no key; here: {', '.join(sorted(allowed))}")
        return value


class ManyRuns(StrictModel):
    """Base of files whose keys name what many runs are made of."""

    @field_validator("windows", mode="before", json_schema_input_type=tuple[str | float, ...], check_fields=False)
    @classmethod
    def _day_numbers_as_text(cls, value: object) -> object:
        if not isinstance(value, list | tuple):
            return value
        return [str(item) if isinstance(item, int | float) and not isinstance(item, bool) else item for item in value]

    @field_validator("windows", "prices", "seeds", check_fields=False)
    @classmethod
    def _each_once(cls, value: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(set(value)) < len(value):
            raise ValueError(f"{next(item for item in value if value.count(item) > 1)} is given twice")
        return value

    @field_validator("variants", check_fields=False)
    @classmethod
    def _plain_names(cls, value: dict[str, Variant]) -> dict[str, Variant]:
        for name in value:
            if not _NAME.fullmatch(name):
                raise ValueError(f"'{name}': names of variants are letters, digits, spaces and _ . , = + % -")
        return value


class ComparisonFile(ManyRuns):
    """YAML file of variants; `windows`, `prices` and `scenario` are defaults for the options of the command."""

    variants: dict[str, Variant] = Field(min_length=1, description="variants by name")
    windows: tuple[str, ...] = Field((), description="peak_heat_day, typical_heat_day, or start days such as 44")
    prices: tuple[Price, ...] = Field((), description="tariffs")
    scenario: dict[str, Any] = Field(default_factory=dict, description="any keys of a scenario, for all variants")


def load_comparison(name: str) -> ComparisonFile:
    """Read a comparison file, given by path or shipped name; raises `ConfigError`."""
    path = find_config("comparisons", name)
    return validate(ComparisonFile, read_yaml(path), str(path))


def variants_by_name(controllers: Sequence[str], file: ComparisonFile | None) -> dict[str, Variant]:
    """The variants of a file, then the named controllers with the registry's defaults.

    Raises:
        ConfigError: an unknown controller, nothing to compare, or a name given twice.
    """
    variants = dict(file.variants) if file else {}
    for name in map(full_name, controllers):
        find_entry(name)
        if name in variants:
            raise ConfigError(f"'{name}' is given twice: once as a controller, once as a variant of that name")
        variants[name] = Variant(controller=name)
    if not variants:
        raise ConfigError("nothing to compare: give --controllers A,B or --variants FILE")
    return variants


def swept_variants(controller: str, key: str, values: Sequence[float], testcase: TestCase) -> dict[str, Variant]:
    """One variant of `controller` for each value of a numeric option or key of the scenario, as `numeric_option`.

    Raises:
        ConfigError: no such option, an ambiguous or non-numeric one, a value not allowed, or a value given twice.
    """
    if not values:
        raise ConfigError("--values: give at least one number")
    key = numeric_option(controller, key)
    of_options = key in _numeric_leaves(find_entry(controller).config())
    variants: dict[str, Variant] = {}
    for value in values:
        if not math.isfinite(value):
            raise ConfigError(f"--values: {value} is not a finite number")
        keys = nested(key, int(value) if value == int(value) and abs(value) < 2**53 else value)
        if of_options:
            controller_config(controller, keys, testcase)
            variant = Variant(controller=controller, options=keys)
        elif key in ("step_s",) or key.startswith("identification."):
            variant = Variant(controller=controller, **keys)
        else:
            variant = Variant(controller=controller, scenario=keys)
        name = f"{controller} {key.rpartition('.')[2]}={value:g}"
        if name in variants:
            raise ConfigError(f"--values: {value:g} is given twice")
        variants[name] = variant
    return variants


def numeric_option(controller: str, key: str) -> str:
    """Dotted name of a number: option `key` of `controller`, by its last word if unique, else a key of the scenario.

    Raises `ConfigError` listing all of them.
    """
    options = _numeric_leaves(find_entry(controller).config())
    of_scenario = [name for name in _numeric_leaves(Scenario) if name.partition(".")[0] not in _ELSEWHERE - _SWEPT]
    of_scenario += _numeric_leaves(IdentificationConfig, "identification.options.")
    if key in options or key in of_scenario:
        return key
    matches = [name for name in options if name.endswith(f".{key}")]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise ConfigError(f"--over {key}: more than one option has this name; give one of: {', '.join(matches)}")
    near = suggestion(key, [*options, *of_scenario])
    raise ConfigError(
        f"--over {key}: controller '{controller}' has no such numeric option{near}; "
        f"known: {', '.join(options) or 'none'}; of the scenario: {', '.join(of_scenario)}"
    )


def variant_scenario(base: Scenario, variant: Variant, window: str, price: str, uncertainty: str) -> Scenario:
    """Scenario of one cell: `base` with this variant, window, tariff and forecast error level; raises `ConfigError`.

    The controller's options are those of `base` where it is the same controller, else the limits among them
    (`shared_limits`), then the variant's.
    """
    over: dict[str, Any] = {
        "period": window,
        "price": price,
        "plant": {"forecast_uncertainty": uncertainty},
        "identification": variant.identification,
    } | ({} if variant.step_s is None else {"step_s": variant.step_s})
    same = variant.controller == base.controller.name
    own = base.controller.options if same else shared_limits(base, variant.controller)
    controller = {"name": variant.controller, "options": merge(own, variant.options)}
    data = merge(merge(base.model_dump(), variant.scenario), over) | {
        "controller": controller,
        "baselines": (),
        "equal_comfort": None,
    }
    return validate(Scenario, data, f"variant of '{variant.controller}'")


def building_limits(base: Scenario) -> dict[str, Any]:
    """What the options of `base`'s controller say of limits that are those of the building, such as a power cap."""
    objective = base.controller.options.get("objective")
    return {key: objective[key] for key in _LIMITS if key in objective} if isinstance(objective, dict) else {}


def shared_limits(base: Scenario, controller: str) -> dict[str, Any]:
    """`building_limits` a scenario as options of another controller; {} where it knows none of them."""
    objective = find_entry(controller).config().model_fields.get("objective")
    known = getattr(objective and objective.annotation, "model_fields", {})
    given = {key: value for key, value in building_limits(base).items() if key in known}
    return {"objective": given} if given else {}


def known_names(text: str, option: str, known: Collection[str]) -> tuple[str, ...]:
    """Words of a comma-separated list, each of them `known`; raises `ConfigError` as `comma_list`, or for another."""
    names = comma_list(text, option)
    for name in names:
        if name not in known:
            raise ConfigError(f"{option}: unknown '{name}'{suggestion(name, known)}; known: {', '.join(known)}")
    return names


def comma_list(text: str, option: str) -> tuple[str, ...]:
    """Words of a comma-separated list; raises `ConfigError` if it is empty or has a word twice."""
    words = names_in(text)
    if not words:
        raise ConfigError(f"{option}: expected names separated by commas")
    if len(set(words)) < len(words):
        raise ConfigError(f"{option}: '{next(w for w in words if words.count(w) > 1)}' is given twice")
    return words


def _numeric_leaves(model: type[BaseModel], prefix: str = "") -> list[str]:
    """Dotted names of all numeric fields of `model`, nested models included."""
    names: list[str] = []
    for name, field in model.model_fields.items():
        # Of a union (a number, or null) its parts; a pair of numbers is none to sweep.
        union = get_origin(field.annotation) in (Union, UnionType)
        for annotation in get_args(field.annotation) if union else (field.annotation,):
            if annotation in (float, int):
                names.append(prefix + name)
                break
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                names += _numeric_leaves(annotation, f"{prefix}{name}.")
    return names


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
