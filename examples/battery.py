"""Add terms to the controller's problem by subclassing: a battery beside the heat pump, charged at low prices."""

import casadi as ca
import numpy as np

from controllers import ThermoForceMPC
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import Observation
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.plants.embedded import EmbeddedPlant


def battery(plan):
    """5 kWh with 2 kWh in it now, charged and discharged with up to 2 kW."""
    n, hours = plan.u.shape[1], plan.step_s / 3600
    charge, feed = (plan.variable(name, n, 0, 2.0) for name in ("charge_kW", "feed_kW"))
    stored = plan.variable("stored_kWh", n, 0, 5.0)
    before = ca.horzcat(2.0, stored[:, :-1])
    plan.equal(stored - before - hours * (0.95 * charge - feed), "battery")
    plan.require(ca.sum1(plan.power_W) / 1000 - feed, "the battery feeds the heat pump only")
    price = ca.DM(np.where(np.arange(n) * hours % 24 < 6, 0.15, 0.30)).T  # cheap until six
    plan.add_cost(hours * ca.dot(price, charge) - hours * ca.dot(price, feed))


class WithBattery(ThermoForceMPC):
    """The MPC with the battery in its problem."""

    def terms(self):
        """Called while the controller is built, when only `self.config` is set."""
        return (*super().terms(), battery)


plant = EmbeddedPlant(synthetic_weather())
window = plant.period("peak_heat_day")
controller = WithBattery(identify_on(plant, before=window, days=3))

plant.reset(window.start_s, window.warmup_s)
history = plant.past(controller.step_s)
plan = controller.plan(Observation(history, plant.forecast(controller.horizon_s, controller.step_s)))

print(f"{plan.status}: {plan.why}")
for hour in (6, 12, 24):
    print(f"stored after {hour} h: {plan.own['stored_kWh'][hour * 4 - 1].clip(min=0):.2f} kWh")
