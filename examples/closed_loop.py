"""Run two controllers side by side on the embedded plant for two days and compare their KPIs."""

from dataclasses import replace

from controllers import ThermoForceMPC, Thermostat
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.embedded import EmbeddedPlant

plant = EmbeddedPlant(synthetic_weather())
window = replace(plant.period("peak_heat_day"), scored_s=2 * DAY_S)
model = identify_on(plant, before=window, days=3)

for controller in (ThermoForceMPC(model), Thermostat()):
    kpis = run_closed_loop(plant, controller, window).kpis
    print(f"{controller.name:16s} cost {kpis['cost_tot']:.4f} EUR/m²   discomfort {kpis['tdis_tot']:.2f} K·h")
