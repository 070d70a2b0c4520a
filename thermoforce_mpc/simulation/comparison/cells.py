"""One cell of a comparison: a contestant on one window under one tariff. Its key says what decides its result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controllers.registry import find_entry
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.comparison.variants import Variant, variant_scenario
from thermoforce_mpc.simulation.composition import identification_settings, validate_scenario
from thermoforce_mpc.simulation.run_folder import file_sha256
from thermoforce_mpc.version import VERSION

# Changed whenever a cell's file or what decides a result changes, so that no old file is taken for a new one.
FORMAT = 1


@dataclass(frozen=True)
class Cell:
    """A run to be made: `scenario` decides its result, `key` is its hash.

    `learning_key` names the identification it needs (None: no model, or a saved one); cells that would probe and
    identify alike share one.
    """

    variant: str
    window: str
    price: str
    uncertainty: str
    scenario: Scenario
    key: str
    learning_key: str | None

    @property
    def title(self) -> str:
        """How a reader knows it."""
        forecasts = "" if self.uncertainty == "none" else f" · {self.uncertainty} forecast error"
        return f"{self.variant} · {self.window} · {self.price}{forecasts}"

    @property
    def group(self) -> tuple[str, str, str]:
        """Window, tariff and forecast error: cells of one group are compared with each other."""
        return self.window, self.price, self.uncertainty


def expand(
    base: Scenario,
    variants: Mapping[str, Variant],
    windows: Sequence[str],
    prices: Sequence[str],
    uncertainties: Sequence[str] = ("none",),
) -> list[Cell]:
    """All cells, validated; raises `ConfigError` naming the variant and the key that is wrong."""
    hash_of = _FileHashes()
    cells: list[Cell] = []
    for window in windows:
        for price in prices:
            for uncertainty in uncertainties:
                for name, variant in variants.items():
                    try:
                        scenario = variant_scenario(base, variant, window, price, uncertainty)
                        cells.append(_cell(name, scenario, hash_of))
                    except ConfigError as error:
                        raise ConfigError(f"variant '{name}': {error}") from error
    return cells


def digest(content: Mapping[str, Any]) -> str:
    """Sixteen hexadecimal digits that identify `content`, whatever the order of its keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class _FileHashes:
    """Hashes of input files and saved models: what counts is their content, not where they lie."""

    def __init__(self) -> None:
        self._known: dict[str, str] = {}

    def __call__(self, path: str) -> str:
        if path not in self._known:
            where = Path(path)
            try:
                if where.is_dir():
                    files = sorted(p for p in where.iterdir() if p.is_file())
                    self._known[path] = digest({file.name: file_sha256(file) for file in files})
                else:
                    self._known[path] = file_sha256(where)
            except OSError as error:
                raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
        return self._known[path]


def _cell(name: str, scenario: Scenario, hash_of: Callable[[str], str]) -> Cell:
    testcase = validate_scenario(scenario)
    spec = scenario.plant
    plant = spec.model_dump(mode="json")
    for key in ("weather", "prices_file"):
        if plant[key] not in (None, "synthetic"):
            plant[key] = hash_of(plant[key])
    common = {
        "format": FORMAT,
        "version": VERSION,
        "testcase": testcase.model_dump(mode="json"),
        "plant": plant,
        "period": scenario.period,
        "seed": scenario.seed,
    }
    needs_model = find_entry(scenario.controller.name).needs_model
    learning: dict[str, Any] = {}
    learning_key = None
    if needs_model and scenario.identification.model is not None:
        learning = {"model": hash_of(scenario.identification.model)}
    elif needs_model:
        probing, config = identification_settings(scenario, testcase)
        learning = {
            "days": scenario.identification.days,
            "step_s": scenario.step_s or testcase.step_s,
            "probing": probing.model_dump(mode="json"),
            "config": config.model_dump(mode="json"),
        }
        # Forecasts play no part in probing, so cells that differ in their error alone learn together.
        learning_key = digest({**common, "plant": {**plant, "forecast_uncertainty": "none"}, "learning": learning})
    controller = scenario.controller.model_dump(mode="json") | {"step_s": scenario.step_s}
    scored = {"days": scenario.days, "price": scenario.price}
    key = digest({**common, "controller": controller, "learning": learning, **scored})
    return Cell(name, scenario.period, scenario.price, spec.forecast_uncertainty, scenario, key, learning_key)
