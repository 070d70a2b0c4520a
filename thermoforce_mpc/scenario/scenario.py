"""Scenario: the complete configuration of a run, one YAML file. Every key is described here."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from thermoforce_mpc.registry import known_name
from thermoforce_mpc.scenario.comfort import OfComfort, window_name
from thermoforce_mpc.scenario.settings import StrictModel, one_of
from thermoforce_mpc.scenario.testcase import Price

_KINDS = ("embedded", "boptest", "fmu")
# Names of controllers in short.
_IN_SHORT = {"mpc": "thermoforce_mpc"}


class PlantSpec(StrictModel):
    """Controlled plant."""

    kind: Annotated[str, AfterValidator(known_name("plant", "plants", *_KINDS)), one_of(*_KINDS)] = Field(
        "embedded",
        description="embedded: the plant that implements the test case (the emulator, EnergyPlus, a drawn house); "
        "boptest: a service; fmu: an FMU; or a plugin's plant (`tf-mpc plants`)",
    )
    options: dict[str, Any] = Field(default_factory=dict, description="options of a plugin's plant")
    path: str | None = Field(None, description="the test case's wrapped.fmu (kind: fmu)", examples=["wrapped.fmu"])
    url: str = Field("http://127.0.0.1:8000", description="base URL of the BOPTEST service (kind: boptest)")
    weather: str = Field("synthetic", description="'synthetic', or a .mos / .epw file (kind: embedded)")
    forecast_uncertainty: Literal["none", "low", "medium", "high"] = Field(
        "none", description="BOPTEST's forecast uncertainty level for outdoor temperature and solar radiation"
    )
    patience_min: float = Field(
        15.0,
        ge=0,
        le=1440,
        description="how long a service may be away before the run ends, min (kind: boptest); how long an FMU or "
        "EnergyPlus may take for a quarter of an hour of the building's time",
    )
    forecast_outage_h: float = Field(
        48.0, ge=0, le=720, description="how long the plant may give no forecast before the run ends, h"
    )
    prices_file: str | None = Field(
        None, description="CSV with your own highly dynamic tariff (kind: embedded)", examples=["prices.csv"]
    )

    people: int | None = Field(
        None,
        ge=0,
        description="seed of people who do not keep to the schedule (presence, guests, cooking, windows, blinds), of "
        "which forecasts know nothing (embedded emulator, drawn houses and offices); null: they keep to it",
        examples=[7],
    )

    @model_validator(mode="after")
    def _has_its_file(self) -> PlantSpec:
        if (self.kind == "fmu") != (self.path is not None):
            raise ValueError("kind 'fmu' and path go together: give both, or neither (--fmu FILE gives both)")
        return self

    @model_validator(mode="after")
    def _knows_its_surroundings(self) -> PlantSpec:
        if self.kind != "embedded" and (self.weather != "synthetic" or self.prices_file is not None):
            raise ValueError(
                f"weather and prices_file apply only to kind 'embedded'; kind '{self.kind}' has its own, leave them out"
            )
        return self

    def files(self) -> dict[str, str]:
        """Paths of the plant's input files, by field name."""
        named = {"path": self.path, "weather": self.weather, "prices_file": self.prices_file}
        return {field: path for field, path in named.items() if path not in (None, "synthetic")}


class ProbingSpec(StrictModel):
    """Source of the operator: a saved model, or the probing of an earlier run or before the scored window's warm-up."""

    model: str | None = Field(None, description="folder of a saved model; probing is skipped", examples=["my_model"])
    probed: str | None = Field(
        None, description="folder of a run whose probing is taken; nothing is probed", examples=["runs/my_run"]
    )
    days: float = Field(3.0, ge=1, le=60, description="days of probing")
    most_days: float = Field(
        10.0, ge=1, le=60, description="days of probing after which it ends though the model is not competent"
    )
    end_early: bool = Field(True, description="end probing before `days` once the effect is known well")
    probing: dict[str, Any] = Field(
        default_factory=dict,
        description="probing options: levels, hold_steps, ...",
        examples=[{"levels": [0.0, 0.5, 1.0]}],
    )
    options: dict[str, Any] = Field(
        default_factory=dict, description="identification options: order, gamma, ...", examples=[{"order": 2}]
    )

    @model_validator(mode="after")
    def _has_one_source(self) -> ProbingSpec:
        if self.model is not None and self.probed is not None:
            raise ValueError("model and probed each take the place of probing: give one of them")
        return self


def full_name(controller: str) -> str:
    """The name of a controller in the registry, where it was given in short."""
    return _IN_SHORT.get(controller, controller)


class ControllerSpec(StrictModel):
    """Controller and its options; `tf-mpc controllers` lists both."""

    name: Annotated[str, AfterValidator(full_name)] = Field(
        "thermoforce_mpc",
        description="name in the registry, see `tf-mpc controllers`; mpc: thermoforce_mpc; or a class of your own, as "
        "my_rules.py:Night",
    )
    options: dict[str, Any] = Field(
        default_factory=dict, description="options of that controller", examples=[{"horizon_h": 36}]
    )


class Scenario(StrictModel):
    """Configuration of a run. Every field but the test case has a default."""

    testcase: str = Field(description="name in configs/testcases, or a YAML file")
    plant: PlantSpec = PlantSpec()
    period: str = Field(
        "peak_heat_day",
        description="peak_heat_day, typical_heat_day, another window of the plant (peak_cool_day, typical_cool_day, "
        "mix_day, cold_day, cold_week, sunny_week), or the day it starts: a date such as 2026-01-17 (its year does not "
        "count: plants have one year of 365 days) or a day of the year from 0, such as 44; default for cooled "
        "buildings: peak_cool_day",
    )
    days: float = Field(14.0, gt=0, le=365, description="scored days")
    step_s: float | None = Field(
        None,
        ge=300,
        le=14400,
        description="control step of all model-based controllers, s; default: their own",
        examples=[3600],
    )
    price: Price = Field("constant", description="tariff")
    comfort: OfComfort | None = Field(
        None,
        description="comfort bounds by schedule, in plans and KPIs; null: those of the test case. Native control keeps "
        "its own set-points",
        examples=["weekdays 6:00-22:00 21-24, else 17-26"],
    )
    kpis: tuple[str, ...] = Field(
        (),
        description="KPIs of your own beside BOPTEST's: functions of the trajectory, as my_kpis.py:starts_per_day",
        examples=[["my_kpis.py:starts_per_day"]],
    )
    controller: ControllerSpec = ControllerSpec()
    identification: ProbingSpec = ProbingSpec()
    baselines: tuple[str, ...] = Field(("native", "thermostat"), description="controllers to compare with")
    equal_comfort: bool | None = Field(
        None,
        description="beside a baseline thermostat, search the set-point at which it is as comfortable as the "
        "controller, in further runs of it; null: where the plant is embedded",
    )
    seed: int = Field(1, ge=0, description="seed of probing, training and forecast errors")

    @field_validator("period", mode="before", json_schema_input_type=str | float)
    @classmethod
    def _start_as_text(cls, value: object) -> object:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return str(value)
        return window_name(value) if isinstance(value, str) else value
