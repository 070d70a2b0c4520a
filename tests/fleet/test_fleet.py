"""A fleet: its file, its runs and their results, the dataset and what is said of it."""

from __future__ import annotations

import os
import re
import shlex
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from click.testing import CliRunner
from executed_tasks import identified_at_once
from places import ROOT
from simple_house import simple_model

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.cli.running import comparing
from thermoforce_mpc.cli.running.fleet import saving_cells
from thermoforce_mpc.cli.running.run import run as run_one
from thermoforce_mpc.comparison import cells
from thermoforce_mpc.comparison import tasks as comparison_tasks
from thermoforce_mpc.comparison.store import Identified, Ran, Store
from thermoforce_mpc.comparison.tasks import failure
from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.fleet import runs as fleet_runs
from thermoforce_mpc.fleet.file import buildings_of, load_fleet
from thermoforce_mpc.fleet.page import causes, fleet_page, groups, headline, lost, paired, run_command
from thermoforce_mpc.fleet.runs import FORMAT, read_dataset, runs_of, schema, tasks_of
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.scenario.scenario import Scenario

RULES = {"thermostat": {"controller": "thermostat", "options": {"step_s": 300}}, "native": {"controller": "native"}}

SCHEMA = schema()


def _file(folder: Path, **keys: Any) -> Path:
    content = {"buildings": [{"generated": {"seed": 5, "count": 2}}], "variants": RULES, "days": 0.25, **keys}
    path = folder / "few.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def _fleet(path: Path, *words: str) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["fleet", str(path), "--out", str(path.parent / "out"), "--jobs", "2", *words])
    if isinstance(result.exception, InputError):  # `main` turns it into a message and exit code 2
        return 2, str(result.exception)
    return result.exit_code, result.output


def _rows(**columns: list[Any]) -> pd.DataFrame:
    """A dataset with the columns given; the rest is filled."""
    n = len(next(iter(columns.values())))
    fill = {name: "" if pa.types.is_string(SCHEMA.field(name).type) else 0 for name in SCHEMA.names}
    base: dict[str, list[Any]] = {name: [fill[name]] * n for name in SCHEMA.names}
    base |= {"status": ["done"] * n, "days": [7.0] * n, "ener_tot": [1.0] * n, "window": ["w"] * n, "price": ["p"] * n}
    return pd.DataFrame(base | columns)


