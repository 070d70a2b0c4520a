"""Options of the MPC, as users write them."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from controllers.actuation import ActuationConfig
from controllers.fallback import FallbackConfig
from controllers.ipopt import IpoptConfig
from controllers.qp_backends import QPConfig
from controllers.search import SearchConfig
from controllers.semi_continuous import SemiContinuousConfig
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.identification.adaptation import AdaptationConfig
from thermoforce_mpc.model.forced_state import EstimatorConfig
from thermoforce_mpc.model.free_response.registry import check_free_response, free_response_options
from thermoforce_mpc.scenario.settings import StrictModel


def _options_in_words() -> str:
    return "; ".join(
        f"{name}: {', '.join(f'{key} (default {default!r})' for key, default in options.items()) or 'none'}"
        for name, options in free_response_options().items()
    )


class FreeResponseConfig(StrictModel):
    """Which free response the plan is built on."""

    name: str = Field("residual", description=f"one of {', '.join(free_response_options())}")
    options: dict[str, Any] = Field(default_factory=dict, description=f"its options. {_options_in_words()}")

    @model_validator(mode="after")
    def _must_be_known(self) -> FreeResponseConfig:
        try:
            check_free_response(self.name, self.options)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        return self


class ObjectiveConfig(StrictModel):
    """What a plan pays for beside energy at the tariff."""

    comfort_weight: float = Field(5.0, gt=0, description="price of one kelvin-hour of discomfort, currency/(K·h)")
    carbon_price_per_kg: float = Field(0.0, ge=0, description="price of emitted CO2, currency/kg")
    peak_price_per_kW: float = Field(
        0.0, ge=0, description="price of each kW by which the highest mean power of a step so far is exceeded"
    )
    terminal_value: float = Field(
        0.0, ge=0, le=1, description="worth of heat left in the building at the end, as a share of what it costs then"
    )
    curvature: float = Field(1e-6, ge=0, description="tiny weight on u², makes the optimum unique")


class MoveBlockingConfig(StrictModel):
    """Move blocking: near moves are free, later ones are held."""

    free_h: float = Field(12.0, gt=0, description="every step of the first hours is a move of its own, h")
    hold_h: float = Field(1.0, gt=0, description="later moves are held for this long, h")


class MPCConfig(StrictModel):
    """Options of the MPC."""

    step_s: float | None = Field(900.0, ge=300, le=14400, description="control step, s; null: the step of the model")
    horizon_h: float = Field(48.0, gt=0, le=168, description="prediction horizon, h")
    comfort_margin_K: float = Field(0.02, ge=0, le=2, description="how far inside the comfort bounds to stay, K")
    backoff_level: float = Field(
        0.25,
        gt=0,
        le=0.5,
        description="chance level of the bound that acting keeps (heating: the lower): comfort is planned for this "
        "quantile of the free forecast; 0.5: for the median",
    )
    backoff_level_other: float = Field(
        0.3,
        gt=0,
        le=0.5,
        description="the same for the bound that only not acting keeps (heating: the upper, against the sun)",
    )
    backoff_violation_K: float | None = Field(
        0.0135,
        gt=0,
        description="expected violation of a bound, K in the mean over the next 6 h, above which the chance levels are "
        "lowered: it rules where forecasts are uncertain; null leaves it to the chance levels",
    )
    backoff_max_K: float = Field(0.6, ge=0, description="largest back-off from a quantile, K")
    solver: Literal["auto", "qp", "semi_continuous", "ipopt", "search"] = Field(
        "auto",
        description="qp: quadratic programme (duty); semi_continuous: one per first level (modulating); ipopt; search: "
        "the paper's candidates; auto: the first of qp, semi_continuous and ipopt that fits the problem",
    )
    objective: ObjectiveConfig = ObjectiveConfig()
    move_blocking: MoveBlockingConfig = MoveBlockingConfig()
    free_response: FreeResponseConfig = FreeResponseConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    adaptation: AdaptationConfig = AdaptationConfig()
    actuation: ActuationConfig = ActuationConfig()
    fallback: FallbackConfig = FallbackConfig()
    qp: QPConfig = QPConfig()
    semi_continuous: SemiContinuousConfig = SemiContinuousConfig()
    ipopt: IpoptConfig = IpoptConfig()
    search: SearchConfig = SearchConfig()

    def n_steps(self, step_s: float) -> int:
        """Steps of `step_s` seconds in the horizon."""
        return round(self.horizon_h * HOUR_S / step_s)
