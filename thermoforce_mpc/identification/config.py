"""What a user may say about an identification; every prior can be overridden here."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.scenario.settings import StrictModel

DEFAULT_TIME_CONSTANTS_H: dict[int, tuple[float, ...]] = {1: (25.0,), 2: (6.0, 60.0), 3: (0.6, 3.5, 50.0)}
"""Centres of the priors by order. Three modes of a floor-heated house: water loop and screed (half an hour to one
hour), room against structure (two to six hours), structure against outdoors (one to four days)."""


class HeatCapacityConfig(StrictModel):
    """Delivered heat by data sheet: `on(u)·(c0 + c1·T_out) + u·(c2 + c3·T_out)`, see `MachineLoad`."""

    coefficients: tuple[float, float, float, float] = Field(description="c0 W, c1 W/K, c2 W, c3 W/K, all as heat > 0")
    T_out_range_C: tuple[float, float] = Field(description="outdoor temperatures it holds for, °C")
    lowest_level: float = Field(1.0, gt=0, le=1, description="level below which the machine switches")

    @model_validator(mode="after")
    def _rises_with_u(self) -> HeatCapacityConfig:
        try:
            self.load()
        except DataError as error:
            raise ValueError(str(error)) from error
        return self

    def load(self) -> MachineLoad:
        """The load it describes."""
        return MachineLoad(self.coefficients, self.T_out_range_C, self.lowest_level)


class IdentificationConfig(StrictModel):
    """Options of an identification. The defaults identify a heated house from one to thirty days."""

    method: Literal["joint", "two_stage"] = Field(
        "joint",
        description="joint fit of free and forced part, or the paper's two stages (order 1; pairs train it further)",
    )
    order: Literal["auto", 1, 2, 3] = Field("auto", description="modes of the operator; auto: chosen on held-out data")
    heat_input: Literal["auto", "identity", "heat"] = Field(
        "auto",
        description="what drives the modes: u itself, or the heat capacity of (u, T_out); auto: heat if measured",
    )
    heat_capacity: HeatCapacityConfig | None = Field(
        None, description="heat capacity by data sheet instead of an identified one"
    )
    machine: Literal["auto", "heat pump", "air conditioner", "direct", "other"] = Field(
        "auto", description="prior of the heat capacity: what gives the heat; auto: by mode and by what the data say"
    )
    lowest_level: float | None = Field(
        None, gt=0, le=1, description="level below which the probed machine was switched; by default found in the data"
    )
    modulation: Literal["neural", "linear"] = Field("neural", description="gain m(x) of the paper, or m = 1")
    feedback: bool = Field(
        False,
        description="m(x) sees the predicted temperature, actions included, instead of the free one (paper)",
    )
    gamma: float = Field(0.75, ge=0, lt=1, description="bound of the modulation, eq:mod")
    hidden: int = Field(32, ge=1, le=512, description="hidden units of the modulation")
    optimiser: Literal["lbfgs", "adam"] = Field("lbfgs", description="how the modulation is trained")
    epochs: int = Field(350, ge=1, le=5000, description="epochs of training, at most")
    learning_rate: float = Field(0.01, gt=0, description="learning rate of Adam")
    modulation_sd: float | None = Field(
        None, gt=0, description="prior: how far m(x) leaves 1; by default 0.15, and 0.05 behind a heat capacity"
    )
    validation_share: float = Field(0.25, gt=0, lt=0.9, description="share of days or pairs held out for choices")
    horizon_h: float = Field(24.0, gt=0, description="longest rollout that is scored on the held-out data, h")
    u_off: float = Field(0.02, ge=0, lt=1, description="control up to here counts as off (paper's first stage)")
    seed: int = Field(1, ge=0, description="seed of the network's first weights and of splits")

    time_constants_h: tuple[float, ...] | None = Field(
        None, description="centres of the modes' priors, h, increasing; their number sets the order"
    )
    time_constant_log_sd: float = Field(0.25, gt=0, description="standard deviation of their logarithms")
    heat_capacity_Wh_m2K: float = Field(
        120.0, gt=0, description="prior: capacity of the slowest mode per floor area (EN ISO 13790 'very heavy': 103)"
    )
    heat_capacity_sd: float = Field(0.25, gt=0, description="its relative standard deviation")
    room_coupling_W_m2K: float = Field(
        27.0, gt=0, description="prior: room to structure per floor area (EN ISO 13790: 9.1 W/m²K times 3 m² per m²)"
    )
    room_coupling_sd: float = Field(0.35, gt=0, description="its relative standard deviation")
    start_slope_K_per_h: tuple[float, float] | None = Field(
        None,
        description="prior: mean and standard deviation of how fast full level moves the zone at first, K/h; by "
        "default that of heat that has to pass a slab or a radiator, which a room heated by its air exceeds tenfold",
    )

    sensor_sd_K: float = Field(0.01, gt=0, description="noise of the temperature sensor, K")
    disturbance_sd_K: tuple[float, ...] = Field(
        (0.02, 0.2, 2.0), description="what weather inputs leave unexplained, by time constant, K"
    )
    disturbance_hours: tuple[float, ...] = Field((0.5, 3.0, 50.0), description="these time constants, h")
    disturbance_margin: float = Field(
        10.0,
        gt=0,
        description="where less than that is left unexplained, how many times what is left is assumed instead",
    )

    @model_validator(mode="after")
    def _consistent(self) -> IdentificationConfig:
        if len(self.disturbance_sd_K) != len(self.disturbance_hours):
            raise ValueError("disturbance_sd_K and disturbance_hours must have the same number of values")
        if self.heat_capacity is not None and self.heat_input == "identity":
            raise ValueError("heat_capacity is given, but heat_input is identity: drop one of them")
        if self.method == "two_stage" and self.order not in ("auto", 1):
            raise ValueError(f"method two_stage is of order 1, but order is {self.order}")
        if self.start_slope_K_per_h is not None and self.start_slope_K_per_h[1] <= 0:
            raise ValueError(f"start_slope_K_per_h has standard deviation {self.start_slope_K_per_h[1]:g}: above 0")
        taus = self.time_constants_h
        if taus is not None:
            if not 1 <= len(taus) <= 3 or min(taus) <= 0 or any(b <= a for a, b in pairwise(taus)):
                raise ValueError(f"time_constants_h must be one to three increasing positive hours, got {taus}")
            if self.order not in ("auto", len(taus)):
                raise ValueError(f"time_constants_h has {len(taus)} values, but order is {self.order}")
        return self

    def orders(self) -> tuple[int, ...]:
        """Orders to try."""
        if self.time_constants_h is not None:
            return (len(self.time_constants_h),)
        return (1, 2, 3) if self.order == "auto" else (self.order,)

    def time_constants(self, order: int) -> tuple[float, ...]:
        """Centres of the modes' priors, h."""
        if self.time_constants_h is not None and len(self.time_constants_h) == order:
            return self.time_constants_h
        return DEFAULT_TIME_CONSTANTS_H[order]
