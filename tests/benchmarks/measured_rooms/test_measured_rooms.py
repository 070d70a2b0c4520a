"""The bench of measured rooms: its records, its scores on a simulated box, and the comparison with an earlier run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from places import SHARED

from benchmarks.measured_rooms import bench
from benchmarks.measured_rooms.against import earlier_rooms, ratio_rows, targets
from benchmarks.measured_rooms.records import BOX, KNOWN, found_records
from benchmarks.measured_rooms.score import DEFAULT, PERSISTENCE, identified, score, split, starts_of
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import DataError

_GAIN_K, _TAU_H, _FULL_W = 20.0, 12.0, 100.0


def _box(folder: Path, days: float = 12.0) -> Path:
    """A box of one capacity under random blocks of heat, in the file and columns of the real one."""
    n = round(48 * days)
    time_h = 0.5 * np.arange(n)
    outdoor = 15.0 + 5.0 * np.sin(2 * np.pi * (time_h - 9.0) / 24)
    heat = _FULL_W * np.repeat(np.random.default_rng(1).random(n // 6 + 1) > 0.5, 6)[:n]
    T, decay = np.full(n, 25.0), np.exp(-0.5 / _TAU_H)
    for t in range(n - 1):
        steady = 0.5 * (outdoor[t] + outdoor[t + 1]) + _GAIN_K * heat[t] / _FULL_W
        T[t + 1] = steady + decay * (T[t] - steady)
    table = {"Time": 3600 * time_h, "T_ext": outdoor, "P_hea": heat, "I_sol": 0.0 * time_h, "T_int": T.round(3)}
    pd.DataFrame(table).to_csv(folder / BOX, index=False)
    return folder


def _bench(*words: str) -> Any:
    return CliRunner().invoke(cli, ["bench", "rooms", "--quick", "--jobs", "1", *words])


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_a_simulated_box_is_predicted_and_compared_with_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    models = []
    monkeypatch.setattr(bench, "identified", lambda *given: models.append(identified(*given)) or models[0])
    done = _bench("--records", str(_box(tmp_path)), "--json", str(first))
    assert done.exit_code == 0, done.output
    rows = json.loads(first.read_text())["rows"]
    errors, model = rows[:2]
    assert (errors["record"], errors["room"], errors["starts"]) == ("box", "box", 8)
    assert errors["default_24h_K"] < 0.5 * min(errors["weather_24h_K"], errors["persistence_24h_K"])
    assert errors["rc_24h_K"] < 0.5 * errors["persistence_24h_K"]
    assert model["full_48h_K"] == pytest.approx(_GAIN_K * (1 - np.exp(-48 / _TAU_H)), rel=0.4)
    assert model["all_full_48h_K"] == model["full_48h_K"]
    assert model["says"] == "competent"
    monkeypatch.setattr(bench, "identified", lambda *given: models[0])
    done = _bench("--records", str(tmp_path), "--against", str(first), "--json", str(second))
    assert done.exit_code == 0, done.output
    again = json.loads(second.read_text())
    assert [target["value"] for target in again["targets"]] == [1.0] * 8
    assert all(target["holds"] for target in again["targets"])


def test_a_folder_without_records_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none of .*armadillo"):
        found_records([tmp_path])
    with pytest.raises(DataError, match="no such record; there are all19, one19"):
        found_records([tmp_path], ["all20"])
    assert "does not exist" in _bench("--records", str(tmp_path / "nowhere")).output
    (tmp_path / BOX).touch()
    (tmp_path / "ehbe").mkdir()
    (tmp_path / KNOWN[0].file).touch()
    assert [one.name for one, _ in found_records([tmp_path], ["box"])] == ["box"]
    with pytest.raises(DataError, match=r"its map all19.yaml is not"):
        found_records([tmp_path])


def _row(room: str, rmse: float | None, starts: int = 10) -> dict[str, Any]:
    methods = ("default", "rc", "weather", "persistence")
    values = {f"{method}_{hours}h_K": rmse for method in methods for hours in (6, 24)}
    return {"record": "r", "room": room, "starts": starts, **values}


def test_rooms_are_held_against_those_of_an_earlier_run() -> None:
    before = [
        _row("a", 0.5),
        _row("b", 0.5),
        _row("c", 0.5),
        _row("refused", None, 0),
        {**_row("a", 9.0), "record": "s"},
    ]
    now = [_row("a", 0.4), _row("b", 0.5), _row("c", 0.6), _row("refused", 0.1), _row("new", 0.1)]
    ratios = ratio_rows(now, before)
    assert [(row["room"], row["default_6h_ratio"]) for row in ratios] == [("a", 0.8), ("b", 1.0), ("c", 1.2)]
    median, worst = targets(ratios)[:2]
    assert (median.value, median.holds) == (1.0, True)
    assert (worst.value, worst.holds, "r c" in worst.name) == (1.2, False, True)


def test_a_room_that_has_no_model_any_more_fails() -> None:
    found = targets(ratio_rows([_row("a", 0.1), _row("b", None, 0)], [_row("a", 0.5), _row("b", 0.5)]))
    assert not any(target.holds for target in found)
    assert "r b" in found[1].name
    assert not any(target.holds for target in targets([]))


def test_runs_of_other_starts_are_not_compared(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="had 10 starts, now 3"):
        ratio_rows([_row("a", 0.1, 3)], [_row("a", 0.5)])
    file = tmp_path / "other.json"
    for text in ("{", '{"bench": "operation", "rows": []}', '{"bench": "rooms", "rows": []}', "[]"):
        file.write_text(text)
        with pytest.raises(DataError, match="--against"):
            earlier_rooms(file, "rooms")


@pytest.mark.slow
def test_a_measured_room_beside_its_neighbours() -> None:
    folder = SHARED / "measured_buildings"
    (one,) = (record for record in KNOWN if record.name == "one19")
    if not (folder / one.file).is_file():
        pytest.skip(f"measured buildings not found at {folder}")
    measured = one.read(folder)
    record = measured.record.slice(0, 21 * 96)
    starts = starts_of(record, 24.0)
    assert starts[0] == split(record) == round(0.6 * record.n_steps - 0.6)
    assert starts[-1] + 96 <= record.n_steps
    model = identified(record, measured.layout)
    verdict = model.only.card.competence
    assert not verdict.competent, "its heated neighbours are left out"
    assert any(reason.startswith("24 h ahead it errs by") for reason in verdict.reasons)
    found = score(model, record, 24.0)
    assert found.starts == len(starts)
    assert (found.rmse_K[DEFAULT] < found.rmse_K[PERSISTENCE]).all()
    assert found.own_K[0] > 3.0
