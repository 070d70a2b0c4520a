"""Assembly of the numbers of one instance from a prediction, prices and comfort bounds."""

from __future__ import annotations

import numpy as np

from controllers.actuation import Actuation
from controllers.backoff import backoff_K
from controllers.mpc_config import MPCConfig
from controllers.machinery import Machinery
from controllers.problem import Cooling, MPCProblem, PowerCap, Weights
from controllers.reserve import is_fast, reserve_K
from thermoforce_mpc.data import HOUR_S, Array, Boundary, Record
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictionContext


class Assembly:
    """Assembles instances of one controller.

    Args:
        config: options of the controller.
        actuation: its actuation, decided.
        power: electric power of the machine at that actuation.
        card: what is known of the model.
        step_s: control step, s.
    """

    def __init__(
        self, config: MPCConfig, actuation: Actuation, power: PowerModel, card: ModelCard, step_s: float
    ) -> None:
        self._config, self._actuation, self._power, self._card = config, actuation, power, card
        self._step_s = step_s

    def problem(
        self,
        operator: OperatorParameters,
        context: PredictionContext,
        history: Record,
        peak_W: float,
        offset_K: float = 0.0,
    ) -> MPCProblem:
        """Return the instance of one step.

        Args:
            operator: the operator of the zone's actuator, adjusted to the actuation.
            context: free response, forced state and boundary conditions of the N steps.
            history: the record until now, for the return water.
            peak_W: highest mean power of a step so far, W.
            offset_K: added to the free response, K.

        Raises:
            DataError: a bound or price of the boundary is missing.
        """
        c, boundary, T_free = self._config, context.boundary, context.free.median_C + offset_K
        aims = c.objective
        boundary.check("lower_C", "upper_C", "price_per_kWh")
        boundary.check("heating_price_per_kWh")
        carbon = np.zeros(boundary.n_steps)
        if aims.carbon_price_per_kg:
            boundary.check("emission_kg_per_kWh")
            carbon = aims.carbon_price_per_kg * boundary.emission_kg_per_kWh[:-1]
        price = boundary.heating_price_per_kWh[:-1] + carbon
        fixed_W, per_u_W = self._power.parts(boundary.T_out_C[:-1], self._return_water_C(context, history))
        low, high = c.backoff_level, c.backoff_level_other
        if operator.sign < 0:
            low, high = high, low
        below, above = (
            np.minimum(
                backoff_K(context.free, self._step_s, level, c.backoff_violation_K, below=is_lower), c.backoff_max_K
            )
            for level, is_lower in ((low, True), (high, False))
        )
        lower_C, upper_C = boundary.lower_C[1:], boundary.upper_C[1:]
        if is_fast(operator):
            # A bound holds until the next instant: such a zone would leave it in the last step before it ends.
            lower_C, upper_C = np.maximum(boundary.lower_C[:-1], lower_C), np.minimum(boundary.upper_C[:-1], upper_C)
        reserve = (
            reserve_K(operator, self._actuation, self._card) if c.reserve and not self._actuation.by_rooms else 0.0
        )
        machinery = self.machinery(operator)
        # Margins wider than half the band would swap the bounds.
        half = 0.5 * np.maximum(upper_C - lower_C, 0.0)
        lower_C = lower_C + np.minimum(c.comfort_margin_K + below + (reserve if operator.sign > 0 else 0.0), half)
        upper_C = upper_C - np.minimum(c.comfort_margin_K + above + (reserve if operator.sign < 0 else 0.0), half)
        terminal = self._terminal_price(operator, context.features[-1], price[-1] * (fixed_W + per_u_W)[-1])
        cap_kW = aims.power_cap_kW
        # One zone with one actuator: the only row of each array.
        return MPCProblem(
            forced_state_K=context.forced_K[None, None],
            features=context.features[None],
            T_free_C=T_free[None],
            lower_C=lower_C[None],
            upper_C=upper_C[None],
            price_per_kWh=price[None],
            power_fixed_W=fixed_W[None],
            power_per_u_W=per_u_W[None],
            step_s=self._step_s,
            machinery=machinery,
            weights=Weights(aims.comfort_weight, aims.curvature, aims.peak_price_per_kW / 1000.0),
            terminal_price_per_K=terminal[None, None],
            peak_so_far_W=peak_W,
            cooling=self._cooling(operator, boundary, boundary.price_per_kWh[:-1] + carbon),
            power_cap=None
            if cap_kW is None
            else PowerCap(np.full(boundary.n_steps, 1000.0 * cap_kW), aims.power_cap_price_per_kWh),
        )

    def machinery(self, operator: OperatorParameters) -> Machinery:
        """The machine of `operator` with its actuator, as the actuation runs it."""
        return Machinery.one(self._actuation.highest, self._actuation.lowest_level, operator.heat_input.lowest)

    def _cooling(self, operator: OperatorParameters, boundary: Boundary, price: Array) -> Cooling | None:
        """What levels below 0 cost at `price` (N,), currency/kWh; None where there are none."""
        load = self._power.cooling
        if load is None or operator.heat_input.lowest == 0.0:
            return None
        return Cooling(price[None], load(np.ones(boundary.n_steps), boundary.T_out_C[:-1])[None])

    def _return_water_C(self, context: PredictionContext, history: Record) -> Array | float:
        """Return water temperature while running, (N,), °C; NaN where the power model does not depend on it.

        The zone temperature is taken as the free response clipped to the comfort band: using the planned temperature
        would make the problem bilinear for less than 1 % of the power.
        """
        if self._power.water is None:
            return float("nan")
        boundary, T_free_C = context.boundary, context.free.median_C
        held_C = np.clip(T_free_C, boundary.lower_C[1:], boundary.upper_C[1:])
        return self._power.water.expected_C(history, held_C)

    def _terminal_price(self, operator: OperatorParameters, features: Array, cost_per_kW_h: float) -> Array:
        """Terminal value of each mode, (r,), currency/K; zero except for the slowest, which stores heat longest.

        At `terminal_value` 1 a kelvin is worth its production cost in the last step.
        """
        price = np.zeros(operator.order)
        drive = float(operator.drive(np.array([self._actuation.highest]), features[None])[0])
        per_step = cost_per_kW_h / 1000.0 * self._step_s / HOUR_S
        price[-1] = self._config.objective.terminal_value * per_step / (operator.gains[-1] * drive)
        return price
