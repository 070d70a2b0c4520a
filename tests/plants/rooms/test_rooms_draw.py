"""House of rooms: names, the draw, the plan and its contacts."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import FACADES, HEIGHT_M
from thermoforce_mpc.plants.rooms import draw_rooms, house_of_rooms
from thermoforce_mpc.plants.rooms.draw import emulator_fixed_share
from thermoforce_mpc.plants.rooms.house import HOUSE, facade_lengths

SEED = 7


@pytest.fixture(scope="module")
def houses():
    return [draw_rooms(n, seed) for n in (1, 2, 3, 5, 9, 14, 30) for seed in range(SEED, SEED + 4)]


def test_a_house_is_drawn_again_and_differs_by_seed_and_number():
    assert draw_rooms(5, 3) == draw_rooms(5, 3)
    assert len({draw_rooms(n, seed).floor_area_m2 for n, seed in ((5, 3), (5, 4), (6, 3))}) == 3


@pytest.mark.slow
def test_names_resolve_to_houses():
    plant = house_of_rooms("house:5rooms")
    assert plant.zones == ("living", "kitchen", "bath", "bedroom_1", "bedroom_2")
    assert plant.actuators[0] == "living_valve"
    assert plant.layout.names.machines == ("heat_pump",)
    assert house_of_rooms(plant.house.name).house == plant.house
    assert house_of_rooms("house:2rooms:101").house == draw_rooms(2, 101)


@pytest.mark.parametrize(
    "name", ["house:0rooms", "house:31rooms", "house:rooms", "house:5rooms:", "house:-1rooms", "5"]
)
def test_other_names_are_refused(name):
    with pytest.raises(InputError, match=r"expected house:Nrooms"):
        house_of_rooms(name)


@pytest.mark.parametrize("n", [0, 31, 2.0, True])
def test_other_numbers_of_rooms_are_refused(n):
    with pytest.raises(InputError, match="1 to 30"):
        draw_rooms(n, 1)


def test_rooms_tile_their_storey_and_every_wall_is_outside_or_shared(houses):
    for house in houses:
        rooms = house.rooms
        assert len({room.name for room in rooms}) == len(rooms)
        footprint = house.floor_area_m2 / house.storeys
        for storey in range(house.storeys):
            places = [room.place for room in rooms if room.place.storey == storey]
            assert sum(place.area_m2 for place in places) == pytest.approx(footprint)
            for a, b in combinations(places, 2):
                overlap = np.clip(min(a.x1, b.x1) - max(a.x0, b.x0), 0, None) * np.clip(
                    min(a.y1, b.y1) - max(a.y0, b.y0), 0, None
                )
                assert overlap < 1e-9
        for i, room in enumerate(rooms):
            place = room.place
            storey_places = [other.place for other in rooms if other.place.storey == place.storey]
            shared = sum(c.length_m for c in house.contacts if i in (c.first, c.second))
            around = 2.0 * (place.x1 - place.x0 + place.y1 - place.y0)
            assert shared + sum(facade_lengths(place, storey_places)) == pytest.approx(around)
            assert max(room.walls_m2) > 0 or house.attached  # a facade of its own
        floors = sum(c.area_m2 for c in house.contacts if c.kind == "floor")
        assert floors == pytest.approx(footprint if house.storeys == 2 else 0.0)
        for contact in house.contacts:
            if contact.kind == "floor":
                assert (rooms[contact.first].place.storey, rooms[contact.second].place.storey) == (0, 1)


def test_doors_lead_to_every_room_through_contacts_with_one_stair(houses):
    for house in houses:
        kinds = {(c.first, c.second): c.kind for c in house.contacts}
        reached = {0}
        for _ in house.rooms:
            reached |= {j for d in house.doors for i, j in ((d.first, d.second), (d.second, d.first)) if i in reached}
        assert reached == set(range(len(house.rooms)))
        assert len(house.doors) == len(house.rooms) - 1
        assert sum(kinds[d.first, d.second] == "floor" for d in house.doors) == house.storeys - 1


def test_envelope_follows_the_plan(houses):
    for house in houses:
        for room in house.rooms:
            at = {name: i for i, name in enumerate(FACADES)}
            assert all(room.walls_m2[at[name]] == 0 for name in house.attached)
            assert all(window <= 0.6 * wall + 1e-9 for window, wall in zip(room.windows_m2, room.walls_m2, strict=True))
            low, high = HOUSE.kinds[room.kind].glazing
            assert sum(room.windows_m2) <= high * room.area_m2 + 1e-9
            if sum(room.walls_m2) * 0.6 > high * room.area_m2:
                assert sum(room.windows_m2) >= low * room.area_m2 - 1e-9
            assert (room.ground_W_K > 0) == (room.place.storey == 0)
            wide = room.place.x1 - room.place.x0
            assert room.walls_m2[at["south"]] in (0.0, pytest.approx(wide * HEIGHT_M))


def test_draws_cover_emitters_storeys_and_facades_and_floors_only_where_they_can_heat():
    houses = [draw_rooms(5, seed) for seed in range(40)]
    assert {h.storeys for h in houses} == {1, 2}
    assert {h.attached for h in houses} == {(), ("west",), ("east",), ("west", "east")}
    assert {frozenset(r.emitter for r in h.rooms) for h in houses} == {
        frozenset({"floor"}),
        frozenset({"radiator"}),
        frozenset({"floor", "radiator"}),
    }
    for house in houses:
        for room in house.rooms:
            assert room.emitter == "radiator" or room.emitter_W <= 70.0 * room.area_m2
        assert house.heat_pump.capacity_W == pytest.approx(house.sizing * house.design_load_W)


def test_the_fixed_part_of_the_machine_is_the_emulators_for_its_size():
    assert emulator_fixed_share() == pytest.approx((1094.804 + 510.204 + 20.4986) / 10013, rel=1e-3)
    house = draw_rooms(5, SEED)
    at_2_C = house.heat_pump.capacity_W * (1 + 0.02 * (2.0 - house.design_out_C))
    assert house.heat_pump.fixed_W == pytest.approx(emulator_fixed_share() * at_2_C)


def test_one_line_says_what_was_drawn():
    house = draw_rooms(5, SEED)
    assert "5 rooms on" in house.words
    assert all(room.name in house.words for room in house.rooms)
