"""Two measured buildings, through the door that anyone uses, by the maps of the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from places import ROOT

import thermoforce_mpc as tf
from thermoforce_mpc.identification.probing.operation import findings, telling_part

PAGE = ROOT / "docs" / "evidence" / "records.md"


def guide_map(name: str) -> dict[str, Any]:
    found = re.search(rf"<!-- {name} -->\n```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    return yaml.safe_load(found.group(1))


@pytest.fixture(scope="module")
def folder(shared) -> Path:
    if not (shared / "real_house").is_dir():
        pytest.skip("the measured buildings are not there")
    return shared / "real_house"


@pytest.mark.slow
def test_the_test_box(folder):
    found = tf.read_measurements(folder / "armadillo_H2_30min.csv", guide_map("box.yaml"))
    record = found.record
    assert record.n_steps == 232
    assert record.heat_W.max() == pytest.approx(record.u.max() * 2220, rel=1e-3)
    assert not [s.flags for s in found.understood.signals if s.flags]
    verdict = findings(record, found.layout)[0]
    assert verdict.competent, verdict.words


@pytest.mark.slow
def test_the_low_energy_house(folder):
    rules = guide_map("mons.yaml")
    room = rules["zones"]["room"]
    rules["zones"] = {f"t{z}": room | {"temperature": f"T{z}_degC"} for z in range(1, 10)}
    rules["actuators"]["heater"] = {"zone": "t4"}
    found = tf.read_measurements(folder / "mons_house_30min.csv.gz", rules)
    assert found.record.T_zone_C.shape == (9, 15566)
    known = np.isfinite(found.record.T_zone_C).mean(axis=1)
    assert known.min() > 0.7
    assert known.max() < 0.95, "gaps stay gaps"
    outdoor = next(s for s in found.understood.signals if s.key == "outdoor")
    assert [(flag.rule, flag.count) for flag in outdoor.flags] == [("frozen", 131)]
    heated = found.served()
    assert heated.record.names.zones == ("t4",)
    part, note = telling_part(heated.record, heated.layout)
    assert "2016-02-15" in note
    verdict = findings(part, heated.layout)[0]
    assert verdict.competent, verdict.words
