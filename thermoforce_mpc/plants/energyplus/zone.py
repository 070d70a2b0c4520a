"""Single-zone house as an epJSON dictionary; a callback sets its only heat source or sink.

The heat enters as `OtherEquipment` (negative for cooling), partly as radiation, so the room responds as to a radiator
or a cooled ceiling. An ideal-loads system would reach the set-point within one step.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, timedelta
from typing import Any, Literal

EpJson = dict[str, dict[str, dict[str, Any]]]

HVAC = "HVAC"
GAINS = "GAINS"
ZONE = "ZONE"
# A year of 365 days, as TMY3 years, that begins on a Monday.
YEAR = 2018


@dataclass(frozen=True)
class ZoneSpec:
    """Parameters of a single-zone house.

    Attributes:
        weather: part of the name of the TMY3 file, such as 'Chicago-OHare'.
        mode: 'heating' or 'cooling'.
        capacity_W: maximum heat flow of the source, W thermal.
        insulation_m: thickness of the walls' insulation, m (0.04 W/mK); the roof has 1.5 times as much.
        slab_m: thickness of the concrete floor inside the insulation, m.
        window_m2: area of the south window, m²; the west window has a third of it.
        window_u_W_m2K, window_shgc: U-value, W/(m²·K), and solar heat gain coefficient of the glazing.
        infiltration_ach: infiltration, air changes per hour.
        radiant_fraction: radiant fraction of the source's heat.
        capacitance_multiplier: multiplier of the zone air's heat capacity, for furniture and light walls.
        gains_W: full internal gains, W.
        steps_per_hour: data steps per hour; the source is constant over a step.
        engine_steps_per_hour: zone time steps of the engine, a multiple of `steps_per_hour`. With 15-min zone time
            steps the engine subdivides only steps with large changes and reports their mean instead of their end, so
            the response to an action would depend on its size.
        floor_m: (length, width, height) of the room, m.
    """

    weather: str
    mode: Literal["heating", "cooling"]
    capacity_W: float
    insulation_m: float
    slab_m: float = 0.10
    window_m2: float = 6.0
    window_u_W_m2K: float = 1.6
    window_shgc: float = 0.45
    infiltration_ach: float = 0.4
    radiant_fraction: float = 0.3
    capacitance_multiplier: float = 6.0
    gains_W: float = 400.0
    steps_per_hour: int = 4
    engine_steps_per_hour: int = 12
    floor_m: tuple[float, float, float] = (8.0, 6.0, 2.7)

    @property
    def floor_area_m2(self) -> float:
        """Floor area, m²."""
        return self.floor_m[0] * self.floor_m[1]

    @property
    def step_s(self) -> float:
        """Length of a data step, s."""
        return 3600.0 / self.steps_per_hour


def zone_model(spec: ZoneSpec, first_day: int, days: int) -> EpJson:
    """Return the model of `spec` for a run of `days` from `first_day` (0 is 1 January) of a year without leap day."""
    length, width, height = spec.floor_m
    begin = date(YEAR, 1, 1) + timedelta(days=first_day)
    end = begin + timedelta(days=days - 1)
    return {
        "Version": {"Version 1": {"version_identifier": "25.2"}},
        "SimulationControl": {
            "SimulationControl 1": {
                "do_zone_sizing_calculation": "No",
                "do_system_sizing_calculation": "No",
                "do_plant_sizing_calculation": "No",
                "run_simulation_for_sizing_periods": "No",
                "run_simulation_for_weather_file_run_periods": "Yes",
            }
        },
        "Building": {
            "House": {
                "terrain": "Suburbs",
                "solar_distribution": "FullExterior",
                "maximum_number_of_warmup_days": 25,
                "minimum_number_of_warmup_days": 6,
                "loads_convergence_tolerance_value": 0.04,
                "temperature_convergence_tolerance_value": 0.4,
            }
        },
        "Timestep": {"Timestep 1": {"number_of_timesteps_per_hour": spec.engine_steps_per_hour}},
        "RunPeriod": {
            "Run": {
                "begin_month": begin.month,
                "begin_day_of_month": begin.day,
                "begin_year": begin.year,
                "end_month": end.month,
                "end_day_of_month": end.day,
                "end_year": end.year,
                "use_weather_file_holidays_and_special_days": "No",
                "use_weather_file_daylight_saving_period": "No",
                "use_weather_file_rain_indicators": "Yes",
                "use_weather_file_snow_indicators": "Yes",
            }
        },
        "GlobalGeometryRules": {
            "GlobalGeometryRules 1": {
                "starting_vertex_position": "UpperLeftCorner",
                "vertex_entry_direction": "Counterclockwise",
                "coordinate_system": "Relative",
            }
        },
        "Zone": {ZONE: {"ceiling_height": height, "volume": length * width * height}},
        "ZoneCapacitanceMultiplier:ResearchSpecial": {
            "Multiplier": {"temperature_capacity_multiplier": spec.capacitance_multiplier}
        },
        **_constructions(spec),
        **_surfaces(spec),
        **_schedules(),
        "OtherEquipment": {
            HVAC: _equipment(radiant=spec.radiant_fraction),
            GAINS: _equipment(radiant=0.4),
        },
        "ZoneInfiltration:DesignFlowRate": {
            "Infiltration": {
                "zone_or_zonelist_or_space_or_spacelist_name": ZONE,
                "schedule_name": "ALWAYS",
                "design_flow_rate_calculation_method": "AirChanges/Hour",
                "air_changes_per_hour": spec.infiltration_ach,
                "constant_term_coefficient": 1.0,
            }
        },
        "OutputControl:Files": {
            "Files": {
                key: "No"
                for key in ("output_csv", "output_mtr", "output_eso", "output_eio", "output_tabular", "output_sqlite")
            }
        },
    }


def _equipment(radiant: float) -> dict[str, Any]:
    return {
        "zone_or_zonelist_or_space_or_spacelist_name": ZONE,
        "schedule_name": "ALWAYS",
        "design_level_calculation_method": "EquipmentLevel",
        "design_level": 0.0,
        "fraction_latent": 0.0,
        "fraction_radiant": radiant,
        "fraction_lost": 0.0,
    }


def _schedules() -> EpJson:
    return {
        "ScheduleTypeLimits": {"Any Number": {}},
        "Schedule:Constant": {"ALWAYS": {"schedule_type_limits_name": "Any Number", "hourly_value": 1.0}},
    }


def _constructions(spec: ZoneSpec) -> EpJson:
    def material(thickness: float, conductivity: float, density: float, heat: float) -> dict[str, Any]:
        return {
            "roughness": "MediumRough",
            "thickness": thickness,
            "conductivity": conductivity,
            "density": density,
            "specific_heat": heat,
        }

    return {
        "Material": {
            "Plaster": material(0.013, 0.25, 900.0, 1000.0),
            "Brick": material(0.10, 0.75, 1700.0, 840.0),
            "Wall insulation": material(spec.insulation_m, 0.04, 30.0, 1200.0),
            "Roof insulation": material(1.5 * spec.insulation_m, 0.04, 30.0, 1200.0),
            "Floor insulation": material(spec.insulation_m, 0.04, 30.0, 1200.0),
            "Roofing": material(0.02, 0.16, 1120.0, 1460.0),
            "Slab": material(spec.slab_m, 1.7, 2300.0, 900.0),
        },
        "WindowMaterial:SimpleGlazingSystem": {
            "Glazing": {"u_factor": spec.window_u_W_m2K, "solar_heat_gain_coefficient": spec.window_shgc}
        },
        "Construction": {
            "Wall": {"outside_layer": "Brick", "layer_2": "Wall insulation", "layer_3": "Plaster"},
            "Roof": {"outside_layer": "Roofing", "layer_2": "Roof insulation", "layer_3": "Plaster"},
            "Floor": {"outside_layer": "Floor insulation", "layer_2": "Slab"},
            "Window": {"outside_layer": "Glazing"},
        },
        "Site:GroundTemperature:BuildingSurface": {
            "Ground": {
                f"{month}_ground_temperature": 18.0
                for month in (
                    "january", "february", "march", "april", "may", "june", "july", "august", "september", "october",
                    "november", "december",
                )
            }
        },
    }  # fmt: skip


def _surfaces(spec: ZoneSpec) -> EpJson:
    length, width, height = spec.floor_m
    corners = [(0.0, 0.0), (length, 0.0), (length, width), (0.0, width)]

    def wall(start: int) -> list[tuple[float, float, float]]:
        (x0, y0), (x1, y1) = corners[start], corners[(start + 1) % 4]
        return [(x0, y0, height), (x0, y0, 0.0), (x1, y1, 0.0), (x1, y1, height)]

    def surface(kind: str, construction: str, vertices: list[tuple[float, float, float]]) -> dict[str, Any]:
        ground = kind == "Floor"
        return {
            "surface_type": kind,
            "construction_name": construction,
            "zone_name": ZONE,
            "outside_boundary_condition": "Ground" if ground else "Outdoors",
            "sun_exposure": "NoSun" if ground else "SunExposed",
            "wind_exposure": "NoWind" if ground else "WindExposed",
            "number_of_vertices": len(vertices),
            "vertices": [
                {"vertex_x_coordinate": x, "vertex_y_coordinate": y, "vertex_z_coordinate": z} for x, y, z in vertices
            ],
        }

    def window(name: str, at: tuple[float, float], along: tuple[float, float], area: float) -> dict[str, Any]:
        high, low = height - 0.4, 0.8
        wide = area / (high - low)
        (x, y), (dx, dy) = at, along
        left, right = (x - dx * wide / 2, y - dy * wide / 2), (x + dx * wide / 2, y + dy * wide / 2)
        points = [(*left, high), (*left, low), (*right, low), (*right, high)]
        return {
            "surface_type": "Window",
            "construction_name": "Window",
            "building_surface_name": name,
            "number_of_vertices": 4,
            **{
                f"vertex_{i}_{axis}_coordinate": value
                for i, point in enumerate(points, 1)
                for axis, value in zip("xyz", point, strict=True)
            },
        }

    roof = [(x, y, height) for x, y in (corners[3], corners[0], corners[1], corners[2])]
    floor = [(x, y, 0.0) for x, y in (corners[0], corners[3], corners[2], corners[1])]
    return {
        "BuildingSurface:Detailed": {
            "South": surface("Wall", "Wall", wall(0)),
            "East": surface("Wall", "Wall", wall(1)),
            "North": surface("Wall", "Wall", wall(2)),
            "West": surface("Wall", "Wall", wall(3)),
            "Roof": surface("Roof", "Roof", roof),
            "Floor": surface("Floor", "Floor", floor),
        },
        "FenestrationSurface:Detailed": {
            "South window": window("South", (length / 2, 0.0), (1.0, 0.0), spec.window_m2),
            "West window": window("West", (0.0, width / 2), (0.0, -1.0), spec.window_m2 / 3.0),
        },
    }