@pytest.mark.slow
def test_a_fleet_is_run_once_and_its_dataset_is_the_same_bytes_whatever_ran_before(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    path = _file(tmp_path, trajectories=True, prices=["constant", "dynamic"], windows=["cold_week"])
    code, said = _fleet(path, "--jobs", "1")  # in a process of its own; two would compile the same houses twice
    assert code == 0, said
    assert "2 buildings (2 generated) × 2 tariffs × 2 controllers: 8 runs" in said
    out = tmp_path / "out"
    rows = read_dataset(out)
    assert len(rows) == 8
    assert set(rows["building"]) == {"generated:5:0", "generated:5:1"}
    assert (rows["status"] == "done").all()
    assert (rows["cost_tot"] >= 0).all()
    schemas = [pq.read_schema(file).remove_metadata() for file in (out / "trajectories").rglob("*.parquet")]
    assert all(schema.equals(schemas[0]) for schema in schemas), "native control has no levels, but a column of them"
    courses = pd.read_parquet(out / "trajectories")
    assert set(courses["key"]) == set(rows["key"])
    assert set(courses["building"].astype(str)) == {"generated:5:0", "generated:5:1"}
    assert "native against thermostat in 4 runs" in (out / "index.html").read_text()

    bytes_before = (out / "runs.parquet").read_bytes()
    assert "8 runs done, 0 left" in _fleet(path)[1]
    assert (out / "runs.parquet").read_bytes() == bytes_before
    # What is missing is run again, here and not in a process, to the same result but for the time it took.
    request.getfixturevalue("computed_here")
    run = next((out / "runs").rglob("*.json"))
    run.unlink()
    assert "7 runs done, 1 left" in _fleet(path)[1]
    timing = ["seconds", "plan_median_s", "plan_longest_s"]
    pd.testing.assert_frame_equal(read_dataset(out).drop(columns=timing), rows.drop(columns=timing))


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_parts_of_a_fleet_run_apart_come_together(tmp_path: Path) -> None:
    """The same dataset and page as in one go, also where a variant has another name; nothing is run again."""
    parts = []
    for first in (0, 1):
        (tmp_path / str(first)).mkdir()
        part = _file(tmp_path / str(first), buildings=[{"generated": {"seed": 5, "count": 1, "first": first}}])
        assert _fleet(part)[0] == 0
        parts.append(part.parent / "out")
    elsewhere = tmp_path / "sent.parquet"
    elsewhere.write_bytes((parts[1] / "runs.parquet").read_bytes())
    renamed = {"timer": RULES["thermostat"], "native": RULES["native"]}
    path = _file(tmp_path, variants=renamed, reference="timer")
    code, said = _fleet(path, "--reuse", str(parts[0]), "--reuse", str(elsewhere))
    assert code == 0, said
    assert "0 runs done, 8 taken from other datasets, 0 left" in said
    rows = read_dataset(tmp_path / "out")
    assert set(rows["variant"]) == {"timer", "native"}
    apart = pd.concat([read_dataset(part) for part in parts]).replace({"variant": {"thermostat": "timer"}})
    columns = [name for name in SCHEMA.names if name != "variant"]
    pd.testing.assert_frame_equal(
        rows.sort_values("key", ignore_index=True)[columns], apart.sort_values("key", ignore_index=True)[columns]
    )
    assert "native against timer in 4 runs" in (tmp_path / "out" / "index.html").read_text()
    (tmp_path / "more").mkdir()
    more = _file(tmp_path / "more", buildings=[{"generated": {"seed": 5, "count": 3}}])
    assert "8 taken from other datasets, 4 left" in _fleet(more, "--reuse", str(tmp_path / "out"))[1]


def test_rows_in_the_repository_are_those_of_the_fleet_that_ships() -> None:
    file, path = load_fleet("portfolio")
    (source,) = file.buildings
    assert source.generated is not None
    first = source.model_copy(update={"generated": source.generated.model_copy(update={"count": 2})})
    runs = runs_of(file, buildings_of(file.model_copy(update={"buildings": (first,)}), path), path)
    kept = pd.read_parquet(ROOT / "docs" / "evidence" / "fleet_runs.parquet", columns=["building", "variant", "key"])
    assert len(kept) == 24 * source.generated.count
    # Rows of the MPC are of before the network was kept by default; they are measured anew with four hours of time.
    baselines = [run.cell for run in runs if run.cell.task is None]
    of_both = kept.building.isin({run.building.name for run in runs}) & kept.variant.isin(
        {c.variant for c in baselines}
    )
    assert {cell.key for cell in baselines} == set(kept.key[of_both])


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_trajectories_of_the_same_inputs_are_there_under_every_name(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("name,testcase\nnorth/1,generated:5:0\nsouth,generated:5:0\n")
    rules = {"native": RULES["native"], "again": RULES["native"]}
    keys: dict[str, Any] = {"buildings": [{"table": "two.csv"}], "windows": ["cold_week"], "trajectories": True}
    assert _fleet(_file(tmp_path, variants=rules, reference="native", **keys))[0] == 0
    courses = pd.read_parquet(tmp_path / "out" / "trajectories").astype({"building": str, "variant": str})
    runs = [part.drop(columns=["building", "variant"]) for _, part in courses.groupby(["building", "variant"])]
    assert len(runs) == 4
    for run in runs[1:]:
        pd.testing.assert_frame_equal(run.reset_index(drop=True), runs[0].reset_index(drop=True))
    # Another name is no reason to run it again, and the former one is gone.
    code, said = _fleet(_file(tmp_path, variants={"own": RULES["native"]}, reference="own", **keys))
    assert (code, "2 runs done, 0 left" in said) == (0, True)
    courses = pd.read_parquet(tmp_path / "out" / "trajectories").astype(str)
    assert set(zip(courses["building"], courses["variant"], strict=True)) == {("north/1", "own"), ("south", "own")}


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_reused_runs_of_the_same_inputs_keep_their_own_names(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("name,testcase\nnorth,generated:5:0\nsouth,generated:5:0\n")
    path = _file(tmp_path, buildings=[{"table": "two.csv"}], variants=RULES | {"again": RULES["thermostat"]})
    assert _fleet(path)[0] == 0
    made = (tmp_path / "out").rename(tmp_path / "made")
    code, said = _fleet(path, "--reuse", str(made))
    assert (code, " 0 left" in said) == (0, True)
    pd.testing.assert_frame_equal(read_dataset(tmp_path / "out"), read_dataset(made))


def test_after_a_change_of_the_source_kept_runs_name_the_model_that_they_had(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = {"ours": {"controller": "rc_mpc"}}
    path = _file(tmp_path, variants=ours, reference="ours", buildings=[{"generated": {"seed": 5, "count": 1}}])
    file, results = load_fleet(str(path))[0], Store(tmp_path / "out")
    runs = runs_of(file, buildings_of(file, path), path)
    for run in runs:
        (task,) = tasks_of([run])
        record = failure(run.cell, "") | {"status": "done", "kpis": {"cost_tot": 1.0, "tdis_tot": 0.0, "ener_tot": 1.0}}
        results.put(task, Ran(record))
        for need in task.needs:
            results.put(need, Identified(refused="too few steps"))
    assert _fleet(path)[0] == 0
    models, rows = (tmp_path / "out" / name for name in ("models.parquet", "runs.parquet"))
    before = models.read_bytes(), rows.read_bytes()
    for module in (cells, comparing):
        monkeypatch.setattr(module, "source_fingerprint", lambda: "other")
    code, said = _fleet(path)
    assert code == 0, said
    assert "Note: 2 of them made by other source code of this version" in said
    assert (models.read_bytes(), rows.read_bytes()) == before
    assert pd.read_parquet(models)["verdict"].tolist() == ["refused: too few steps"] * 2


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_a_damaged_model_of_finished_runs_is_identified_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = {"ours": {"controller": "rc_mpc"}}
    path = _file(tmp_path, variants=ours, reference="ours", buildings=[{"generated": {"seed": 5, "count": 1}}])
    file, results = load_fleet(str(path))[0], Store(tmp_path / "out")
    done = {"status": "done", "kpis": {"cost_tot": 1.0, "tdis_tot": 0.0, "ener_tot": 1.0}}
    model = Identified.of(simple_model())
    for task in tasks_of(runs_of(file, buildings_of(file, path), path)):
        results.put(task, Ran(failure(task.inputs, "") | done))
        for need in task.needs:
            results.put(need, model)
    assert _fleet(path)[0] == 0
    folders = sorted((tmp_path / "out" / "models").glob("*/*"))
    (folders[0] / "model.json").write_bytes(b"")
    monkeypatch.setattr(comparison_tasks, "identified", identified_at_once)
    code, said = _fleet(path)
    assert code == 0, said
    assert "2 runs done, 0 left" in said
    assert "1 model missing or damaged, to be identified again" in said
    assert Identified.read(folders[0]) == model
    assert pd.read_parquet(tmp_path / "out" / "models.parquet")["verdict"].tolist() == ["not judged"] * 2


def test_what_cannot_be_reused_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    pq.write_table(pa.table({"cost": [1.0]}), tmp_path / "other.parquet")
    code, said = _fleet(_file(tmp_path), "--reuse", str(tmp_path / "other.parquet"))
    assert (code, "other.parquet: its schema is none" in said) == (2, True)
    code, said = _fleet(_file(tmp_path), "--reuse", str(tmp_path / "nowhere.parquet"))
    assert (code, "nowhere.parquet: is missing" in said) == (2, True)
    texts = pa.schema([(name, pa.string()) for name in SCHEMA.names], metadata=SCHEMA.metadata)
    pq.write_table(texts.empty_table(), tmp_path / "texts.parquet")
    code, said = _fleet(_file(tmp_path), "--reuse", str(tmp_path / "texts.parquet"))
    assert (code, "texts.parquet: its schema is 1 with other columns" in said) == (2, True)
    row = {field.name: "" if field.type == pa.string() else 0 for field in SCHEMA}
    pq.write_table(pa.Table.from_pylist([row], SCHEMA), tmp_path / "damaged.parquet")
    whole = (tmp_path / "damaged.parquet").read_bytes()
    (tmp_path / "damaged.parquet").write_bytes(whole[:4] + bytes([255]) * 400 + whole[404:])
    code, said = _fleet(_file(tmp_path), "--reuse", str(tmp_path / "damaged.parquet"))
    assert (code, "damaged.parquet: is damaged" in said) == (2, True)
    code, said = _fleet(_file(tmp_path, trajectories=True), "--reuse", str(tmp_path / "other.parquet"))
    assert (code, "trajectories: true goes without --reuse" in said) == (2, True)
    assert not (tmp_path / "out").exists()


def test_files_of_weather_and_prices_are_read_before_the_first_building_runs(tmp_path: Path) -> None:
    """One that is wrong was found when its building came, hours later, and the next one after it."""
    (tmp_path / "w.epw").write_text("no weather")
    (tmp_path / "prices.csv").write_text("no prices\n")
    rows = [
        f"{name},bestest_hydronic_heat_pump,{weather}"
        for name, weather in (("a", "w.epw"), ("b", "gone.mos"), ("c", "w.epw"))
    ]
    (tmp_path / "few.csv").write_text("\n".join(["name,testcase,weather", *rows]))
    prices = {"scenario": {"plant": {"prices_file": str(tmp_path / "prices.csv")}}}
    code, said = _fleet(_file(tmp_path, buildings=[{"table": "few.csv"}], windows=["44"], **prices), "--count")
    assert code == 2
    for text in ("building 'a' and 1 other: plant.weather: ", "building 'b': plant.weather: ", "plant.prices_file: "):
        assert text in said
    assert "gone.mos" in said


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_a_run_that_fails_is_listed_and_the_others_are_kept(tmp_path: Path) -> None:
    (tmp_path / "few.csv").write_text("name,testcase,url\nnorth,bestest_hydronic_heat_pump,http://127.0.0.1:9\n")
    path = _file(
        tmp_path,
        buildings=[{"generated": {"seed": 5, "count": 1}}, {"table": "few.csv"}],
        windows=["peak_heat_day"],
        scenario={"plant": {"patience_min": 0}},
    )
    code, said = _fleet(path)
    assert code == 3
    assert "FAILED north, peak_heat_day" in said
    rows = read_dataset(tmp_path / "out")
    assert dict(rows.groupby("building")["status"].first()) == {"north": "failed", "generated:5:0": "done"}
    assert "Failed runs" in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"buildings": [{"generated": {"seed": 5, "count": 2, "colour": "red"}}]}, "colour"),
        ({"buildings": [{"generatd": {"seed": 5, "count": 2}}]}, "generatd"),
        ({"buildings": [{"generated": {"seed": 5, "count": 1}, "testcase": "x"}]}, "exactly one"),
        ({"buildings": [{"generated": {"seed": 5, "count": 2}}, {"testcase": "generated:5:1"}]}, "in the fleet twice"),
        ({"buildings": [{"testcase": "bestest_hydronic_heatpump"}]}, "bestest_hydronic_heatpump"),
        ({"reference": "pi"}, "'pi' is not among the variants"),
        ({"prices": ["free"]}, "prices"),
        ({"windows": ["cold_weak"]}, "few.yaml: building 'generated:5:0': windows: 'cold_weak' is not a window"),
        (
            {"buildings": [{"generated": {"seed": 5, "count": 2}}, {"testcase": "bestest_hydronic_heat_pump"}]},
            "few.yaml: building 'bestest_hydronic_heat_pump': windows: bestest_hydronic_heat_pump has no 'cold_week'; "
            "use peak_heat_day, typical_heat_day, or the day",
        ),
        (
            {"buildings": [{"testcase": "energyplus:small_office"}], "windows": ["typical_heat_day"]},
            "has no 'typical_heat_day'; use peak_heat_day, cold_day, mix_day, peak_cool_day, or the day",
        ),
        (
            {
                "buildings": [{"testcase": "bestest_air"}],
                "scenario": {"plant": {"kind": "boptest", "url": "http://127.0.0.1:9"}},
            },
            "windows: bestest_air has no 'cold_week'; use peak_heat_day",
        ),
        ({"windows": [400]}, "'400': a start day lies between 0 and 365"),
        ({"windows": ["nan"]}, "windows: 'nan' is"),
        ({"seeds": [1, 1]}, "twice"),
        ({"seeds": [-1]}, "few.yaml:\n  line 7: seeds.0: Input should be greater than or equal to 0"),
        ({"buildings": [{"testcase": "nope"}]}, "few.yaml: buildings.0.testcase: unknown testcase 'nope'"),
        ({"windows": ["44", "44.0"]}, "windows: '44' and '44.0' are the same start day"),
        ({"scenario": {"perid": 3}}, "perid"),
        ({"scenario": {"price": "dynamic"}}, "price: has a key of its own in a fleet, which would replace it: prices"),
        ({"variants": {"ours": {"controller": "thermoforce"}}, "reference": "ours"}, "thermoforce"),
        ({"buildings": [{"table": "none.csv"}]}, "none.csv"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_wrong_file_is_refused_before_anything_is_run(tmp_path: Path, keys: dict[str, Any], says: str) -> None:
    code, said = _fleet(_file(tmp_path, **keys))
    assert code == 2
    assert says in said
    assert "at least 1 item" not in said
    assert not (tmp_path / "out").exists()


def test_a_window_that_an_fmu_does_not_have_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "house.fmu", "w") as archive:
        archive.writestr("resources/days.json", '{"mix_day": 100}')
    (tmp_path / "few.csv").write_text("name,testcase,fmu\nnorth,bestest_air,house.fmu\n")
    code, said = _fleet(_file(tmp_path, buildings=[{"table": "few.csv"}]), "--code", str(tmp_path / "house.fmu"))
    assert code == 2
    assert "few.yaml: building 'north': windows: bestest_air has no 'cold_week'; use mix_day, or the day" in said


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_the_first_example_of_the_guide_is_one_that_can_be_run(tmp_path: Path) -> None:
    guide = (ROOT / "docs" / "how-to" / "fleet.md").read_text(encoding="utf-8")
    example = (
        guide.split("```yaml\n")[1].split("```")[0].replace("count: 40", "count: 1").replace("count: 4", "count: 1")
    )
    (tmp_path / "fleet.yaml").write_text(example, encoding="utf-8")
    (tmp_path / "buildings.csv").write_text("name,testcase\nnorth,generated:5:0\n")
    code, said = _fleet(tmp_path / "fleet.yaml", "--count")
    assert code == 0, said


def test_a_dataset_of_another_schema_is_refused(tmp_path: Path) -> None:
    path = _file(tmp_path)
    (tmp_path / "out").mkdir()
    pq.write_table(pa.table({"cost": [1.0]}), tmp_path / "out" / "runs.parquet")
    code, said = _fleet(path)
    assert code == 2
    assert f"its schema is none, this release writes {FORMAT}" in said
    assert not (tmp_path / "out" / "runs").exists()
    with pytest.raises(ConfigError, match=r"runs\.parquet: is missing"):
        read_dataset(tmp_path / "elsewhere")


def test_a_table_names_buildings_and_their_own_files(tmp_path: Path) -> None:
    (tmp_path / "few.csv").write_text(
        "name,testcase,model,weather\nours,bestest_hydronic_heat_pump,m,w.epw\nb,house:2rooms,,\n"
    )
    path = _file(tmp_path, buildings=[{"table": "few.csv"}])
    ours, rooms = buildings_of(*load_fleet(str(path)))
    assert ours.scenario["identification"] == {"model": str(tmp_path / "m")}
    assert ours.scenario["plant"] == {"weather": str(tmp_path / "w.epw")}
    assert (rooms.name, rooms.scenario) == ("b", {"testcase": "house:2rooms"})


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name,testcase,colour\n", "'colour' is not known"),
        ("name\n", "needs the columns name and testcase"),
        ("name,record,map\na,x.csv,\n", "line 2: record and map go together"),
        ("name,testcase\n", "has no buildings"),
        ("name,testcase,testcase\na,house:2rooms,house:3rooms\n", "a column is given twice"),
        (f"name,testcase\n{'a' * 200_000},house:2rooms\n", "is not CSV"),
        ("name,testcase\na,house:2rooms\n,house:2rooms\n", "line 3: needs a name"),
        ("name,testcase\na,house:99rooms\n", "line 2: .*99"),
        ("name,testcase,url,fmu\na,bestest_air,http://x,y.fmu\n", "line 2: url and fmu"),
    ],
    ids=lambda text: text[:20],
)
def test_a_wrong_table_is_refused_with_its_line(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "few.csv").write_text(text)
    with pytest.raises(ConfigError, match=rf"few\.csv: .*{says}|few\.csv: {says}"):
        buildings_of(*load_fleet(str(_file(tmp_path, buildings=[{"table": "few.csv"}]))))


