"""Test case of a house of rooms: its zones, valves and heat pump by name."""

from __future__ import annotations

from thermoforce_mpc.plants.rooms.plant import house_of_rooms
from thermoforce_mpc.scenario.building import Machine, Zone, ZoneActuator
from thermoforce_mpc.scenario.testcase import TestCase, Weather


def house_testcase(name: str) -> TestCase:
    """Return the test case of a house or an office, see `house_of_rooms`; raises `InputError` for another name."""
    house = house_of_rooms(name)
    zones = {
        zone: Zone(
            temperature=f"T_zone[{zone}]",
            floor_area_m2=float(area),
            occupancy=f"occupancy[{zone}]",
            lower=f"lower[{zone}]",
            upper=f"upper[{zone}]",
            thermostat_C=float(thermostat_C),
        )
        for zone, area, thermostat_C in zip(house.zones, house.floor_area_m2, house.thermostat_C, strict=True)
    }
    actuators = {
        valve: ZoneActuator(point=valve, zone=zone, machine="heat_pump", heat=(f"heat[{zone}]",), share=float(share))
        for valve, zone, share in zip(house.actuators, house.zones, house.design_heat_W / house.capacity_W, strict=True)
    }
    return TestCase(
        name=name,
        description=house.house.words,
        step_s=900.0,
        measurements=Weather(outdoor_temperature="T_out", solar="solar"),
        zones=zones,
        actuators=actuators,
        machines={"heat_pump": Machine(power=("power",))},
        plant="rooms",
    )
