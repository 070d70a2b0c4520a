"""The bench of effects: made-up models of known bias and coverage, and two houses for real."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.effects import bench
from benchmarks.effects.asking import Answer, Score, said, scored, without_steps
from benchmarks.effects.energies import QUESTIONS, EnergyAnswer, energy_answers, lived_until
from benchmarks.effects.operated import (
    HouseAnswer,
    OperatedCase,
    PairAnswer,
    ask_operated,
    operated_rows,
    operated_targets,
)
from benchmarks.effects.windows import OFF_H, STEP_S, WINDOWS, block
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant
from thermoforce_mpc.plants.rooms import house_of_rooms

HOURS = (1, 2, 4, 8, 12, 24, 48)
STEPS = block().size
OFF = Record(
    time_s=35 * DAY_S + STEP_S * np.arange(STEPS + 1.0),
    T_zone_C=np.full(STEPS + 1, 15.0),
    T_out_C=np.zeros(STEPS + 1),
    solar_W_m2=np.zeros(STEPS + 1),
    u=np.zeros(STEPS),
    power_W=np.zeros(STEPS),
    heat_W=np.zeros(STEPS),
)


def model(relative_sd: float | None) -> ThermalModel:
    """One mode of 12 h and 12 K, known to `relative_sd`; None: to nothing that it could say."""
    pole = np.exp(-STEP_S / HOUR_S / 12.0)
    known = {}
    if relative_sd is not None:
        for hours in HOURS:
            effect = 12.0 * -np.expm1(-hours / 12.0)
            known |= {f"step_response_{hours}h_K": effect, f"step_response_{hours}h_sd_K": relative_sd * effect}
    operator = linear_operator(np.array([pole]), np.array([12.0 * (1.0 - pole)]), step_s=STEP_S)
    return ThermalModel.single(operator, card=ModelCard(uncertainty=known))


def answer(n: int, bias: float, half: float = 0.2, **changes) -> Answer:
    """A house whose true effect is 2 K in every window; `half`: half width of the band, K."""
    said_K = 2.0 * (1.0 + bias)
    scores = tuple(Score(window.name, 2.0, said_K, said_K - half, said_K + half) for window in WINDOWS)
    values = {"building": f"generated:1:{n}", "draw": "seed 1", "words": "", "days": 3.0, "scores": scores}
    return Answer(**(values | changes))


def test_the_question_is_six_hours_at_full_level_and_the_windows_begin_with_it() -> None:
    u = block()
    assert u.sum() * STEP_S == 6 * HOUR_S
    assert u.size * STEP_S == (OFF_H + 48) * HOUR_S
    assert np.flatnonzero(u)[0] * STEP_S == OFF_H * HOUR_S
    hours_on = np.cumsum(u) * STEP_S / HOUR_S
    found = {window.name: window.of(hours_on) for window in WINDOWS}
    assert found["6 h, end"] == 6.0
    assert found["8 h"] == pytest.approx((24 * 3.125 + 8 * 6.0) / 32)
    assert found["48 h"] == pytest.approx((24 * 3.125 + 168 * 6.0) / 192)


def test_the_truth_of_a_house_is_not_in_the_steps_of_its_sensor() -> None:
    name = "generated:62202:1"  # reads in steps of 0.5 K
    plant = without_steps(name)
    assert isinstance(plant, GeneratedHousePlant)
    plant.reset(35 * DAY_S, 0.0)
    for _ in range(8):
        plant.advance(1.0, STEP_S)
    read = plant.past(STEP_S).T_zone_C[0]
    assert np.abs(read / 0.5 - np.round(read / 0.5)).max() > 0.01
    assert without_steps("bestest_hydronic_heat_pump") is None


def test_a_model_says_what_its_equations_say() -> None:
    effect = said(model(0.1), OFF)
    risen = 12.0 * -np.expm1(-6.0 / 12.0)
    assert WINDOWS[0].of(effect) == pytest.approx(risen)
    assert effect[-1] == pytest.approx(risen * np.exp(-42.0 / 12.0))


@pytest.mark.parametrize(("relative_sd", "inside"), [(0.1, False), (0.2, True)])
def test_a_model_that_says_a_fifth_too_little_is_found_out(relative_sd: float, inside: bool) -> None:
    scores = scored(model(relative_sd), OFF, said(model(None), OFF) / 0.8)
    assert [score.window for score in scores] == [window.name for window in WINDOWS]
    for score in scores:
        assert score.bias == pytest.approx(-0.2)
        assert score.high_K - score.said_K == pytest.approx(1.645 * relative_sd * score.said_K)
        assert score.in_band is inside


def test_a_model_without_a_band_holds_no_truth() -> None:
    assert not any(score.in_band for score in scored(model(None), OFF, said(model(None), OFF)))


def test_rows_and_targets_of_known_biases() -> None:
    answers = [answer(n, bias) for n, bias in enumerate((-0.3, -0.05, 0.05, 0.08))]
    answers[0] = answer(0, -0.3, missed="the sign is not sure")
    refused = answer(4, 0.0, refused="no effect", scores=())
    rows = [row for row in bench.summary([*answers, refused]) if row["window"] == "48 h"]
    counts = {"draw": "seed 1", "days": 3.0, "houses": 5, "refused": 1, "not competent": 1, "window": "48 h"}
    assert rows == [
        counts | {"models": "all", "median_bias": 0.0, "mean_abs_bias": 0.12, "in_90_band": 0.75},
        counts | {"models": "competent", "median_bias": 0.05, "mean_abs_bias": 0.06, "in_90_band": 1.0},
    ]
    values = {(t.name.split(": ")[1], t.sense): t.value for t in bench.targets([*answers, refused])}
    assert values == {
        ("size of the median bias of 48 h", "at most"): pytest.approx(0.0),
        ("mean size of the bias of 48 h", "at most"): pytest.approx(0.12),
        ("share of 90 % bands that hold the truth", "at least"): 0.75,
        ("share of 90 % bands that hold the truth", "at most"): 0.75,
    }
    assert bench.row(refused)["bias 48 h"] is None
    assert bench.row(refused)["verdict"] == "refused"
    assert bench.row(answers[0])["truth outside"].startswith("6 h, end, 8 h")


def test_a_draw_without_a_model_meets_no_target() -> None:
    refused = answer(0, 0.0, refused="no effect", scores=())
    assert not any(target.holds for target in bench.targets([refused]))


def test_bands_may_be_too_wide() -> None:
    held = [target.holds for target in bench.targets([answer(n, 0.01, half=5.0) for n in range(20)])]
    assert held == [True, True, True, False]


def test_buildings_of_a_run_and_a_word_where_energyplus_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, lines = [], []

    def made_up(function, cases, engine, on_done):
        asked.extend(cases)
        return [[answer(0, -0.1, building=case.building, days=days) for days in case.days] for case in cases]

    monkeypatch.setattr(bench, "run_all", made_up)
    monkeypatch.setattr(bench.energyplus, "is_available", lambda: False)
    with LocalEngine(1) as engine:
        result = bench.run_effects_bench(seed=3, houses=2, days=(7, 3, 3), engine=engine, progress=lines.append)
        assert [case.building for case in asked] == ["generated:3:0", "generated:3:1", bench.EMBEDDED]
        assert {case.days for case in asked} == {(3, 7)}
        assert lines[0].startswith("EnergyPlus left out")
        embedded = [t for t in result["targets"] if t["name"].startswith("embedded plant")]
        assert [(t["value"], t["holds"]) for t in embedded] == [(pytest.approx(0.1), False)] * 2
        for wrong in ({"houses": 0}, {"days": ()}, {"days": (0.5,)}, {"days": (30.0,)}):
            with pytest.raises(InputError):
                bench.run_effects_bench(engine=engine, **wrong)


@pytest.mark.slow
@pytest.mark.usefixtures("computed_here")
def test_two_houses_for_real(tmp_path: Path) -> None:
    file = tmp_path / "effects.json"
    command = [
        "bench",
        "effects",
        "--quick",
        "--days",
        "1.5",
        "--jobs",
        "1",
        "--json",
        str(file),
        "--out",
        str(tmp_path),
    ]
    done = CliRunner().invoke(cli, command)
    assert done.exit_code == 0, done.output
    result = json.loads(file.read_text(encoding="utf-8"))
    assert [a["building"] for a in result["answers"]] == ["generated:1:0", "generated:1:1", bench.EMBEDDED]
    for found in result["answers"]:
        assert not found["refused"]
        for score in found["scores"]:
            assert score["true_K"] > 0.5
            assert score["low_K"] < score["said_K"] < score["high_K"]
            assert score["said_K"] == pytest.approx(score["true_K"], rel=0.6)
    assert len(result["targets"]) == 5
    assert (tmp_path / "effects.png").stat().st_size > 10_000


def answered(own_K: float, cross_K: float, *, competent: bool) -> HouseAnswer:
    """A house whose truth is 1 K in the own room and 0.2 K in the other, with bands of ± 30 %."""

    def scores(true_K: float, said_K: float) -> tuple[Score, ...]:
        return tuple(Score(window.name, true_K, said_K, 0.7 * said_K, 1.3 * said_K) for window in WINDOWS)

    pairs = (
        PairAnswer("bath", "valve", True, competent, scores(1.0, own_K)),
        PairAnswer("hall", "valve", False, competent, scores(0.2, cross_K)),
        PairAnswer("loft", "valve", False, competent, scores(0.01, -0.5)),  # too small to be told
    )
    return HouseAnswer("house:3rooms:1", "made up", pairs=pairs)


def test_operation_is_scored_by_own_and_cross_effects():
    answers = [answered(0.9, 0.25, competent=True), answered(0.4, 0.6, competent=True)]
    own, cross = operated_rows(answers)[-2:]
    assert (own["in_90_band"], own["median_bias"]) == (0.5, -0.35)
    assert (cross["in_90_band"], cross["signs"]) == (0.5, 1.0)
    wrong = operated_targets(answers)[-1]
    assert (wrong.value, wrong.goal) == (1, 0)
    assert not wrong.holds
    assert operated_targets([answered(0.4, 0.2, competent=False)])[-1].value == 0
    assert operated_rows([HouseAnswer("house:3rooms:1", "made up", "too short")])[-1]["in_90_band"] is None


def test_energies_of_other_levels_are_counted_by_question_and_as_told():
    def energy(question, true_kWh, half_kWh):
        return EnergyAnswer(question, 12.0, true_kWh, 10.0, 10.0 - half_kWh, 10.0 + half_kWh)

    night, shifted = list(QUESTIONS)[2:4]
    energies = (energy(night, 11.0, 1.5), energy(night, 8.0, 1.5), energy(shifted, 15.0, 6.0))
    house = replace(answered(0.9, 0.25, competent=True), energies=energies)
    rows = {row["energy of"]: row for row in operated_rows([house]) if "energy of" in row}
    assert (rows[night]["in_90_band"], rows[night]["told"], rows[night]["told_in_band"]) == (0.5, 2, 0.5)
    assert (rows[shifted]["in_90_band"], rows[shifted]["told"], rows[shifted]["told_in_band"]) == (1.0, 0, None)
    assert (rows["all"]["days"], rows["all"]["in_90_band"]) == (3, 0.667)
    every, told = operated_targets([house])[:2]
    assert every.value == pytest.approx(2 / 3)
    assert not every.holds
    assert told.value == 0.5
    assert np.isnan(operated_targets([answered(0.9, 0.25, competent=True)])[0].value)


def test_the_truth_of_an_energy_is_the_day_lived_again_at_other_levels(monkeypatch):
    plant = house_of_rooms("house:2rooms:3000")
    begins = lived_until(plant, 36 * DAY_S, 2 * DAY_S)
    record = plant.past(900.0).last(2 * 96)
    said = np.array([9.0])
    answer = SimpleNamespace(energy_other_kWh=said, energy_low_kWh=said - 1.0, energy_high_kWh=said + 1.0)
    asked = {}

    def told(model, record, levels, start):
        asked[start] = levels
        return answer

    monkeypatch.setattr("benchmarks.effects.energies.counterfactual", told)
    monkeypatch.setattr("benchmarks.effects.energies.QUESTIONS", {"as it was": lambda u: u, "off": lambda u: 0.0 * u})
    found = energy_answers(None, plant, record, begins)
    assert list(asked) == [record.time_s[0], record.time_s[96]]
    was = [float(record.power_W[0, k : k + 96].sum()) / 4000.0 for k in (0, 96)]
    assert [one.was_kWh for one in found[::2]] == pytest.approx(was)
    assert [one.true_kWh for one in found[::2]] == pytest.approx(was, rel=0.1)
    assert [one.true_kWh for one in found[1::2]] == [0.0, 0.0]
    assert [one.in_band for one in found[1::2]] == [False, False]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--days", "14", "--days", "21"), "takes one number of --days"),
        (("--days", "3"), "3 days of operation: expected 7 to 35"),
        (("--out", "x"), "draws no plot"),
    ],
)
def test_operation_takes_no_days_of_probing(words, message):
    said = CliRunner().invoke(cli, ["bench", "effects", "--mode", "operation", *words])
    assert said.exit_code != 0
    assert message in said.output + str(said.exception)


@pytest.mark.slow
def test_a_house_is_asked_after_a_week_of_operation():
    answer = ask_operated(OperatedCase(3, 0, rooms=2, days=7.0))
    assert not answer.refused
    assert [pair.own for pair in answer.pairs].count(True) == 2
    assert len(answer.pairs) == 4
    assert all(score.true_K > 0.0 for pair in answer.pairs if pair.own for score in pair.scores)
    assert all(np.isfinite([score.low_K, score.high_K]).all() for pair in answer.pairs for score in pair.scores)
