"""The numbers of one instance of the problem, from a prediction, prices, margins and what overrides hold."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from controllers.actuation.actuators import Actuators
from controllers.mpc.config import MPCConfig
from controllers.mpc.margins import Bounds, MarginRules, Margins
from controllers.mpc.state import highest_of_days_W, metered_W
from controllers.optimisation.problem import Cooling, EquipmentLayout, Exchange, MPCProblem, PowerCap, Weights
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import DAY_S, Array, Boundary, Record
from thermoforce_mpc.model.machine.blocked_hours import Directions, HourEffects
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel

# A zone's discomfort counts as at least this many times the heat that would have avoided it over a day. By judgement,
# when random offices joined `bench buildings` (2026-11-25): at 1 plans would trade comfort for heat as they trade
# hours.
_COMFORT_OVER_HEAT = 5.0
# Power that no building takes: no limit, W.
_NO_LIMIT_W = 1e7


class Instance(NamedTuple):
    """One instance of the problem, its comfort bounds with the margins inside them, and what was changed in it.

    `cap_W`: what a power cap leaves for all machines in the first step, W; infinite without one.
    """

    problem: MPCProblem
    bounds: Bounds
    cap_W: float
    news: str

    def asking(self, a: int, level: float, steps: int) -> Instance:
        """The same with at least `level` of actuator `a` in the first steps; a level below 0: with at most that."""
        least, most = (bounds.copy() for bounds in self.problem.level_bounds)
        if level > 0.0:
            least[a, :steps] = np.minimum(level, most[a, :steps])
        else:
            most[a, :steps] = np.maximum(level, least[a, :steps])
        return self._replace(problem=replace(self.problem, least_u=least, most_u=most))


class _Power(NamedTuple):
    """Power of machines while they run (M, N), and of actuators by their level and its square (A, N), W.

    `bent`: whether plans count with the square; `highest_W` (A,): of the highest levels in the last step.
    """

    fixed_W: Array
    per_u_W: Array
    per_u2_W: Array
    bent: bool
    highest_W: Array


class Formulation:
    """Formulates the instances of one controller.

    `model`: with the power of every machine; `powers` (M,): power of each machine as plans count with it.
    """

    def __init__(
        self, config: MPCConfig, model: ThermalModel, actuators: Actuators, powers: Sequence[PowerModel]
    ) -> None:
        self._config, self._actuators, self._layout = config, actuators, model.layout
        self._step_s, self.margins = model.operator.step_s, MarginRules(config, model, actuators)
        layout, each = self._layout, actuators.each
        self.power, self._expected = (
            tuple(
                power.at_lowest_level(each[fed[0]].lowest_level) if len(fed) == 1 else power
                for power, fed in zip(of, layout.actuators_of_machines, strict=True)
            )
            # The controller was refused where one is not known.
            for of in (powers, [power for power in model.power if power is not None])
        )
        self.machinery = EquipmentLayout(
            layout.names.actuators,
            layout.names.machines,
            np.array([actuation.highest for actuation in each]),
            np.array([actuation.lowest_level for actuation in each]),
            np.array(layout.u_min),
            np.array(layout.machine_of),
            np.array(layout.shares),
            tuple(power.load.lowest_level if power.load.lowest_level < 1.0 else 0.0 for power in self.power),
            layout.exclusive,
        )
        # Choices take power as linear in u: as at the level below which an actuator switches.
        self._straight = config.solver == "milp" or bool(layout.exclusive)
        self.bent = not self._straight and any(power.load.curve_W for power in self.power)

    def instance(
        self,
        operator: BuildingOperator,
        context: PredictionContext,
        history: Record,
        margins: Margins,
        peak_W: float = 0.0,
        hours: Sequence[tuple[Directions, HourEffects]] = (),
        overridden: Collection[int] = (),
        good: GoodPlan | None = None,
    ) -> Instance:
        """Return the instance of one step.

        `operator`: adjusted to the actuation; `context`: of the N steps; `history`: for the return water and the size
        of peaks; `margins`, `peak_W`: what was learned, and the highest mean power of the building over a step so far,
        W; `hours` (A,): those in which nothing comes from an actuator, and what acting does by hour of the day;
        `overridden`: numbers of the actuators that will not follow the plan; `good`: the last plan.

        Raises:
            DataError: a bound or price of the boundary is missing.
        """
        aims, boundary = self._config.objective, context.boundary
        price, carbon = self._prices(boundary)
        power = self._power(context, history)
        foreign_W, left_W = self._beside(boundary, history)
        exchange, sold = self._exchange(boundary, price)
        dearest = price.max(axis=1)[list(self._layout.machine_of)]
        comfort, heat, news = self._comfort_weights(operator, context.features[:, -1], dearest * power.highest_W)
        T_C = history.T_zone_C[:, -1]
        bounds = self.margins.bounds(operator, context.free, boundary, margins.learned, T_C, heat / comfort, good)
        bounds = self._left_to_others(bounds, boundary, T_C, overridden)
        problem = MPCProblem(
            forced_state_K=context.forced_K,
            features=context.features,
            T_free_C=context.free.median_C + margins.moved_K[:, None] + self._dips_K(boundary, hours),
            lower_C=bounds.lower_C,
            upper_C=bounds.upper_C,
            price_per_kWh=sold,
            power_fixed_W=power.fixed_W,
            power_per_u_W=power.per_u_W,
            step_s=self._step_s,
            machinery=self.machinery,
            weights=Weights(comfort, aims.curvature, self._peak_per_W(history, boundary)),
            peak_so_far_W=max(max(peak_W, 1000.0 * aims.peak_least_kW) - float(foreign_W.mean()), 0.0),
            cooling=self._cooling(boundary, np.maximum(boundary.price_per_kWh[:, :-1] + carbon, 0.0)),
            power_cap=self._cap(power, left_W),
            exchange=exchange,
            power_per_u2_W=power.per_u2_W if power.bent else None,
            capacity=self.margins.capacity(operator, boundary.T_out_C[:-1], margins.unused),
            last_u=self._last_u(history),
            available=self._available(boundary, hours, context.free.median_C),
            most_u=self.margins.most_u(operator, margins.unused, boundary.n_steps),
        )
        return Instance(problem, bounds, float(left_W[0]), news)

    def _prices(self, boundary: Boundary) -> tuple[Array, Array]:
        """Price of energy of each machine and what carbon adds to it (M, N), per kWh."""
        boundary.check("lower_C", "upper_C", "price_per_kWh")
        boundary.check("heating_price_per_kWh")
        per_kg = self._config.objective.carbon_price_per_kg
        carbon = np.zeros((len(self._layout.names.machines), boundary.n_steps))
        if per_kg:
            boundary.check("emission_kg_per_kWh")
            carbon = per_kg * boundary.emission_kg_per_kWh[:, :-1]
        price = boundary.heating_price_per_kWh[:, :-1] + carbon
        # At a negative price it would pay to heat and cool at once, which a signed level cannot say.
        both = self.machinery.fed_by[:, self.machinery.signed].any(axis=-1, keepdims=True)
        return np.where(both, np.maximum(price, 0.0), price), carbon

    def _power(self, context: PredictionContext, history: Record) -> _Power:
        """What levels take over the steps."""
        T_out, layout, every = context.boundary.T_out_C[:-1], self._layout, np.ones(context.boundary.n_steps)
        water_C = [self._return_water_C(m, context, history) for m in range(len(self.power))]
        parts = [power.parts(T_out, back_C) for power, back_C in zip(self.power, water_C, strict=True)]
        fixed_W = np.array([fixed * every for fixed, _ in parts])
        per_actuator = list(zip(layout.weights, layout.machine_of, strict=True))
        per_u_W = np.array([weight * parts[m][1] * every for weight, m in per_actuator])
        bends = [power.curve_W(back_C) * every for power, back_C in zip(self.power, water_C, strict=True)]
        per_u2_W = np.array([weight * bends[m] for weight, m in per_actuator])
        if self._straight:
            per_u_W = per_u_W + per_u2_W * np.minimum(self.machinery.lowest_level, self.machinery.u_max)[:, None]
        bent = self.bent and bool(per_u2_W.any())
        highest, fed_by = self.machinery.u_max, list(layout.machine_of)
        highest_W = np.array(layout.weights) * fixed_W[fed_by, -1] + per_u_W[:, -1] * highest
        if bent:
            highest_W = highest_W + per_u2_W[:, -1] * highest**2
        return _Power(fixed_W, per_u_W, per_u2_W, bent, highest_W)

    def _beside(self, boundary: Boundary, history: Record) -> tuple[Array, Array]:
        """What other loads on the meters of machines take, and what a cap leaves for machines, W (N,)."""
        aims, T_out = self._config.objective, boundary.T_out_C[:-1]
        seen = (self._seen(m, history.u[fed], history, m) for m, fed in enumerate(self._layout.actuators_of_machines))
        foreign = [power.foreign for power in seen if power.foreign is not None]
        foreign_W = sum((other(boundary.time_s[:-1], T_out) for other in foreign), np.zeros(boundary.n_steps))
        cap_kW = math.inf if aims.power_cap_kW is None else aims.power_cap_kW
        left_W = np.maximum(1000.0 * cap_kW - foreign_W, 0.0)
        if aims.at_the_meter and boundary.limit_W.size:
            left_W = np.minimum(left_W, boundary.limit_W[:-1])
        return foreign_W, left_W

    def _left_to_others(
        self, bounds: Bounds, boundary: Boundary, T_zone_C: Array, overridden: Collection[int]
    ) -> Bounds:
        """Bounds of zones none of whose actuators follow the plan: no more is asked of them than what holds now.

        Otherwise neighbours would be heated for a zone that its own control leaves outside the comfort band.
        """
        lower_C, upper_C = bounds.lower_C.copy(), bounds.upper_C.copy()
        for z, now_C in enumerate(T_zone_C):
            own = self._layout.actuators_of(z)
            if own and set(own) <= set(overridden):
                lower_C[z] = np.fmin(boundary.lower_C[z, 1:], now_C)
                upper_C[z] = np.fmax(boundary.upper_C[z, 1:], now_C)
        return replace(bounds, lower_C=lower_C, upper_C=upper_C)

    def _dips_K(self, boundary: Boundary, hours: Sequence[tuple[Directions, HourEffects]]) -> Array:
        """What hours of the day do to each zone besides (Z, N), K: as the actuator says that saw most of it."""
        dips_K = np.zeros((len(self._layout.names.zones), boundary.n_steps))
        for z, (_, effects) in zip(self._layout.home, hours, strict=False):
            own_K = effects.dips_K(boundary.time_s[:-1], self._step_s)
            dips_K[z] = np.where(np.abs(own_K) > np.abs(dips_K[z]), own_K, dips_K[z])
        return dips_K

    def _available(
        self, boundary: Boundary, hours: Sequence[tuple[Directions, HourEffects]], T_free_C: Array
    ) -> Array | None:
        """Share of what a level does that comes from each actuator in each step (A, N); None: all.

        Of signed levels that of heating where the free response `T_free_C` (Z, N) is below the middle of the band, else
        that of cooling.
        """
        if not any(effects.laws or any(way.hours for way in directions) for directions, effects in hours):
            return None
        middle_C, rows = 0.5 * (boundary.lower_C + boundary.upper_C)[:, 1:], []
        for z, (directions, effects) in zip(self._layout.home, hours, strict=True):
            ways = [way.available(boundary.time_s[:-1], self._step_s) for way in directions]
            comes = np.where(T_free_C[z] < middle_C[z], ways[0], ways[-1])
            rows.append(comes * effects.share(boundary.time_s[:-1], self._step_s))
        return np.stack(rows)

    def _peak_per_W(self, history: Record, boundary: Boundary) -> float:
        aims, highest_kW = self._config.objective, np.empty(0)
        if aims.peak_steps:
            power_W = metered_W(history, boundary, at_the_meter=aims.at_the_meter)
            highest_kW = np.array(list(highest_of_days_W(history, power_W).values())) / 1000.0
        return aims.peak_per_kW(highest_kW) / 1000.0 / (3.0 if aims.peak_of == "three_days" else 1.0)

    def _exchange(self, boundary: Boundary, price: Array) -> tuple[Exchange | None, Array]:
        """What the meter sees, and the price of energy (M, N): of what is fed in, where there is a surplus.

        `price` (M, N): of what is bought. Nothing earns more than it costs: who fed in dearly what he bought would run
        machines for nothing. Where others are not known they take nothing.
        """
        if not self._config.objective.at_the_meter:
            return None, price
        others_W = np.nan_to_num(boundary.others_W[:-1]) if boundary.others_W.size else np.zeros(boundary.n_steps)
        earns = np.nan_to_num(boundary.export_per_kWh[:-1]) if boundary.export_per_kWh.size else np.zeros(others_W.size)
        sold = np.where(others_W < 0.0, np.minimum(price, earns), price)
        return Exchange(others_W, (price - sold).max(axis=0)), sold

    def _cap(self, power: _Power, limit_W: Array) -> PowerCap | None:
        """The power cap over the steps, as far as blocks use it.

        Of `limit_W` (N,) one actuator takes what whole blocks take. Several take turns: half the smallest block is left
        on average.
        """
        aims, each, step_s = self._config.objective, self._actuators.each, self._step_s
        if aims.power_cap_kW is None and not aims.at_the_meter:
            return None
        limit_W = np.minimum(limit_W, _NO_LIMIT_W)
        level = np.array([actuation.block_level for actuation in each])[:, None]
        machine_of = self.machinery.machine_of
        alone = ~self.machinery.shared[machine_of, None]
        bends_W = power.per_u2_W * (0.0 if self._straight else level**2)
        block_W = alone * power.fixed_W[machine_of] + power.per_u_W * level + bends_W
        if len(each) == 1 and each[0].switches:
            on_s = [each[0].longest_on_s(share * step_s, step_s) for share in limit_W / block_W[0]]
            limit_W = np.where(limit_W < block_W[0], np.array(on_s) / step_s * block_W[0], limit_W)
        elif all(actuation.switches and not actuation.modulates for actuation in each):
            share = np.array([actuation.config.block_s / step_s for actuation in each])[:, None]
            limit_W = np.maximum(limit_W - 0.5 * (share * block_W).min(axis=0), 0.0)
        return PowerCap(limit_W, aims.power_cap_price_per_kWh)

    def expected_power_W(self, a: int, record: Record, first: int) -> Array:
        """What the meter of its machine shows, W, for the levels of actuator `a` in a record of its own (n steps), from
        step `first` on (n − first,).
        """
        power, record = self._seen(self._layout.machine_of[a], record.u, record, 0), record.slice(first, record.n_steps)
        levels = np.clip(record.u[0], self._layout.u_min[a], 1.0)
        return power.metered(levels, record.time_s[:-1], record.T_out_C[:-1], record.T_return_C[0])

    def _seen(self, m: int, u: Array, record: Record, row: int) -> PowerModel:
        """The power expected of machine `m`, with levels `u` (A, n) of all that it feeds and its meter in `row`."""
        return self._expected[m].seen(u, record.time_s[:-1], record.T_out_C[:-1], record.power_W[row])

    def _comfort_weights(self, operator: BuildingOperator, features: Array, price_W: Array) -> tuple[Array, Array, str]:
        """Penalty on comfort violation (Z,), currency/(K·h), what the heat costs that avoids one, infinite where there
        is none, and which penalties were raised so that heat stays cheaper.

        What avoids a K·h costs the heat of a day at full level over what it adds to the zone, from rest. `features`
        (Z, 4) are those of the last step, `price_W` (A,) is the highest price per kWh times power at full level, W.
        """
        weights = self._config.objective.comfort_weights(self._layout.floor_area_m2)
        steps = round(DAY_S / self._step_s)
        heat, names = np.full(weights.shape, np.inf), self._layout.names.zones
        for a, z in enumerate(self._layout.home):
            pair = operator.of_actuator(a)
            mean_K = abs(float(pair.step_response(steps).mean())) * self._full_drive(pair, a, features[z])
            if mean_K > 0.0:
                heat[z] = min(heat[z], max(price_W[a], 0.0) / 1000.0 / mean_K)
        least = np.where(np.isfinite(heat), _COMFORT_OVER_HEAT * heat, 0.0)
        raised = [
            (f"{names[z]}: " if len(names) > 1 else "")
            + f"a K·h of discomfort counts {least[z]:.3g} instead of {weights[z]:.3g}, since the heat that avoids it "
            f"costs {heat[z]:.3g}"
            for z in np.flatnonzero(least > weights)
        ]
        return np.maximum(weights, least), heat, "; ".join(raised)

    def _full_drive(self, pair: OperatorParameters, a: int, features: Array) -> float:
        """Drive of actuator `a` at its highest level, with `features` (4,) of its home zone."""
        return float(pair.drive(self.machinery.u_max[a : a + 1], features[None])[0])

    def _last_u(self, history: Record) -> Array:
        """Levels of the last step of the record (A,), within their bounds; 0 where they are not known."""
        last = history.u[:, -1] if history.u.shape[1] else np.zeros(len(self._layout.u_min))
        return np.clip(np.where(np.isfinite(last), last, 0.0), self.machinery.u_min, self.machinery.u_max)

    def _cooling(self, boundary: Boundary, price: Array) -> Cooling | None:
        """What levels below 0 cost at `price` (M, N), currency/kWh; None where there are none."""
        if not any(u_min < 0.0 for u_min in self._layout.u_min):
            return None
        full = np.ones(boundary.n_steps)
        per_u_W = []
        for u_min, m, weight in zip(self._layout.u_min, self._layout.machine_of, self._layout.weights, strict=True):
            load = self.power[m].cooling if u_min < 0.0 else None
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
