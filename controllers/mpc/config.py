"""Options of the MPC (scenario key `controller.options`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from controllers.actuation.actuator import ActuationConfig
from controllers.monitoring.meters import MeterConfig
from controllers.monitoring.watch import WatchConfig
from controllers.monitoring.zone_sensors import SensorConfig
from controllers.optimisation.solvers.ipopt import IpoptConfig
from controllers.optimisation.solvers.milp import MilpConfig
from controllers.optimisation.solvers.qp import QPConfig
from controllers.optimisation.solvers.sqp import SQPConfig
from controllers.safety.fallback_policy import FallbackConfig
from controllers.safety.overrides import GateConfig, GuardConfig
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.clock import PLAN_H, PLAN_STEP_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.free_response.registry import check_free_response, own_options
from thermoforce_mpc.scenario.bill import Bill, Peak, PeakStep
from thermoforce_mpc.scenario.settings import StrictModel, one_of


def _options_in_words() -> str:
    return "; ".join(
        f"{name}: {', '.join(f'{key} (default {default!r})' for key, default in options.items()) or 'none'}"
        for name, options in own_options().items()
    )


class FreeResponseConfig(StrictModel):
    """Free-response model that the plan is based on."""

    name: Annotated[str, one_of(*own_options())] = Field(
        "residual",
        description=f"free-response model: one of {', '.join(own_options())}, or a plugin's (`tf-mpc free-responses`)",
    )
    options: dict[str, Any] = Field(default_factory=dict, description=f"options of that model. {_options_in_words()}")
    substitutes: bool = Field(
        True,
        description="where the model fails or is absurd, plan with the linear weather model, then with persistence",
    )

    @model_validator(mode="after")
    def _must_be_known(self) -> FreeResponseConfig:
        try:
            check_free_response(self.name, self.options)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        return self


# Floor area of a zone whose area the model does not know, m²: that of BOPTEST's heat pump case.
_AREA_M2 = 192.0


class ObjectiveConfig(StrictModel):
    """Weights of the objective besides energy cost at the tariff."""

    # 5 currency/(K·h) of BOPTEST's heat pump, 192 m², with which it was first run (2026-11-21); `tf-mpc sweep` shows
    # what others give.
    comfort_weight_per_m2: float = Field(
        0.026,
        gt=0,
        description="penalty on comfort violation, currency/(K·h) per m² of the zone's floor (as of 192 m² where the "
        "model does not know it); a K·h counts as at least 5 times the heat that avoids it, in the mean of a day",
    )
    carbon_price_per_kg: float = Field(0.0, ge=0, description="price of emitted CO2, currency/kg")
    peak_price_per_kW: Annotated[float, Field(ge=0)] | tuple[PeakStep, ...] = Field(
        0.0,
        description="price of the mean power of all machines together over a control step above the highest so far, "
        "currency/kW; or fees of a month by steps of its peak (`up_to_kW`, `per_month`): a kW costs what it does on "
        "average over the next two steps, from the highest peak of the record on",
    )
    peak_of: Literal["run", "month", "three_days"] = Field(
        "run",
        description="which peak is priced: the highest of the run, of the calendar month, or the mean of the highest "
        "of three days of the month (a kW more on one day counts a third)",
    )
    peak_least_kW: float = Field(0.0, ge=0, description="a peak below this costs nothing more, kW")
    at_the_meter: bool = Field(
        False,
        description="what the forecast has of the meter counts: own generation and other loads behind it (what they "
        "leave over costs what it would earn when it is fed in, only what is bought costs the price), and limits of "
        "power (dimming by the grid), which are kept as `power_cap_kW` is",
    )
    power_cap_kW: float | None = Field(
        None,
        gt=0,
        description="cap of the mean power of all machines together over a control step (at the default step a "
        "metered quarter hour), kW: on/off blocks keep it unless the plan pays for more; null: none",
    )
    power_cap_price_per_kWh: float = Field(
        1.0, ge=0, description="price of energy that a plan takes above the cap, currency/kWh"
    )
    # Weight on u² per step, currency: makes the optimum unique.
    curvature: ClassVar[float] = 1e-6
    gone: ClassVar[Mapping[str, tuple[Any, str]]] = {
        "exchange": (False, "at_the_meter: true takes its place, and that of keep_limits"),
        "keep_limits": (False, "at_the_meter: true takes its place, and that of exchange"),
        "terminal_value": (
            0.0, "heat stored at the end has no price (over horizons of 6 to 24 h one changed cost by 0.3 % at most); "
            "a term of your own can give it one (key terms)",
        ),
    }  # fmt: skip

    @model_validator(mode="after")
    def _steps_of_peaks(self) -> ObjectiveConfig:
        if self.peak_steps:
            self._peak  # noqa: B018 (steps are checked where it is made)
        return self

    @property
    def peak_steps(self) -> tuple[PeakStep, ...]:
        """Fees of a month by steps of its peak; none where a kW has one price."""
        return self.peak_price_per_kW if isinstance(self.peak_price_per_kW, tuple) else ()

    @property
    def _peak(self) -> Peak:
        of = "three_days" if self.peak_of == "three_days" else "highest"
        return Peak.model_validate({"of": of, "steps": self.peak_steps, "least_kW": self.peak_least_kW})

    @property
    def prices_peaks(self) -> bool:
        """Whether peaks have a price."""
        return bool(self.peak_price_per_kW)

    def peak_per_kW(self, highest_kW: Array) -> float:
        """What a kW more than the peak costs on every day that counts; `highest_kW` (n,): of the days of the record."""
        if not isinstance(self.peak_price_per_kW, tuple):
            return self.peak_price_per_kW
        return self._peak.per_kW(self._peak.of_days(highest_kW))

    def comfort_weights(self, floor_area_m2: Sequence[float]) -> Array:
        """Penalty on comfort violation in zones of `floor_area_m2` (Z,), NaN where not known, currency/(K·h) (Z,)."""
        areas = np.asarray(floor_area_m2, dtype=np.float64)
        return self.comfort_weight_per_m2 * np.where(np.isnan(areas), _AREA_M2, areas)


def objective_of(bill: Bill) -> dict[str, Any]:
    """Keys of `ObjectiveConfig` that say what a `bill` asks for."""
    keys: dict[str, Any] = {"at_the_meter": bill.export_per_kWh is not None or bill.dimming is not None}
    if bill.peak is not None:
        taxed = 1.0 + bill.vat
        steps = [step.model_dump() | {"per_month": step.per_month * taxed} for step in bill.peak.steps]
        price = {"peak_price_per_kW": steps or bill.peak.per_kW(0.0) * taxed}
        keys |= price | {
            "peak_of": "month" if bill.peak.of == "highest" else "three_days",
            "peak_least_kW": bill.peak.least_kW,
        }
    return keys


class DeadlineConfig(StrictModel):
    """Wall time after which a step goes on without an answer; the call is left behind."""

    # Forecasts take milliseconds (`tf-mpc bench controller`), first ones, which load a network, seconds: only one that
    # hangs meets it.
    forecast_s: float = Field(60.0, gt=0, description="free forecasts of all zones of a step, s")
    # Solve of a step, s: thrice the longest that a solver of ours takes by its own limit, so that only one that hangs
    # meets it. A step waits as long for a look for sun on the zone sensors that began at the step before.
    solve_s: ClassVar[float] = 60.0
    look_s: ClassVar[float] = solve_s


class MoveBlockingConfig(StrictModel):
    """Move blocking: one move per step at first, longer moves later."""

    # Length of the first part of the horizon, in which every step is its own move, and of each later move, h: 84 moves
    # instead of 192. Every step free costs the same on the heat pump's peak day and 0.2 % more on one of
    # `house:3rooms:8811`, in five to ten times the time of a solve (2026-11-28).
    free_h: ClassVar[float] = 12.0
    hold_h: ClassVar[float] = 1.0


class MPCConfig(StrictModel):
    """Options of the MPC."""

    step_s: float | None = Field(
        PLAN_STEP_S, ge=300, le=14400, description="control step, s; null: the step of the model"
    )
    horizon_h: float = Field(PLAN_H, gt=0, le=168, description="prediction horizon, h")
    # By judgement, with the first plans of BOPTEST's heat pump (2026-11-21): readings and solvers round by as much.
    comfort_margin_K: float = Field(0.02, ge=0, le=2, description="margin inside both comfort bounds, K")
    # By judgement, with the first plans of BOPTEST's heat pump (2026-11-21): one forecast in four may be too warm.
    backoff_level: float = Field(
        0.25,
        gt=0,
        le=0.5,
        description="chance level of the bound that actuation protects (heating: the lower): comfort is planned for "
        "this quantile of the free forecast, and for one of the other bound by what heat costs over what discomfort "
        "counts; 0.5: for the median, with no back-off from either",
    )
    # Largest expected violation of a bound, K, mean over the next 6 h: the chance levels are lowered until it holds,
    # which matters where forecasts are uncertain.
    backoff_violation_K: ClassVar[float] = 0.0135
    # Largest back-off from a comfort bound, K. By judgement: twice what a thermostat keeps (`THERMOSTAT_INSIDE_K`),
    # since beyond it a plan would be warmer than people set by hand.
    backoff_max_K: ClassVar[float] = 0.6
    corrections: bool = Field(
        True,
        description="correct plans by what was seen: the mean error of one-step predictions is added to them, and in a "
        "fast zone a reserve is kept inside the bound that actuation protects, for what happens within a step (swing "
        "of on/off blocks and model error, at most 0.3 K; of a coarse sensor at least half a step)",
    )
    # Time over which the mean error of one-step predictions is forgotten, h: a machine gives what it gives for hours.
    # With it a radiator's zone no longer sat 0.05 K below its bound all night (2026-11-22).
    offset_h: ClassVar[float] = 6.0
    unused_capacity: bool = Field(
        True, description="leave a share of a machine that several feed on unused, where it was found at its limit"
    )
    solver: Literal["auto", "ipopt", "qp", "sqp", "milp"] = Field(
        "auto",
        description="ipopt: nonlinear programme; qp: quadratic programme, where the problem is convex; sqp: sequential "
        "quadratic programming, where the gain sees the predicted temperature; milp: which of actuators that exclude "
        "one another acts in the first hours, by mixed-integer programming; auto: milp with such choices, else ipopt "
        "up to two zones, qp or sqp beyond",
    )
    terms: str | None = Field(
        None,
        description="function of your own that adds terms to objective and constraints, as my_terms.py:ramp; a path "
        "from where the command is started. See the how-to 'Your own optimisation'",
    )
    objective: ObjectiveConfig = ObjectiveConfig()
    whole_runs: bool = Field(
        False,
        description="plan an on/off machine in runs that keep its minimum on and off times and starts an hour over all "
        "of the horizon, where a step does not hold such a cycle (`tf-mpc plan` does); else the plan has shares of "
        "steps, and blocks keep them from step to step",
    )
    free_response: FreeResponseConfig = FreeResponseConfig()
    actuation: ActuationConfig = ActuationConfig()
    actuations: dict[str, ActuationConfig] = Field(
        default_factory=dict, description="actuation of single actuators, by name; `actuation` otherwise"
    )
    fallback: FallbackConfig = FallbackConfig()
    deadline: DeadlineConfig = DeadlineConfig()
    sensor: SensorConfig = SensorConfig()
    sensors: dict[str, SensorConfig] = Field(
        default_factory=dict, description="sensors of single zones, by name; `sensor` otherwise"
    )
    meter: MeterConfig = MeterConfig()
    meters: dict[str, MeterConfig] = Field(
        default_factory=dict,
        description="weather sensors and meters, by name (T_out_C, solar_W_m2, power_W, heat_W, or power_W[boiler]); "
        "`meter` otherwise",
    )
    gate: GateConfig = GateConfig()
    guard: GuardConfig = GuardConfig()
    watch: WatchConfig = WatchConfig()
    milp: ClassVar[MilpConfig] = MilpConfig()
    qp: ClassVar[QPConfig] = QPConfig()
    ipopt: ClassVar[IpoptConfig] = IpoptConfig()
    sqp: ClassVar[SQPConfig] = SQPConfig()
    move_blocking: ClassVar[MoveBlockingConfig] = MoveBlockingConfig()
    gone: ClassVar[Mapping[str, tuple[Any, str]]] = {
        "backoff_level_other": (
            None, "the other bound's level is what heat costs over what discomfort counts; backoff_level 0.5 plans "
            "without back-off from either",
        ),
        "backoff_violation_K": (0.0135, "it stays 0.0135 K; backoff_level 0.5 plans without back-off"),
        "offset_h": (6.0, "it stays 6 h; corrections: false does without, as without reserve"),
        "reserve": (True, "corrections: false does without, as without an offset of predictions"),
    }  # fmt: skip

    @property
    def backs_off(self) -> bool:
        """Whether comfort is planned for more than the median of the free forecast."""
        return self.backoff_level < 0.5

    def actuation_of(self, actuator: str) -> ActuationConfig:
        """Actuation of an actuator."""
        return self.actuations.get(actuator, self.actuation)

    def sensor_of(self, zone: str) -> SensorConfig:
        """Options of a zone's sensor."""
        return self.sensors.get(zone, self.sensor)

    def n_steps(self, step_s: float) -> int:
        """Number of steps of `step_s` seconds in the horizon."""
        return round(self.horizon_h * HOUR_S / step_s)
