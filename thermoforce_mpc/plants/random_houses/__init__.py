"""Generated houses: seeded single-zone buildings with varied envelope, emitter, machine, occupants and sensor."""

from thermoforce_mpc.plants.random_houses.draw import House, draw_house, with_sunlit_part
from thermoforce_mpc.plants.random_houses.plant import GeneratedHousePlant, generated_house, house_testcase

__all__ = ["GeneratedHousePlant", "House", "draw_house", "generated_house", "house_testcase", "with_sunlit_part"]
