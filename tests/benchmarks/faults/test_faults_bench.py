"""The bench of faults: what a fault does is measured, and only what does nothing may go unnoticed."""

from __future__ import annotations

import math

import pytest
from faults import FaultyHouse
from simple_house import OutdoorResponse, simple_model

from benchmarks.faults.bench import RecordedController, targets
from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.loop.closed_loop import run_closed_loop


def row(fault: str, noticed_h: float | None, consequences: bool) -> dict:
    return {
        "fault": fault,
        "day": "mild",
        "noticed_h": noticed_h,
        "back_h": None if noticed_h is None else 3.0,
        "watch_steps": 0 if noticed_h is None else 4,
        "consequences": consequences,
        "discomfort_Kh": 0.1,
        "without_watch_Kh": 0.1,
    }


def notice(rows: list[dict]) -> list[tuple[float, bool]]:
    return [(target.value, target.holds) for target in targets(rows) if target.name.endswith("h to notice")]


def test_an_unnoticed_fault_misses_its_target_only_where_it_has_consequences():
    assert notice([row("weak", 5.0, True)]) == [(5.0, True)]
    assert notice([row("weak", 5.0, False)]) == [(5.0, True)]
    [(value, holds)] = notice([row("weak", None, True)])
    assert math.isnan(value)
    assert not holds
    assert notice([row("weak", None, False)]) == [], "neither noticed nor missed"
    [(value, holds)] = notice([row("weak", -3.0, True)])
    assert not holds, "a false alarm before the fault"


@pytest.mark.slow
def test_errors_of_predictions_six_hours_ahead_are_recorded():
    def warmer(house: FaultyHouse, hours: float) -> float:
        """0.05 K per hour more from the second day on."""
        return 0.05 * hours * (house.now_s >= 11 * DAY_S)

    model = simple_model()
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    recorded, house = RecordedController(mpc, model), FaultyHouse(moves=warmer)
    run_closed_loop(house, recorded, house.period("x"))
    assert recorded.error_K(10 * DAY_S, 11 * DAY_S) < 0.05
    assert recorded.error_K(11.25 * DAY_S, 12 * DAY_S) == pytest.approx(6 * 0.05, abs=0.03)
    assert math.isnan(recorded.error_K(20 * DAY_S, 21 * DAY_S))
