"""Use the controller class without a simulation loop: identify on the embedded plant and compute one plan."""

from controllers import ThermoForceMPC
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import Observation
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.plants.embedded import EmbeddedPlant

plant = EmbeddedPlant(synthetic_weather())
window = plant.period("peak_heat_day")
controller = ThermoForceMPC(identify_on(plant, before=window, days=3))

plant.reset(window.start_s, window.warmup_s)
history = plant.past(controller.step_s)
plan = controller.plan(Observation(history, plant.forecast(controller.horizon_s, controller.step_s)))

print(f"{plan.status}: {plan.why}")
for hour, (u, free, forced) in enumerate(zip(plan.u[0], plan.T_free_C[0], plan.T_forced_K[0], strict=True), start=1):
    print(f"+{hour:2d} h  u {u:4.2f}   free {free:6.2f} °C + forced {forced:5.2f} K = {free + forced:6.2f} °C")
