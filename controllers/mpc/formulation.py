"""Assembly of the numbers of one instance from a prediction, prices and comfort bounds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuators import Actuators
from controllers.mpc.config import MPCConfig
from controllers.mpc.margins import LearnedMargin, backoff_K, is_fast, learned_share, reserve_K
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.problem import Cooling, MPCProblem, PowerCap, Weights
from thermoforce_mpc.data import J_PER_KWH, Array, Boundary, Record
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel

# Share of the highest level from which an actuator counts as fully used.
_FULLY_USED = 0.95


class Formulation:
    """Assembles instances of one controller.

    Args:
        config: options of the controller.
        model: the building, with the power of every machine.
        actuators: how its actuators are run.
    """

    def __init__(self, config: MPCConfig, model: ThermalModel, actuators: Actuators) -> None:
        self._config, self._actuators, self._layout = config, actuators, model.layout
        self._cards, self._step_s = model.cards, model.operator.step_s
        layout, each = self._layout, actuators.each
        self.power = tuple(
            _measured(power).at_lowest_level(each[fed[0]].lowest_level) if len(fed) == 1 else _measured(power)
            for power, fed in ((power, layout.fed_by(m)) for m, power in enumerate(model.power))
        )
        self.machinery = EquipmentLayout(
            layout.names.actuators,
            layout.names.machines,
            np.array([actuation.highest for actuation in each]),
            np.array([actuation.lowest_level for actuation in each]),
            np.array(layout.lowest),
            np.array(layout.machine_of),
            np.array(layout.shares),
            tuple(power.load.lowest_level if power.load.lowest_level < 1.0 else 0.0 for power in self.power),
            layout.exclusive,
        )
        aims = config.objective
        # Choices, rows of power and Ipopt take power as linear in u: its chord, which is too high at part load.
        self._straight = (
            aims.peak_price_per_kW > 0
            or aims.power_cap_kW is not None
            or config.solver in ("milp", "ipopt")
            or bool(self.machinery.held.any() or layout.exclusive)
            or model.operator.of_actuator(0).feedback_active
        )

    def problem(
        self,
        operator: BuildingOperator,
        context: PredictionContext,
        history: Record,
        peak_W: float,
        offset_K: Array,
        missed: LearnedMargin | None = None,
        kept: Array | None = None,
    ) -> MPCProblem:
        """Return the instance of one step.

        Args:
            operator: the operator of the building, adjusted to the actuation.
            context: free response, forced state and boundary conditions of the N steps.
            history: the record until now, for the return water.
            peak_W: highest mean power of the building over a step so far, W.
            offset_K: added to the free response (Z,), K.
            missed: what was learned of the bounds; by default nothing.
            kept: share of each machine's capacity that is left unused (M,); by default none.

        Raises:
            DataError: a bound or price of the boundary is missing.
        """
        aims, boundary, layout = self._config.objective, context.boundary, self._layout
        boundary.check("lower_C", "upper_C", "price_per_kWh")
        boundary.check("heating_price_per_kWh")
        carbon = np.zeros((len(layout.names.machines), boundary.n_steps))
        if aims.carbon_price_per_kg:
            boundary.check("emission_kg_per_kWh")
            carbon = aims.carbon_price_per_kg * boundary.emission_kg_per_kWh[:, :-1]
        price = boundary.heating_price_per_kWh[:, :-1] + carbon
        # At a negative price it would pay to heat and cool at once, which a signed level cannot say.
        both = self.machinery.fed_by[:, self.machinery.signed].any(axis=-1, keepdims=True)
        price = np.where(both, np.maximum(price, 0.0), price)
        T_out = boundary.T_out_C[:-1]
        water_C = [self._return_water_C(m, context, history) for m in range(len(self.power))]
        parts = [power.parts(T_out, back_C) for power, back_C in zip(self.power, water_C, strict=True)]
        fixed_W = np.stack([np.broadcast_to(fixed, T_out.shape) for fixed, _ in parts])
        per_u_W = np.stack(
            [
                weight * np.broadcast_to(parts[m][1], T_out.shape)
                for weight, m in zip(self._layout.weights, layout.machine_of, strict=True)
            ]
        )
        bends = [
            np.broadcast_to(power.curve_W(back_C), T_out.shape)
            for power, back_C in zip(self.power, water_C, strict=True)
        ]
        per_u2_W = np.stack([weight * bends[m] for weight, m in zip(layout.weights, layout.machine_of, strict=True)])
        if self._straight:
            per_u_W = per_u_W + per_u2_W
        bent = bool(per_u2_W.any()) and not self._straight
        highest, fed_by = self.machinery.u_max, list(layout.machine_of)
        highest_W = np.array(layout.weights) * fixed_W[fed_by, -1] + per_u_W[:, -1] * highest
        if bent:
            highest_W = highest_W + per_u2_W[:, -1] * highest**2
        lower_C, upper_C = self._bounds_C(operator, context, missed or LearnedMargin.nothing(len(operator.zones)))
        cap_kW = aims.power_cap_kW
        return MPCProblem(
            forced_state_K=context.forced_K,
            features=context.features,
            T_free_C=context.free.median_C + offset_K[:, None],
            lower_C=lower_C,
            upper_C=upper_C,
            price_per_kWh=price,
            power_fixed_W=fixed_W,
            power_per_u_W=per_u_W,
            step_s=self._step_s,
            machinery=self.machinery,
            weights=Weights(aims.comfort_weight, aims.curvature, aims.peak_price_per_kW / 1000.0),
            terminal_price_per_K=self._terminal_price(operator, context.features[:, -1], price[fed_by, -1] * highest_W),
            peak_so_far_W=peak_W,
            cooling=self._cooling(boundary, np.maximum(boundary.price_per_kWh[:, :-1] + carbon, 0.0)),
            power_cap=None
            if cap_kW is None
            else PowerCap(np.full(boundary.n_steps, 1000.0 * cap_kW), aims.power_cap_price_per_kWh),
            power_per_u2_W=per_u2_W if bent else None,
            capacity=self._capacity(operator, T_out, kept),
        )

    def spare(self, used: Array) -> NDArray[np.bool_]:
        """Whether actuators that protect the lower and the upper bound of each zone had more to give (2, Z).

        `used` (A,): mean level of the last step.
        """
        more = np.zeros((2, len(self._layout.names.zones)), dtype=bool)
        for a, (z, sign) in enumerate(zip(self._layout.home, self._layout.signs, strict=True)):
            if self._config.reserve and used[a] < _FULLY_USED * self._actuators.each[a].highest:
                more[0 if sign > 0 else 1, z] = True
        return more

    def kept_capacity(self, before: Array, operator: BuildingOperator, history: Record) -> Array:
        """Share of each machine's capacity to be left unused (M,) after the last step of `history`."""
        kept = before.copy()
        for m, fed, full, reference_W in self._metered(operator, history.T_out_C[-2:-1]):
            u, heat_W = history.u[fed, -1], history.heat_W[fed, -1]
            full_W, share = full[:, 0] * reference_W, self.machinery.share[fed]
            most_W = float(np.mean(reference_W / share))
            load = float((share * u * full[:, 0]).sum())
            kept[m] = learned_share(float(before[m]), load, most_W, heat_W, u * full_W, u, self._step_s)
        return kept

    def expected_power_W(self, a: int, record: Record) -> Array:
        """Electric power (n,), W, for the levels of actuator `a` in a record of its own."""
        levels = np.clip(record.u[0], self._layout.lowest[a], 1.0)
        return self.power[self._layout.machine_of[a]](levels, record.T_out_C[:-1], record.T_return_C[0])

    def _capacity(self, operator: BuildingOperator, T_out_C: Array, kept: Array | None) -> Array | None:
        """What the actuators of each machine may take together (M, N), in the unit of their shares; None: 1.

        Metered actuators take more at full level the colder it is. Their shares, those of the record's mean, are taken
        as those at 0 °C: after a mild record that asks for some too much, which `kept` (M,), the share to be left
        unused, takes back. What the machine has is taken as constant.
        """
        found = np.ones((len(self._layout.names.machines), T_out_C.size))
        if kept is not None:
            found *= 1.0 - kept[:, None]
        for m, fed, full, _ in self._metered(operator, T_out_C):
            shares = self.machinery.share[fed]
            found[m] *= shares.sum() / (shares @ full)
        return None if (found == 1.0).all() else found

    def _metered(self, operator: BuildingOperator, T_out_C: Array) -> Iterator[tuple[int, list[int], Array, Array]]:
        """Machines with known shares whose several actuators are all metered: number, actuators, heat at full level.

        The heat (A of the machine, n) is relative to that at the reference outdoors, 0 °C, which follows (A,), W.
        """
        for m in np.flatnonzero(self.machinery.shared).tolist():
            fed = self._layout.fed_by(m)
            maps = [operator.of_actuator(a).heat_input for a in fed]
            if self.machinery.share[fed].all() and all(one.heat is not None for one in maps):
                full = np.stack([one(np.ones(T_out_C.size), T_out_C) for one in maps])
                yield m, fed, full, np.array([one.reference_W for one in maps])

    def _bounds_C(
        self, operator: BuildingOperator, context: PredictionContext, missed: LearnedMargin
    ) -> tuple[Array, Array]:
        """Comfort bounds at the end of each step with all margins inside, (Z, N) each, °C."""
        c, boundary = self._config, context.boundary
        rows = []
        for z in range(len(operator.zones)):
            own = self._layout.actuators_of(z)
            signs = {self._layout.signs[a] for a in own}
            # The bound that actuation protects has the chance level of its own; both, where heat and cold are at hand.
            low = c.backoff_level if 1 in signs or not own else c.backoff_level_other
            high = c.backoff_level if -1 in signs else c.backoff_level_other
            below, above = (
                np.minimum(
                    backoff_K(context.free, self._step_s, level, c.backoff_violation_K, below=is_lower)[z],
                    c.backoff_max_K,
                )
                for level, is_lower in ((low, True), (high, False))
            )
            lower_C, upper_C = boundary.lower_C[z, 1:], boundary.upper_C[z, 1:]
            if any(is_fast(operator.of_actuator(a)) for a in own):
                # A bound holds until the next instant: such a zone would leave it in the last step before it ends.
                lower_C = np.maximum(boundary.lower_C[z, :-1], lower_C)
                upper_C = np.minimum(boundary.upper_C[z, :-1], upper_C)
            # Margins wider than half the band would swap the bounds.
            half = 0.5 * np.maximum(upper_C - lower_C, 0.0)
            by_loops = any(self._actuators.each[a].by_rooms for a in own)
            learned = missed.inside_K(z, lower_C, upper_C, by_loops=by_loops)
            inside = {sign: self._reserve_K(operator, z, sign) + learned[i] for i, sign in enumerate((1, -1))}
            rows.append(
                (
                    lower_C + np.minimum(c.comfort_margin_K + below + inside[1], half),
                    upper_C - np.minimum(c.comfort_margin_K + above + inside[-1], half),
                )
            )
        return np.stack([lower for lower, _ in rows]), np.stack([upper for _, upper in rows])

    def _reserve_K(self, operator: BuildingOperator, z: int, sign: int) -> float:
        """Reserve inside the bound that the actuators of one sign protect in zone `z`, K."""
        found = [
            reserve_K(operator.of_actuator(a), self._actuators.each[a], self._cards[a])
            for a in self._layout.actuators_of(z)
            if self._layout.signs[a] == sign and self._keeps_reserve(a)
        ]
        return max(found, default=0.0)

    def _keeps_reserve(self, a: int) -> bool:
        return self._config.reserve and not self._actuators.each[a].by_rooms

    def _cooling(self, boundary: Boundary, price: Array) -> Cooling | None:
        """What levels below 0 cost at `price` (M, N), currency/kWh; None where there are none."""
        if not any(lowest < 0.0 for lowest in self._layout.lowest):
            return None
        full = np.ones(boundary.n_steps)
        per_u_W = []
        for lowest, m, weight in zip(self._layout.lowest, self._layout.machine_of, self._layout.weights, strict=True):
            load = self.power[m].cooling if lowest < 0.0 else None
            per_u_W.append(0.0 * full if load is None else weight * load(full, boundary.T_out_C[:-1]))
        return Cooling(price[list(self._layout.machine_of)], np.stack(per_u_W))

    def _return_water_C(self, m: int, context: PredictionContext, history: Record) -> Array | float:
        """Return water temperature of machine `m` while running, (N,), °C; NaN where its power does not depend on it.

        The zone temperature is taken as the free response clipped to the comfort band: using the planned temperature
        would make the problem bilinear for less than 1 % of the power.
        """
        water = self.power[m].water
        if water is None:
            return float("nan")
        a = self._layout.fed_by(m)[0]
        z = self._layout.home[a]
        boundary = context.boundary
        held_C = np.clip(context.free.median_C[z], boundary.lower_C[z, 1:], boundary.upper_C[z, 1:])
        return water.expected_C(history.part(z, [a], [m]), held_C)

    def _terminal_price(self, operator: BuildingOperator, features: Array, price_W: Array) -> Array:
        """Terminal value of each mode, (Z, A, r), currency/K; zero except for the slowest, which stores heat longest.

        At `terminal_value` 1 a kelvin of an actuator's home zone is worth its production cost in the last step.
        `features` (Z, 4) and `price_W` (A,), price per kWh times power at the highest level, W, are of that step.
        """
        value = np.zeros(operator.shape)
        if not self._config.objective.terminal_value:
            return value
        cost = price_W * self._step_s / J_PER_KWH
        for a, z in enumerate(self._layout.home):
            pair = operator.of_actuator(a)
            drive = float(pair.drive(self.machinery.u_max[a : a + 1], features[z][None])[0])
            stored = pair.gains[-1] * drive
            value[z, a, -1] = self._config.objective.terminal_value * cost[a] / stored if stored else 0.0
        return value


def _measured(power: PowerModel | None) -> PowerModel:
    assert power is not None  # checked when the controller is built
    return power
