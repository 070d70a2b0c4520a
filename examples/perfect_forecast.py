"""What the controller would reach if it knew the free response, and what its own forecasts missed on the worst day.

    python examples/perfect_forecast.py [WEATHER.mos [START_DAY [DAYS [PASSES]]]]

The first run is that of `tf-mpc run`. What the zone did without control follows from it (T − F), and each further run
plans with the free response of the run before as its forecast. The forced response is the model's, so an error of it is
in what is called known, and the passes need not settle: they give a range. Every run goes two days beyond the scored
ones, since plans look 48 h ahead. Without arguments: synthetic weather, one day from the peak heat day, one pass.
"""

import sys
from pathlib import Path

import numpy as np

from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.boundary.tariffs import by_name
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.experiment.experiment import Experiment, scored_period
from thermoforce_mpc.experiment.identifying import model_for
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_scenario

LEVELS = np.arange(1, 10) / 10


class Known:
    """`FreeResponse` that is known: `free_C` at the instants `time_s`, without any uncertainty."""

    name = "known"

    def __init__(self, time_s: Array, free_C: Array) -> None:
        self._time_s, self._free_C = time_s, free_C

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`."""
        ahead = np.interp(boundary.time_s[1:], self._time_s, self._free_C)
        return FreeForecast(LEVELS, np.tile(ahead, (LEVELS.size, 1)), "known")


def scores(plant: EmbeddedPlant, start_s: float, end_s: float) -> tuple[float, float, float]:
    """Return energy cost in EUR/m² at the constant tariff, and discomfort in K·h too cold and too warm."""
    record = plant.recorded(start_s, end_s)
    time_s, T_C = record["time"], record["T_operative"] - 273.15
    lower, upper = plant.case.schedule.bounds_C(time_s)
    power_kW = (record["P_heat_pump"] + record["P_fan"] + record["P_pump"]) / 1000
    cost = np.trapezoid(power_kW * by_name(None)["constant"](time_s), time_s / HOUR_S) / plant.case.house.area_m2
    cold, warm = (np.trapezoid(np.maximum(x, 0), time_s / HOUR_S) for x in (lower - T_C, T_C - upper))
    return float(cost), float(cold), float(warm)


weather, start, days, passes = (sys.argv[1:] + ["synthetic", "peak_heat_day", "1", "1"][len(sys.argv) - 1 :])[:4]
weather = weather if weather == "synthetic" else str(Path(weather).resolve())
scenario = load_scenario(
    None,
    {
        "testcase": "bestest_hydronic_heat_pump",
        "period": start,
        "days": float(days) + 2,
        "plant": {"kind": "embedded", "weather": weather},
    },
)
experiment = Experiment.of(scenario)
plant = experiment.plant.build()
assert isinstance(plant, EmbeddedPlant)
window = scored_period(plant, scenario.period, scenario.days)
scored_end_s = window.start_s + float(days) * DAY_S
source = experiment.own.model_from
assert source is not None
controller = ThermoForceMPC(model_for(source, plant))

for number in range(int(passes) + 1):
    run = run_closed_loop(plant, controller, window)
    cost, cold, warm = scores(plant, window.start_s, scored_end_s)
    what = "as it is" if number == 0 else f"free response known, pass {number}"
    print(f"{what}: {cost:.4f} EUR/m2, {cold:.2f} K.h too cold, {warm:.2f} K.h too warm")
    history = plant.past(controller.step_s)
    free_C, T_zone_C = controller.predictor.free_history(history)[0], history.T_zone_C[0]
    if number == 0:
        scored = (history.time_s > window.start_s + DAY_S / 2) & (history.time_s <= scored_end_s)
        above_K = np.where(scored, T_zone_C - plant.case.schedule.bounds_C(history.time_s)[1], -np.inf)
        worst = int(np.argmax(above_K))
        at_s = history.time_s[worst]
        print(f"warmest on day {at_s / DAY_S:.2f} ({above_K[worst]:+.2f} K to the upper bound); what plans missed:")
        for hours in (2, 4, 6, 8, 12, 24, 36, 48):
            plan = next((s.plan for s in run.steps if abs(s.time_s - at_s + hours * HOUR_S) < 1.0), None)
            if plan is None or not plan.T_free_C.size:  # before the window, or a fallback
                continue
            step = round(hours * HOUR_S / controller.step_s) - 1
            free_K = free_C[worst] - plan.T_free_C[0, step]
            forced_K = T_zone_C[worst] - free_C[worst] - plan.T_forced_K[0, step]
            band_K = 0.5 * (plan.T_free_high_C[0, step] - plan.T_free_low_C[0, step])
            print(f"  {hours:2d} h before: free {free_K:+.2f} K beyond (band ±{band_K:.2f}), forced {forced_K:+.2f} K")
    controller = ThermoForceMPC(controller.model, controller.config, free_response=Known(history.time_s, free_C))
