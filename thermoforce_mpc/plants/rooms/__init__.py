"""House of rooms: a seeded building of 1 to 30 rooms with a valve each and one heat pump."""

from thermoforce_mpc.plants.rooms.draw import draw_rooms
from thermoforce_mpc.plants.rooms.house import DrawnHouse
from thermoforce_mpc.plants.rooms.plant import HouseOfRooms, house_of_rooms

__all__ = ["DrawnHouse", "HouseOfRooms", "draw_rooms", "house_of_rooms"]
