"""Predict the effect of actions: one hour of full heat against none, and five constant levels over a day."""

import numpy as np

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Observation
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.plants.embedded import EmbeddedPlant

plant = EmbeddedPlant(synthetic_weather())
window = plant.period("peak_heat_day")
model = identify_on(plant, before=window, days=3)
plant.reset(window.start_s, window.warmup_s)

predictor = Predictor(model.operator, build_free_response("chronos"))
context = predictor.context(Observation(plant.past(HOUR_S), plant.forecast(DAY_S, HOUR_S)))

off, one_hour = np.zeros(24), np.eye(24)[0]
print("One hour of full heat changes the zone by (K):", np.round(context.effect(one_hour, off)[0, [0, 3, 11, 23]], 3))
levels = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
for level, T in zip(levels, context.counterfactuals(levels).total_C[:, 0], strict=True):
    print(f"u = {level:.2f} all day: {T[5]:6.2f} °C in 6 h, {T[23]:6.2f} °C in 24 h")
