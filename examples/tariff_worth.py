"""Saving by planning for a varying tariff: its cost against that of a controller that plans for a constant price.

    python examples/tariff_worth.py [WEATHER.mos [PRICES.csv [START_DAY [DAYS]]]]

Without files: synthetic weather and highly dynamic tariff, four days from the peak heat day. Heat stored at the end is
not credited, so results of short windows are less reliable than those of two weeks.
"""

import sys
from pathlib import Path

from controllers.registry import build_controller
from thermoforce_mpc.boundary.tariffs import tariff_from_file
from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
from thermoforce_mpc.experiment.experiment import scored_period
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase

weather, prices, start, days = (sys.argv[1:] + ["", "", "peak_heat_day", "4"][len(sys.argv) - 1 :])[:4]
plant = EmbeddedPlant(
    load_weather(Path(weather)) if weather else synthetic_weather(),
    highly_dynamic=tariff_from_file(Path(prices)) if prices else None,
)
testcase = load_testcase("bestest_hydronic_heat_pump")
window = scored_period(plant, start, float(days))
model = identify_on(plant, before=window, days=3, testcase=testcase)


def cost(price: str) -> dict[str, float]:
    """Run the default controller under `price` and return its energy cost under every tariff, EUR/m²."""
    run_closed_loop(plant, build_controller("thermoforce_mpc", {}, testcase, model), window, price)
    bills = {}
    for name in plant.tariff_names:
        plant.use(name, None)
        bills[name] = plant.kpis()["cost_tot"]
    return bills


constant = cost("constant")
print(f"constant: {constant['constant']:.4f} EUR/m2")
for price in plant.tariff_names:
    if price != "constant":
        print(f"{price}: {cost(price)[price]:.4f} EUR/m2; planned for a constant price: {constant[price]:.4f}")
