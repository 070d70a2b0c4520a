"""The service with other embedded test cases than the heat pump."""

from __future__ import annotations

import numpy as np
import pytest
from documented_points import DOCUMENTED

from boptest_client import BoptestClient
from thermoforce_mpc.boundary.weather import CONTINENTAL, MARITIME, synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.plants.boptest.plant import BoptestPlant
from thermoforce_mpc.plants.registry import emulator_of
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.service.server import serving

# Climate, and how many measurements BOPTEST 1.0 has: earlier releases had four more of `bestest_hydronic`.
CASES = {"bestest_hydronic": (MARITIME, 4 + 23), "bestest_air": (CONTINENTAL, 8 + 23)}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_test_case_is_served_by_its_own_points(name):
    (climate, measurements), documented = CASES[name], DOCUMENTED[name][1]
    weather = synthetic_weather(climate=climate)
    with serving(weather, testcase=name) as url:
        with BoptestClient(url, name) as test:
            offered = (test.inputs(), test.measurements(), test.forecast_points())
            for ours, real in zip(
                offered, (documented.inputs, documented.measurements, documented.forecast), strict=True
            ):
                assert {key: point.unit for key, point in ours.items()} == {key: real[key].unit for key in ours}
            assert len(offered[1]) == measurements
            assert (set(offered[0]), set(offered[2])) == (set(documented.inputs), set(documented.forecast))
            state = test.initialize(20 * DAY_S, DAY_S)
            assert all(np.isfinite(value) for value in state.values())
            assert {"pgas_tot", "pele_tot"} <= {key for key, value in test.kpi().items() if value is not None}
        here = emulator_of(name, weather)
        with BoptestPlant(url, load_testcase(name)) as there:
            a, b = (plant.reset(20 * DAY_S, DAY_S) for plant in (here, there))
            for _ in range(4):
                a, b = (plant.advance(0.3, 900.0, *band(name)) for plant in (here, there))
            assert b.T_zone_C[0] == pytest.approx(a.T_zone_C[0], abs=1e-9)
            assert b.power_W[0] == pytest.approx(a.power_W[0], rel=1e-6)
            np.testing.assert_allclose(
                there.forecast(DAY_S, 3600.0).price_per_kWh, here.forecast(DAY_S, 3600.0).price_per_kWh
            )


def band(name: str) -> tuple[tuple[float, float], ...]:
    return ((21.0, 24.0),) if name == "bestest_air" else ()
