"""House of rooms: a seeded building of 1 to 30 rooms with a valve each and one heat pump."""

from thermoforce_mpc.plants.rooms.draw import DrawnHouse, draw_rooms
from thermoforce_mpc.plants.rooms.plant import (
    HouseForecast,
    HouseMeasurement,
    HouseOfRooms,
    HouseRecord,
    house_of_rooms,
)

__all__ = [
    "DrawnHouse",
    "HouseForecast",
    "HouseMeasurement",
    "HouseOfRooms",
    "HouseRecord",
    "draw_rooms",
    "house_of_rooms",
]
