"""The YAML file of a fleet: which buildings, and what is run on them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from thermoforce_mpc.scenario.settings import StrictModel, find_config, read_yaml, validate
from thermoforce_mpc.scenario.testcase import Price
from thermoforce_mpc.simulation.comparison.variants import ManyRuns, Variant

# A thermostat on a wall reacts within minutes; at the step of the plans it overshoots and is too easy to beat.
_THERMOSTAT_STEP_S = 300.0
# Keys of a scenario, and those of a fleet from which every run has them.
_ELSEWHERE = {"testcase": "buildings", "period": "windows", "price": "prices", "days": "days", "seed": "seeds",
              "controller": "variants", "baselines": "variants"}  # fmt: skip


class Generated(StrictModel):
    """Generated houses of one zone: numbers `first` to `first + count − 1` of the population `seed`."""

    seed: int = Field(ge=0, lt=10**9, description="population; `tf-mpc bench buildings` reports 2026")
    count: int = Field(ge=1, le=10**7, description="number of houses")
    first: int = Field(0, ge=0, lt=10**8, description="number of the first")


class Rooms(StrictModel):
    """Houses of rooms with a valve each: seeds `first_seed` to `first_seed + count − 1`."""

    rooms: int = Field(ge=1, le=30, description="rooms of each house")
    count: int = Field(ge=1, le=10**7, description="number of houses")
    first_seed: int = Field(1, ge=0, lt=10**8, description="seed of the first")


class Source(StrictModel):
    """Where buildings come from; exactly one key."""

    generated: Generated | None = Field(None, description="generated houses of one zone")
    rooms: Rooms | None = Field(None, description="houses of rooms")
    testcase: str | None = Field(None, description="one test case: a name (see `tf-mpc testcases`) or YAML file")
    table: str | None = Field(
        None,
        description="CSV file, one building a row: name; testcase, and optionally model (a saved model's folder), "
        "weather, url, fmu; or record and map (measurements and their map), with a test case to run it on or without; "
        "relative paths start at the table's folder",
    )

    @model_validator(mode="after")
    def _has_one_key(self) -> Source:
        keys = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(keys) != 1:
            raise ValueError(f"needs exactly one of {', '.join(type(self).model_fields)}; found {keys or 'none'}")
        return self


class FleetFile(ManyRuns):
    """Buildings, and windows × tariffs × variants × seeds that are run on each."""

    buildings: tuple[Source, ...] = Field(min_length=1, description="where buildings come from")
    windows: tuple[str, ...] = Field(
        ("cold_week", "sunny_week"), min_length=1, description="windows that all buildings have, or start days"
    )
    prices: tuple[Price, ...] = Field(("constant",), min_length=1, description="tariffs")
    variants: dict[str, Variant] = Field(
        default_factory=lambda: {
            "thermoforce_mpc": Variant(controller="thermoforce_mpc"),
            "thermostat": Variant(controller="thermostat", options={"step_s": _THERMOSTAT_STEP_S}),
            "native": Variant(controller="native"),
        },
        min_length=1,
        description="controllers with options; by default ours, an on/off thermostat of 5 min, and the building's own",
    )
    reference: str = Field("thermostat", description="variant that savings are counted against")
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        (1,), min_length=1, description="seeds of probing, training and forecast errors"
    )
    days: float = Field(7.0, gt=0, le=120, description="scored days of a window")
    trajectories: bool = Field(False, description="keep every run's trajectory too, as Parquet")
    scenario: dict[str, Any] = Field(default_factory=dict, description="any keys of a scenario, for all runs")

    @field_validator("scenario")
    @classmethod
    def _of_all_runs(cls, value: dict[str, Any]) -> dict[str, Any]:
        for key in value:
            if key in _ELSEWHERE:
                raise ValueError(f"{key}: has a key of its own in a fleet, which would replace it: {_ELSEWHERE[key]}")
        return value

    @model_validator(mode="after")
    def _known_reference(self) -> FleetFile:
        if self.reference not in self.variants:
            raise ValueError(f"reference: '{self.reference}' is not among the variants {', '.join(self.variants)}")
        return self


def load_fleet(name: str) -> tuple[FleetFile, Path]:
    """Read a fleet file, given by path or shipped name, and where it is; raises `ConfigError`."""
    path = find_config("fleets", name)
    return validate(FleetFile, read_yaml(path), str(path)), path
