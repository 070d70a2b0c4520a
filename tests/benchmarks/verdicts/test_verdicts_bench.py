"""The bench of verdicts: made-up models of known worth, and a house for real."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.verdicts import bench, house
from benchmarks.verdicts.house import Case, Judged, Week
from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.model.card import Competence

THERMOSTAT = Week(0.50, 1.0, 3.0)


def model(n: int, *, passes: bool = True, error: float = 0.1, **changes) -> Judged:
    values = {"verdict": Competence(passes), "error": error, "ours": Week(0.45, 1.0, 3.0), "thermostat": THERMOSTAT}
    return Judged(n, "a house", 3.0, **(values | changes))


@pytest.mark.parametrize(
    ("ours", "more"),
    [
        (Week(0.45, 1.4, 3.0), False),
        (Week(0.45, 1.6, 3.0), True),
        (Week(0.51, 0.6, 3.0), True),
        (Week(0.51, 0.4, 3.0), False),
        (None, None),
    ],
    ids=["cheaper", "cheaper by less comfort", "dearer", "dearer for more comfort", "not run"],
)
def test_costs_are_compared_at_equal_comfort(ours: Week | None, more: bool | None) -> None:
    assert model(0, ours=ours).costs_more is more
    assert model(0, ours=ours).is_good is (more is not True)
    assert not model(0, ours=ours, error=0.6).is_good


def test_a_week_without_heating_says_nothing() -> None:
    assert model(0, ours=Week(0.51, 1.0, 3.0), thermostat=Week(0.0, 1.0, 0.0)).costs_more is None


def test_targets_of_known_models() -> None:
    dear, none = Week(0.60, 1.0, 3.0), {"verdict": None, "refused": "no effect", "error": float("nan"), "ours": None}
    models = [
        *(model(n) for n in range(8)),
        model(8, passes=False),
        model(9, passes=False, error=0.9),
        model(10, ours=dear),
        model(11, error=0.7),
        model(12, **none),
    ]
    values = {target.name.split(": ")[1].split(" (")[0]: target.value for target in bench.targets(models)}
    assert values == {
        "of 10 models that pass, cost more than the thermostat at equal comfort": 1.0,
        "of 10 models that pass, effect off by more than 50%": 1.0,
        "share of 9 good models that are held back": pytest.approx(1 / 9),
    }
    rows = {row["verdict"]: row for row in bench.summary(models)}
    assert [rows[name]["models"] for name in ("passes", "held back", "refused")] == [10, 2, 1]
    assert [rows[name]["good"] for name in ("passes", "held back", "refused")] == [8, 1, 0]
    assert bench.row(models[-1])["missed"] == "no effect"
    assert not any(target.holds for target in bench.targets(models))


def test_houses_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def made_up(function, cases, engine, on_done):
        asked.extend(cases)
        found = [[model(case.index)] for case in cases]
        on_done(1, found[0])
        return found

    monkeypatch.setattr(bench, "run_all", made_up)
    lines = []
    with LocalEngine(1) as engine:
        bench.run_verdicts_bench(seed=3, houses=3, closed_loop=1, days=(3, 2, 3), engine=engine, progress=lines.append)
        assert asked == [Case(3, n, (2, 3), n == 0) for n in range(3)]
        assert lines == ["1 of 3: 3 days passes, effect off by 10 %, costs no more"]
        for wrong in ({"houses": 0}, {"days": ()}, {"days": (0.5,)}, {"days": (30.0,)}):
            with pytest.raises(InputError):
                bench.run_verdicts_bench(engine=engine, **wrong)


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_two_houses_for_real(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With half a day in the place of the week."""
    monkeypatch.setattr(house, "WEEK_DAYS", 0.5)
    monkeypatch.setattr(house, "WARMUP_DAYS", 1)
    file = tmp_path / "verdicts.json"
    done = CliRunner().invoke(
        cli, ["bench", "verdicts", "--quick", "--days", "1.5", "--jobs", "1", "--json", str(file)]
    )
    assert done.exit_code == 0, done.output
    first, second = json.loads(file.read_text(encoding="utf-8"))["rows"][:2]
    assert 0.0 < first["effect_error"] < 0.5
    assert first["costs more"] is not None
    assert (second["ours"], second["costs more"]) == ("–", None)
