"""Readers of measured homes, on small files of the same layout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.factual import refit
from benchmarks.factual.readers import read_homes
from thermoforce_mpc.errors import DataError

SHARED = Path("/work/shared/real_house")

_SURVEY = """<RefitXML xmlns="http://www.refitsmarthomes.org">
<Building id="Building01">
 <Space id="Space01" roomType="Living room">
  <Sensor id="S1"><TimeSeriesVariable id="V1" variableType="Air temperature" units="C"/></Sensor>
 </Space>
 <Meter id="M1"><Sensor id="S2"><TimeSeriesVariable id="V2" variableType="Gas volume" units="m3"/></Sensor></Meter>
</Building>
<Building id="Building02">
 <Space id="Space02" roomType="Kitchen">
  <Sensor id="S3"><TimeSeriesVariable id="V3" variableType="Air temperature" units="C"/></Sensor>
 </Space>
</Building>
<Building id="Building03">
 <Space id="Space03" roomType="Lounge">
  <Sensor id="S4"><TimeSeriesVariable id="V4" variableType="Air temperature" units="C"/></Sensor>
  <Radiator id="R1"><Sensor id="S5">
   <TimeSeriesVariable id="V5" variableType="Surface temperature" units="C"/></Sensor></Radiator>
 </Space>
</Building>
<Climate id="C1"><Sensor id="S9">
 <TimeSeriesVariable id="W1" variableType="External air temperature" units="C"/>
 <TimeSeriesVariable id="W2" variableType="Global horizontal solar irradiance" units="W/m2"/></Sensor></Climate>
</RefitXML>"""


def _release(folder: Path, change: tuple[str, str] = ("", "")) -> Path:
    """Two days of the release's two files, at the sensors' own uneven times."""
    (folder / refit.SURVEY).write_text(_SURVEY)
    rows = []
    for k in range(2 * 96):
        at = pd.Timestamp("2014-02-01T00:00:00Z") + pd.Timedelta(minutes=15 * k)
        for name, value in (("V1", 20.0 + k / 96), ("V3", 18.0), ("V4", 19.0), ("W1", 5.0), ("W2", 100.0)):
            rows.append((name, at.isoformat(), value))
        rows.append(("V5", at.isoformat(), 50.0 if k % 8 < 4 else 22.0))
        rows.append(("V2", (at + pd.Timedelta(seconds=70)).isoformat(), 0.05))
    table = pd.DataFrame(rows, columns=["TimeSeriesVariable/@id", "dateTime", "data"])
    text = table.sort_values("TimeSeriesVariable/@id").to_csv(index=False)
    (folder / refit.VALUES).write_text(text.replace(*change) if change[0] else text)
    return folder


def test_refit_homes_are_streamed_onto_one_clock(tmp_path: Path) -> None:
    said: list[str] = []
    folder = _release(tmp_path)
    homes = {home.name: home for home in refit.refit_homes(folder, said.append, rows_at_once=100)}
    assert set(homes) == {"Building01", "Building03"} == {home.name for home in read_homes(folder)}
    assert any("Building02: left out" in line for line in said)
    home = homes["Building01"]
    record = home.record
    assert record.step_s == 1800.0
    assert str(record.stamps()[0]) == "2014-02-01 00:00:00+00:00"
    assert np.allclose(record.T_out_C, 5.0)
    assert np.allclose(record.solar_W_m2, 100.0)
    # Each half hour holds two quarter-hour volumes.
    (gas,) = home.meters.values()
    assert np.allclose(gas, 0.1)
    assert record.T_zone_C[0, 0] == pytest.approx(20.0, abs=0.01)
    assert np.diff(record.T_zone_C[0]).min() > 0.0
    # A radiator acts while it is hot, and tells nothing of the room while it is not.
    (radiator,) = homes["Building03"].meters.values()
    assert set(np.unique(radiator)) <= {0.0, 10.0, 20.0}
    assert {0.0, 20.0} <= set(radiator)
    assert set(home.source) == {refit.SURVEY, refit.VALUES}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("dateTime", "when"), "expected the columns TimeSeriesVariable/@id, dateTime, data"),
        (("2014-02-01T00:15:00+00:00", "soon"), "'soon' is not a time stamp"),
    ],
)
def test_refit_values_that_cannot_be_used_say_where(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_homes(_release(tmp_path, change))


def test_refit_without_its_survey_says_so(tmp_path: Path) -> None:
    _release(tmp_path)
    (tmp_path / refit.SURVEY).unlink()
    with pytest.raises(DataError, match=r"REFIT_BUILDING_SURVEY\.xml is missing"):
        read_homes(tmp_path)


def test_a_survey_that_is_no_xml_says_so(tmp_path: Path) -> None:
    _release(tmp_path)
    (tmp_path / refit.SURVEY).write_text("<RefitXML><Building>")
    with pytest.raises(DataError, match="not an XML file"):
        read_homes(tmp_path)


def test_a_folder_without_homes_says_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "holiday.csv").write_text("a\n1\n")
    with pytest.raises(DataError, match=r"there is holiday\.csv"):
        read_homes(tmp_path)


@pytest.mark.skipif(not SHARED.is_dir(), reason=f"{SHARED} is not here")
def test_measured_buildings() -> None:
    homes = read_homes(SHARED)
    assert [home.group for home in homes] == ["Mons"] * 9 + ["box"]
    assert list(homes[0].meters) == ["heater"]
    assert list(read_homes(SHARED, all_meters=True)[0].meters) == ["heater", "appliances", "lights", "hot water"]
    spring = homes[0].between(pd.Timestamp("2016-04-01"), pd.Timestamp("2016-04-03"))
    assert spring.record.n_steps == 96
    assert spring.meters["heater"].size == 96
    with pytest.raises(DataError, match="has nothing in 2020"):
        homes[0].between(pd.Timestamp("2020-01-01"))