def test_saving_and_discomfort_are_counted_against_the_same_run_of_the_reference() -> None:
    rows = _rows(
        building=["a", "b", "c", "d", "a", "b", "c", "d"],
        variant=["mpc"] * 4 + ["rule"] * 4,
        machine=["boiler", "boiler", "electric", "electric"] * 2,
        cost_tot=[0.9, 1.1, 0.8, 0.5, 1.0, 1.0, 1.0, 0.5],
        tdis_tot=[0.0, 0.0, 2.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        ener_tot=[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01],
        plans_watch=[0, 0, 50, 0] + [0] * 4,
        plans_solved=[100, 100, 50, 100] + [0] * 4,
    )
    pairs = paired(rows, "mpc", "rule").set_index("building")
    assert pairs["saving"].round(6).tolist()[:3] == [0.1, -0.1, 0.2]
    assert pd.isna(pairs.loc["d", "saving"])  # its reference hardly heats
    assert pairs["more_Kh"].tolist() == [0.0, -1.0, 2.0, 0.0]
    assert pairs.loc["b", "why"] == "dearer: but more comfortable than the reference"
    assert "the model did not hold" in pairs.loc["c", "why"]
    assert pairs.loc["a", "why"] == pairs.loc["d", "why"] == ""

    pairs = pairs.reset_index()
    everything, boilers, electric = groups(pairs)
    assert (everything.runs, everything.counted) == (4, 3)
    assert everything.cheaper == pytest.approx(2 / 3)
    assert (boilers.value, boilers.saving[1]) == ("boiler", pytest.approx(0.0))
    assert electric.colder == 0.5
    worst = lost(pairs)
    assert worst["building"].tolist() == ["c", "b"]  # comfort before cost
    assert [n for _, n in causes(worst)] == [1, 1]


def test_where_the_reference_earns_or_costs_nothing_there_is_no_share_and_the_lower_cost_is_no_loss() -> None:
    rows = _rows(
        building=["a", "b", "c", "a", "b", "c"],
        variant=["mpc"] * 3 + ["rule"] * 3,
        cost_tot=[-2.0, -0.5, 0.1, -1.0, -1.0, 0.0],
        tdis_tot=[0.0] * 6,
        key=[*"abcdef"],
    )
    pairs = paired(rows, "mpc", "rule")
    assert pairs["saving"].isna().all()
    assert [why.split(":")[0] for why in pairs["why"]] == ["", "dearer", "dearer"]
    (everything,) = groups(pairs)
    assert everything.counted == 0
    assert "saving –;" in headline(everything, "mpc", "rule")
    page = fleet_page(rows, "rule", "Fleet", "tf-mpc fleet x", {key: Scenario(testcase="x") for key in "abcdef"})
    assert "No run has a saving" in page
    assert "A point is a run" not in page


def test_a_page_without_finished_runs_has_no_links_to_them_and_tells_failed_runs_apart() -> None:
    rows = _rows(
        building=["a", "a"], variant=["mpc", "mpc"], status=["failed"] * 2, reason=["no weather"] * 2, seed=[1, 2]
    )
    page = fleet_page(rows, "rule", "Fleet", "tf-mpc fleet x", {})
    anchors, places = re.findall(r'href="#([^"]+)"', page), re.findall(r'id="([^"]+)"', page)
    assert "failed" in anchors
    assert set(anchors) <= set(places)
    assert "a, w, p, mpc, seed 1: no weather" in page
    assert "a, w, p, mpc, seed 2: no weather" in page


def test_a_rule_has_no_model_though_a_step_was_refused() -> None:
    rows = _rows(
        building=["a", "a"], variant=["pi", "rule"], cost_tot=[1.1, 1.0], plans_rule=[96, 96], plans_refused=[1, 0]
    )
    assert paired(rows, "pi", "rule")["why"].tolist() == ["dearer"]


def test_the_page_says_what_a_stranger_named(tmp_path: Path) -> None:
    rows = _rows(
        building=["<b>", "<b>"], variant=["mpc", "rule"], cost_tot=[1.2, 1.0], tdis_tot=[0.0, 0.0], key=["k", "l"]
    )
    page = fleet_page(rows, "rule", "Fleet", "tf-mpc fleet x", {"k": Scenario(testcase="x", seed=3)})
    assert "<b>" not in page
    assert "&lt;b&gt;" in page
    assert "--seed 3" in page
    assert "dearer: the plans acted on their model" in page


def test_the_commands_of_the_page_repeat_their_runs(tmp_path: Path) -> None:
    (tmp_path / "few.csv").write_text("name,testcase,weather\nnorth wing,bestest_hydronic_heat_pump,w.epw\n")
    (tmp_path / "w.epw").write_text("")
    path = _file(
        tmp_path,
        buildings=[{"table": "few.csv"}],
        windows=["44"],
        scenario={"plant": {"forecast_uncertainty": "high"}, "identification": {"days": 2}},
        variants=RULES
        | {"slow": {"controller": "rc_mpc", "step_s": 3600, "options": {"objective": {"comfort_weight_per_m2": 1e-5}}}},
    )
    file = load_fleet(str(path))[0]
    for run in runs_of(file, buildings_of(file, path), path):
        words = shlex.split(run_command(run.cell.scenario))
        assert words[:2] == ["tf-mpc", "run"]
        assert scenario_from(run_one.make_context("run", words[2:]).params) == run.cell.scenario


def test_without_a_heated_run_no_saving_is_said() -> None:
    rows = _rows(
        building=["a", "a"], variant=["mpc", "rule"], cost_tot=[0.0, 0.0], tdis_tot=[0, 0], ener_tot=[0.0, 0.0]
    )
    (everything,) = groups(paired(rows, "mpc", "rule"))
    said = headline(everything, "mpc", "rule")
    assert said.startswith("mpc against rule in 1 run, 0 of which count for the saving: saving –; 0 % more than 0.5 K")
    assert saving_cells(everything) == ("–", "–", "–")


MAP = """\
time: {zone: UTC}
outdoor: {column: out, unit: °C}
sun: {column: sun, unit: W/m2}
zones:
  zone: {temperature: {column: room, unit: °C}, lower: 21, upper: 24}
actuators:
  actuator: {level: level}
machines:
  machine: {power: {column: power, unit: W}, price: 0.3}
"""


def _measured(path: Path, *, heated: bool) -> None:
    """Three days of an embedded plant that is probed, or left to itself, as a table."""
    plant = EmbeddedPlant(synthetic_weather())
    if heated:
        record = probe(plant, 20 * DAY_S, 3.0, seed=1)
    else:
        record = Record.beginning(plant.reset(20 * DAY_S, DAY_S))
        for _ in range(288):
            record = record.extended(plant.advance(0.0, 900.0))
    at = pd.date_range("2025-01-21", periods=record.n_steps + 1, freq="15min", name="when", tz="UTC")
    ends = {"level": [*record.u[0], np.nan], "power": [*record.power_W[0], np.nan]}
    columns = {"room": record.T_zone_C[0], "out": record.T_out_C, "sun": record.solar_W_m2}
    pd.DataFrame(columns | ends, index=at).to_csv(path)


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_an_identification_that_fails_is_listed_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "good.csv").write_text("when,room,out,sun,level,power\n")
    (tmp_path / "few.csv").write_text("name,record,map\nnorth,good.csv,map.yaml\n")
    # A function that a worker finds, and that fails there.
    monkeypatch.setattr(fleet_runs, "identified_from", os.abort)
    code, said = _fleet(_file(tmp_path, buildings=[{"table": "few.csv"}]))
    assert (code, "north: no model from its measurements: TypeError" in said) == (3, True)
    (row,) = pd.read_parquet(tmp_path / "out" / "models.parquet").to_dict("records")
    assert (row["building"], row["verdict"].startswith("failed: TypeError")) == ("north", True)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"controllers": ["thermostat"]}, "controllers: unknown key, did you mean 'variants.NAME.controller'?"),
        ({"variants": {"controller": ["pi"]}}, "variants.controller: expected keys and values, of controller, iden"),
    ],
    ids=["elsewhere", "no name"],
)
def test_what_stands_under_a_name_is_told_with_one(tmp_path: Path, wrong: dict[str, object], says: str) -> None:
    code, said = _fleet(_file(tmp_path, **wrong), "--count")
    assert (code, says in said) == (2, True), said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("machines:", "machine:"), "line 8: machine: unknown key, did you mean 'machines'?"),
        (("column: room", "column: rom"), r"good.csv: no column 'rom', did you mean 'room'?"),
        (("  zone: {", "  bath: {"), "map.yaml: zones: it has bath, test case 'bestest_hydronic_heat_pump' has zone"),
        (("{level: level}", "{level: level, mode: cooling}"), "actuators.actuator.mode is cooling"),
    ],
    ids=["key", "column", "names", "mode"],
)
def test_a_map_that_does_not_fit_is_refused_before_anything_is_run(
    tmp_path: Path, change: tuple[str, str], says: str
) -> None:
    (tmp_path / "map.yaml").write_text(MAP.replace(*change))
    (tmp_path / "good.csv").write_text("when,room,out,sun,level,power\n")
    (tmp_path / "few.csv").write_text("name,testcase,record,map\na,bestest_hydronic_heat_pump,good.csv,map.yaml\n")
    code, said = _fleet(_file(tmp_path, buildings=[{"table": "few.csv"}], windows=["44"]), "--count")
    assert (code, "few.csv: line 2: " in said, says in said) == (2, True, True), said


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_a_building_without_a_model_runs_what_needs_none_and_says_why_of_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "off.csv").write_text("when,room,out,sun,level,power\n")
    (tmp_path / "few.csv").write_text("name,testcase,record,map\nnorth,generated:5:0,off.csv,map.yaml\n")
    variants = {"native": RULES["native"], "ours": {"controller": "rc_mpc"}}
    path = _file(tmp_path, buildings=[{"table": "few.csv"}], windows=["44"], variants=variants, reference="native")
    code, said = _fleet(path)
    assert code == 3, said
    assert "1 building to identify from measurements\n2 controllers: 2 runs, 0 identifications" in said
    assert "north: no model from its measurements: " in said
    out = tmp_path / "out"
    rows = read_dataset(out).set_index("variant")
    assert rows["status"].to_dict() == {"native": "done", "ours": "failed"}
    assert rows.loc["ours", "reason"].startswith("no model from its measurements: refused: ")
    assert "off.csv: the table has no rows" in rows.loc["ours", "reason"]
    assert rows.loc["ours", "reason"].split(": ", 1)[1] in (out / "index.html").read_text()
    assert pd.read_parquet(out / "models.parquet")["verdict"].str.startswith("refused: ").tolist() == [True]
    code, said = _fleet(path)
    assert (code, "1 run done, 0 left" in said) == (3, True)


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here", "identified_once")
def test_buildings_of_a_table_are_identified_from_their_measurements_and_run_on_them(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAP)
    _measured(tmp_path / "good.csv", heated=True)
    _measured(tmp_path / "off.csv", heated=False)
    (tmp_path / "few.csv").write_text(
        "name,testcase,record,map\n"
        "good,bestest_hydronic_heat_pump,good.csv,map.yaml\n"
        "only known,,good.csv,map.yaml\n"
        "never heated,bestest_hydronic_heat_pump,off.csv,map.yaml\n"
    )
    path = _file(
        tmp_path,
        buildings=[{"table": "few.csv"}],
        windows=["44"],
        variants={"thermoforce_mpc": {"controller": "thermoforce_mpc"}, **RULES},
    )
    code, said = _fleet(path)
    assert code == 3, said
    assert "3 buildings to identify from measurements" in said
    assert "never heated: no model from its measurements: " in said
    rows = read_dataset(tmp_path / "out")
    assert rows["building"].tolist() == ["good"] * 3 + ["never heated"] * 3
    assert rows["status"].tolist() == ["done"] * 4 + ["failed", "done"]
    assert rows.set_index("variant")["plans_solved"]["thermoforce_mpc"].iloc[0] > 0
    models = pd.read_parquet(tmp_path / "out" / "models.parquet").set_index("building")
    assert models.loc["good", "competent"]
    assert models.loc["only known", "effect_K"] == models.loc["good", "effect_K"]
    assert models.loc["never heated", "verdict"].startswith("refused")
    assert "5 runs done, 0 left" in _fleet(path)[1]
