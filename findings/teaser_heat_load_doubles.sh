#!/usr/bin/env bash
# TEASER's heat load of a building is twice its zone's after the usual two calls, and grows with each further one.
#
# Versions: teaser 1.3.1
# A good guess: computing the parameters of a building again leaves them as they are: a house of one zone has the zone's heat
# load, before a retrofit and after it
# Seen: add_residential computes already and adds to sum_heat_load; calc_all_buildings, which every example calls next, adds
# once more: 11.5 kW, 22.9, 34.4 …, while the zone's own heat_load stays 11.5; no call sets the sum back
# Why it matters: a heat pump sized by it, or a u_max scaled to it, is twice too large
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile teaser==1.3.1
"$work/venv/bin/python" -W ignore - <<'PY'
from teaser.project import Project

project = Project()
project.add_residential(
    construction_data="iwu_heavy",
    geometry_data="iwu_single_family_dwelling",
    name="house",
    year_of_construction=1980,
    number_of_floors=2,
    height_of_floors=2.7,
    net_leased_area=150.0,
)
house = project.buildings[0]
loads = [house.sum_heat_load]
for _ in range(3):
    project.calc_all_buildings()
    loads.append(house.sum_heat_load)
zone = house.thermal_zones[0].model_attr.heat_load
print("zone", round(zone), "W; building", [round(load) for load in loads], "W")
assert len(house.thermal_zones) == 1
assert [round(load / zone, 6) for load in loads] == [1.0, 2.0, 3.0, 4.0]
PY
