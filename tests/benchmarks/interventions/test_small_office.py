"""The DOE small office: our changes to it, and that only the set-point moves it."""

import re

import numpy as np
import pytest

from benchmarks.interventions.pool import simulate_all
from benchmarks.interventions.small_office import (
    FLOOR_AREA_M2,
    RANGE_W,
    OfficeJob,
    simulate_office,
)
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.plants.energyplus import office
from thermoforce_mpc.plants.energyplus.engine import is_available, reference_building
from thermoforce_mpc.plants.energyplus.office import office_model

pytestmark = pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed")


@pytest.mark.slow
def test_a_shift_of_the_set_point_changes_nothing_before_it_and_heats_after():
    setpoint = np.full(2 * 96, 20.0)
    moved = setpoint.copy()
    moved[132:148] += 2.0  # the second day, 09:00 to 13:00
    with LocalEngine(2) as engine:
        plain, shifted = simulate_all([OfficeJob(21, setpoint), OfficeJob(21, moved)], engine, run=simulate_office)
    assert plain.T_zone_C[0, :133].tobytes() == shifted.T_zone_C[0, :133].tobytes()
    assert plain.u[0, :132].tobytes() == shifted.u[0, :132].tobytes()
    effect = shifted.T_zone_C[0, 133:149] - plain.T_zone_C[0, 133:149]
    assert effect[4:].min() > 0.5
    assert effect.max() < 2.1
    assert shifted.heat_W[0, 132:148].sum() > plain.heat_W[0, 132:148].sum() + 1e4
    assert plain.u[0] == pytest.approx((plain.heat_W[0] - RANGE_W[0]) / (RANGE_W[1] - RANGE_W[0]))


def test_only_run_period_step_and_reports_of_the_shipped_building_are_changed():
    shipped = reference_building(office.BUILDING).read_text(encoding="latin-1")
    ours = office_model(21, 10, 4)
    assert re.search(r"RunPeriod, Ours, 1, 22, 2018, 1, 31, 2018", ours)
    assert "Timestep,4;" in ours
    assert "Output:Table" not in ours.replace("OutputControl:Table", "")
    for kept in ("BuildingSurface:Detailed,", "Coil:Heating:Fuel,", "People,", "Lights,", "ZoneInfiltration:"):
        assert ours.count(kept) == shipped.count(kept) > 0
    assert sum(FLOOR_AREA_M2.values()) == pytest.approx(511.16, abs=0.1)


def test_another_version_of_the_building_is_refused(monkeypatch, tmp_path):
    other = tmp_path / "other.idf"
    other.write_text("Version,25.2;\nTimestep,6;\n")
    monkeypatch.setattr(office, "reference_building", lambda name: other)
    with pytest.raises(PlantError, match="0 places"):
        office_model(21, 10, 4)
