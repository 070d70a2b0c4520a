"""The guide's map and code, run on a table as its reader would have it."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from places import ROOT

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.identification.probing.probe import probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs" / "how-to" / "own-data.md"


def test_the_guide_leads_from_a_table_to_a_plan(tmp_path):
    blocks = re.findall(r"<!-- run-by-tests: \S+ -->\n```(\w+)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    (language, rules), (_, code) = blocks
    assert language == "yaml"
    (tmp_path / "map.yaml").write_text(rules, encoding="utf-8")
    plant = EmbeddedPlant(synthetic_weather())
    r = probe(plant, 20 * DAY_S, 3.0, seed=1)
    at = pd.date_range("2025-01-21", periods=r.n_steps + 1, freq="15min", name="time")
    columns = {"T living": r.T_zone_C[0], "T ambient": r.T_out_C + 273.15, "GHI": r.solar_W_m2}
    acting = {"compressor": [*(100 * r.u[0]), np.nan], "kWh heat pump": [*(r.power_W[0] / 4000), np.nan]}
    pd.DataFrame(columns | acting, index=at).to_csv(tmp_path / "house.csv")
    b = plant.forecast(2 * DAY_S, 3600.0)
    ahead = pd.DataFrame({"T ambient": b.T_out_C + 273.15, "GHI": b.solar_W_m2})
    ahead.set_index(pd.date_range(at[-1], periods=b.n_steps + 1, freq="1h")).to_csv(tmp_path / "tomorrow.csv")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "competent: the effect of 8 h" in done.stdout
    assert "2025-01-24 00:15:00+01:00" in done.stdout
