"""The bench of detectors: its panel, and what it makes of weeks."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from benchmarks.cli.closed_loop import detectors_command
from benchmarks.detectors import KEPT, bench
from benchmarks.detectors.air_unit import LightOffice
from benchmarks.detectors.bench import (
    WeekOutcome,
    claim_rows,
    fault_rows,
    rule_of,
    rule_rows,
    run_case,
    run_detectors_bench,
    targets,
)
from benchmarks.detectors.panel import FAULTS, KINDS, BuiltCase, PanelCase, built, clean, faulty
from benchmarks.detectors.rules import RULES, ControlledWeek
from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Observation, Period, PlantInfo, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.loop.probing import Probed, Probing
from thermoforce_mpc.model.late_sensor import LateSensor
from thermoforce_mpc.plants.embedded import PointEmulator
from thermoforce_mpc.plants.energyplus.engine import is_available
from thermoforce_mpc.plants.random_houses import draw_house
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.settings import StrictModel

NAMES = [rule.name for rule in RULES]


def week(number: int, cost: float, *claims: str, fault: str = "", **without: tuple[float, float]) -> WeekOutcome:
    of_rules = {name.replace("_", " "): pair for name, pair in without.items()}
    return WeekOutcome(
        PanelCase("embedded", number, 1, fault), cost, 0.5, 0, {name: ["said"] for name in claims}, of_rules
    )


def rows_of(*weeks: WeekOutcome, cost=(1.0,), K_h=(0.5,), idle=(0,)) -> list[dict]:
    """Rows of an earlier result."""
    return [
        {"week": one.case.in_words, "cost": then, "K_h": then_K_h, "not planned": then_idle}
        for one, then, then_K_h, then_idle in zip(weeks, cost, K_h, idle, strict=True)
    ]


def test_the_panel_takes_every_kind_in_turn_and_every_fault_is_for_a_rule():
    cases = clean(len(KINDS) + 1, seed=3)
    assert [case.kind for case in cases] == [*KINDS, next(iter(KINDS))]
    assert cases[-1].number == 1
    assert {rule_of(case.fault) for case in faulty(2, seed=3)} <= set(NAMES)
    assert len(faulty(2, seed=3)) == 2 * len(FAULTS) + 1, "a lag shows in three plants at least"
    assert faulty(0, seed=3) == []
    assert not any(case.fault for case in cases)


def test_faults_are_chosen_by_name():
    faults = {case.fault for case in faulty(2, seed=3, only=["guard", "zone"])}
    assert faults == {"guard", "zone sensor", "zone sensor, frozen"}
    with pytest.raises(InputError, match=r"fault 'windows': none begins so; there are: .*open window"):
        faulty(2, seed=3, only=["windows"])
    with pytest.raises(InputError, match="neither house-weeks of clean plants nor of faults"):
        run_detectors_bench(weeks=0, faults=0, engine=LocalEngine(1))


def test_chosen_faults_are_run_without_clean_weeks_where_none_are_asked_for(monkeypatch):
    ran = []
    monkeypatch.setattr(bench, "run_all", lambda function, cases, *given: ran.extend(cases) or [])
    run_detectors_bench(only=["guard"], faults=3, seed=5, engine=LocalEngine(1))
    assert ran == faulty(3, seed=5, only=["guard"])


def test_every_rule_has_a_fault():
    assert {rule_of(fault) for fault in FAULTS} == set(NAMES)


@pytest.mark.slow
def test_levels_of_actuators_that_share_a_machine_are_held_as_they_can_be_without_the_fixed_part():
    (rule,) = [rule for rule in RULES if rule.name == "fixed part"]
    rooms = built(PanelCase("house of rooms, no fixed part", 0, 3))
    assert rooms.plant.house.heat_pump.fixed_W == 0.0
    assert not rooms.fixed
    for layout, lowest in ((rooms.testcase.layout, 0.0), (Layout.single(), None)):
        assert rule.options(layout)["actuation"].get("lowest_level") == lowest
    lossy = built(PanelCase("generated house", 0, 3, "fixed part"))
    assert lossy.fixed
    assert lossy.plant.house.fixed_W > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "between_h"), [("air through windows", (6.75, 8.25)), ("open window", (66.75, 67.0))]
)
def test_windows_stand_open_as_the_fault_says(fault, between_h):
    """A house that is not heated cools, once they open, beside the same with closed ones."""
    aired, closed = (built(PanelCase("generated house", 0, 3, name)) for name in (fault, ""))
    begin_h = between_h[0] - 1.0

    def readings_C(place) -> np.ndarray:
        place.plant.reset(place.period.start_s + begin_h * HOUR_S, 0.0)
        return np.array([float(place.plant.advance((0.0,), 900.0).T_zone_C[0]) for _ in range(16)])

    away_K = readings_C(aired) - readings_C(closed)
    opens_h = begin_h + 0.25 * np.argmax(away_K < -0.05)
    assert between_h[0] <= opens_h <= between_h[1]
    assert away_K.min() < -0.5


def test_a_forgotten_window_counts_only_for_who_looks_for_it():
    place = built(PanelCase("generated house", 0, 3, "open window"))
    asked = []
    controller = SimpleNamespace(plan=lambda observation, state=None: asked.append(observation), step_s=900.0)
    n = 300
    record = Record(
        names=place.testcase.layout.names,
        time_s=900.0 * np.arange(n + 1),
        T_zone_C=(21.0 + 0.05 * np.sin(np.arange(n + 1)) - 1.5 * (np.arange(n + 1) == n))[None],
        T_out_C=np.full(n + 1, 2.0),
        solar_W_m2=np.zeros(n + 1),
        u=np.full((1, n), 0.4),
        heat_W=np.full((1, n), np.nan),
        power_W=np.full((1, n), np.nan),
    )
    ahead = place.plant.forecast(DAY_S, 900.0)
    for rule in ("", "open window"):
        acting = place.acts(controller, rule)
        assert acting.step_s == 900.0
        acting.plan(Observation(record, replace(ahead, time_s=ahead.time_s - ahead.time_s[0] + record.time_s[-1])))
    looks, does_not = asked
    assert np.isnan(looks.T_zone_C).all()
    assert looks.boundary.lower_C.max() < does_not.boundary.lower_C.max()
    assert np.isfinite(does_not.T_zone_C).all()


def test_a_solver_that_says_off_is_best_is_found_out_by_the_rules_levels():
    house = SimpleHouse()
    house.reset(10 * DAY_S, 2 * DAY_S)
    seen = Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))
    mpc = ThermoForceMPC(simple_model(), MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    (rule,) = [rule for rule in RULES if rule.name == "rule's levels"]
    for begun_s, acts in ((0.0, True), (-DAY_S, False)):
        period = Period("16", seen.time_s - 2.0 * DAY_S + begun_s)
        place = FAULTS["rule's levels"][1](BuiltCase(None, None, period), PanelCase("generated house", 0, 1))
        plan = place.acts(mpc, "").plan(seen)
        ran = ControlledWeek(mpc.model, SimpleNamespace(steps=[SimpleNamespace(time_s=seen.time_s, plan=plan)]))
        assert bool(rule.claims(ran)) is acts
    assert place.acts(house, "") is house, "what has no solver"


def test_a_rule_is_charged_for_its_false_claims_and_credited_for_its_faults():
    weeks = [
        week(0, 1.0, "watch", watch=(0.9, 0.5)),
        week(1, 1.0),
        week(2, 1.0, "watch", fault="watch", watch=(1.0, 10.5)),
    ]
    (row,) = [row for row in rule_rows(weeks) if row["rule"] == "watch"]
    assert row["with a false claim"] == 1
    assert row["in 100 house-weeks"] == 50.0
    assert row["they cost per m²"] == pytest.approx(0.1)
    assert (row["faults"], row["found"]) == (1, 1)
    assert row["saved there per m²"] == pytest.approx(0.26)  # 10 K·h at 0.026
    held = {target.name: target.holds for target in targets(weeks)}
    assert not held["watch: false claims in 100 house-weeks"]
    assert held["watch: saved less cost, a week"]
    assert not {t.name: t.holds for t in targets([])}["gate: false claims in 100 house-weeks"], "nothing was run"


@pytest.mark.parametrize(
    ("claimed", "of", "between", "goal"),
    [
        (0, 24, "0.0 and 14.2", "not shown"),
        (0, 400, "0.0 and 0.9", "met"),
        (1, 24, "0.1 and 21.1", "not shown"),
        (8, 100, "3.5 and 15.2", "missed"),
    ],
)
def test_a_rate_of_false_claims_is_told_with_what_it_may_be(claimed, of, between, goal):
    """Clopper and Pearson's intervals of 95 %, from tables."""
    weeks = [week(n, 1.0, *["gate"] * (n < claimed)) for n in range(of)]
    (row,) = [row for row in rule_rows(weeks) if row["rule"] == "gate"]
    assert (row["95 % between"], row["goal"]) == (between, goal)


def test_each_false_claim_and_each_fault_are_told_with_what_they_cost_and_saved():
    weeks = [
        week(0, 1.0, "watch", "units", watch=(0.9, 0.5)),
        week(1, 1.0),
        week(2, 1.0, "watch", fault="watch", watch=(1.0, 10.5)),
    ]
    watch, units = claim_rows(weeks)
    assert (watch["false claim"], watch["in"], watch["said"]) == ("watch", "embedded 0 of 1", "said")
    assert (watch["with it"], watch["without"]) == ("1.0000 / 0.50", "0.9000 / 0.50")
    assert watch["it cost per m²"] == pytest.approx(0.1)
    assert (units["false claim"], units["without"], units["it cost per m²"]) == ("units", "–", None)
    (fault,) = fault_rows(weeks)
    assert fault["fault"] == "embedded 2 of 1, watch"
    assert (fault["found"], fault["with it"], fault["without"]) == ("yes", "1.0000 / 0.50", "1.0000 / 10.50")
    assert fault["it saved per m²"] == pytest.approx(0.26)


@pytest.mark.parametrize(
    ("rule", "without", "fault", "claims"),
    [
        ("guard", (0.99, 1.5), "", []),  # a K·h colder for a hundredth less
        ("guard", (0.99, 0.4), "", ["guard"]),
        ("guard", (0.99, 1.5), "guard", ["guard"]),
        ("watch", (0.99, 1.5), "", ["watch"]),  # it believes in a fault where there is none
    ],
)
def test_a_guard_that_the_week_is_better_for_was_right_about_a_clean_plant(rule, without, fault, claims):
    """What it acts on was read, and on a clean plant that is so."""
    judged = bench.without_right_claims(week(0, 1.0, rule, fault=fault, **{rule: without}))
    assert list(judged.claims) == claims
    assert judged.without[rule] == without


@pytest.mark.parametrize(
    ("said_s", "true_s", "fault", "counts"),
    [(600.0, 0.0, "", True), (600.0, 310.0, "", False), (600.0, 290.0, "", True), (600.0, 900.0, "late sensor", True)],
)
def test_a_late_sensor_of_a_drawn_house_is_a_false_claim_where_it_is_less_than_half_as_late(
    said_s, true_s, fault, counts, monkeypatch
):
    late = LateSensor(said_s, 60.0, 0.999)
    model = SimpleNamespace(late_sensors=(None, late), cards=(SimpleNamespace(notes=(late.in_words(),)),))
    ran = ControlledWeek(model, SimpleNamespace(steps=[], kpis={"cost_tot": 1.0, "tdis_tot": 0.5}))
    asked = []
    monkeypatch.setattr(bench, "follow", lambda place, without: asked.append(without) or ran)
    place = BuiltCase(None, None, Period("16", 0.0), late_s=true_s)
    outcome = bench.house_week(PanelCase("generated house", 0, 1, fault), place)
    assert ("late sensor" in outcome.claims) is counts
    assert [rule.name for rule in asked if rule] == ["late sensor"] * counts, "and is run again without it"
    assert ControlledWeek("no model", ran.result).claimed_lag_s() == 0.0


def test_the_sensor_of_the_fault_is_late():
    late = built(PanelCase("generated house", 0, 3, "late sensor"))
    assert late.plant.house.lag_s == late.late_s == 900.0
    drawn = built(PanelCase("generated house", 0, 3))
    assert drawn.late_s == drawn.plant.house.lag_s


def test_the_late_sensor_is_in_a_house_without_a_heated_floor():
    assert draw_house(140930, 2100).emitter == "floor"
    assert built(PanelCase("generated house", 100, 140930, "late sensor")).plant.house == replace(
        draw_house(140930, 2200), lag_s=900.0, sun_bias_K=0.0
    )


def test_doors_that_stood_open_while_probing_are_shut_since():
    place = built(PanelCase("house of rooms", 0, 3, "watch, doors"))

    def spread_K(start_s: float) -> float:
        """How far apart rooms are after a day in which the first alone is heated."""
        place.plant.reset(start_s, 0.0)
        return float(np.ptp(place.plant.advance((1.0, 0.0, 0.0), DAY_S).T_zone_C))

    probed, controlled = (spread_K(place.period.start_s - days * DAY_S) for days in (1.0, 0.0))
    assert controlled > probed + 1.0


def test_a_moved_sensor_reads_more_for_a_day_and_late():
    moved, clean_one = (built(PanelCase("generated house", 0, 3, fault)) for fault in ("watch, sensor moved", ""))
    from_s = moved.period.start_s + 2 * DAY_S

    def readings_C(place) -> np.ndarray:
        place.plant.reset(from_s - HOUR_S, 0.0)
        seen = [place.plant.advance((0.0,), hours * HOUR_S) for hours in (1, 1.5, 6, 16.5, 1)]
        return np.array([float(one.T_zone_C[0]) for one in seen])

    away_K = readings_C(moved) - readings_C(clean_one)
    assert away_K[[0, -1]] == pytest.approx(0.0, abs=1e-9), "before and after"
    assert away_K[1] == pytest.approx(2.0 * (1.0 - np.exp(-1.0)), abs=0.3)
    assert away_K[3] == pytest.approx(2.0, abs=0.1)


def test_rules_can_be_turned_off_by_options_that_exist():
    from controllers.registry import controller_config
    from thermoforce_mpc.identification.config import IdentificationConfig
    from thermoforce_mpc.plants.testcases import load_testcase

    testcase = load_testcase("bestest_hydronic_heat_pump")
    for rule in RULES:
        if rule.controller:
            changed = controller_config("thermoforce_mpc", dict(rule.controller), testcase)
            assert isinstance(changed, StrictModel)
            assert changed != controller_config("thermoforce_mpc", {}, testcase), rule.name
        if rule.identification:
            assert IdentificationConfig.model_validate(rule.identification) != IdentificationConfig(), rule.name


def test_an_earlier_result_that_is_none_is_refused(tmp_path):
    (tmp_path / "other.json").write_text(json.dumps({"rows": [{"rule": "watch"}]}))
    with pytest.raises(InputError, match=r"other\.json: holds no weeks of bench detectors"):
        run_detectors_bench(weeks=1, engine=LocalEngine(1), against=tmp_path / "other.json")


def test_weeks_that_got_worse_than_in_an_earlier_result_are_told(tmp_path, monkeypatch):
    now = [week(0, 1.0), week(1, 1.004), week(2, 1.0), week(3, 0.9), replace(week(4, np.nan), failed="no plant")]
    earlier = rows_of(*now, cost=(1.0,) * 5, K_h=(0.5, 0.5, 0.3, 0.5, 0.5), idle=(0, 0, 0, 3, 0))
    (tmp_path / "earlier.json").write_text(json.dumps({"rows": earlier}))
    told = [asdict(replace(one, not_planned=2 if one.case.number == 0 else 0)) for one in now]
    ran = []
    monkeypatch.setattr(bench, "run_all", lambda function, cases, *given: ran.append(cases) or told)
    result = run_detectors_bench(engine=LocalEngine(1), against=tmp_path / "earlier.json")
    assert ran == [[one.case for one in now]], "the weeks of the earlier run, and no others where it has no faults"
    worse = {row["worse than before"]: row for row in result["rows"] if "worse than before" in row}
    assert list(worse) == [f"embedded {number} of 1" for number in (0, 1, 2, 4)]
    assert worse["embedded 0 of 1"]["steps not planned"] == "+2"
    assert worse["embedded 1 of 1"]["dearer"] == "+0.4%"
    assert worse["embedded 2 of 1"]["now"] == "1.0000 / 0.50"
    assert worse["embedded 4 of 1"]["now"] == "failed: no plant"
    assert result["rows"][-1] == {"weeks of both": 5, "worse": 4, "then": "4.0000 / 1.80", "now": "3.9040 / 2.00"}
    assert "revision" in result["environment"]


def run_against(kept: list[PanelCase], tmp_path, monkeypatch) -> list[PanelCase]:
    """The cases that the bench runs against an earlier result of the `kept` ones."""
    rows = [{"week": case.in_words, "cost": 1.0, "K_h": 0.0} for case in kept]
    (tmp_path / "earlier.json").write_text(json.dumps({"rows": rows}))
    ran = []

    def ran_all(function, cases, *given):
        ran.extend(cases)
        return [asdict(replace(week(0, 1.0), case=case)) for case in cases]

    monkeypatch.setattr(bench, "run_all", ran_all)
    run_detectors_bench(engine=LocalEngine(1), against=tmp_path / "earlier.json")
    return ran


def test_a_fault_that_is_new_in_the_panel_is_run_beside_the_weeks_of_an_earlier_result(tmp_path, monkeypatch):
    kept = [PanelCase("embedded", 3, 7), *faulty(2, seed=7)[:-4]]
    ran = run_against(kept, tmp_path, monkeypatch)
    assert ran[: len(kept)] == kept
    assert ran[len(kept) :] == faulty(1, seed=7)[-2:]


def test_plants_that_an_earlier_result_lacks_of_a_fault_are_run_too(tmp_path, monkeypatch):
    lacking = [PanelCase("generated house", number, 7, "late sensor") for number in (1, 2)]
    kept = [case for case in faulty(1, seed=7) if case not in lacking]
    assert run_against(kept, tmp_path, monkeypatch) == [*kept, *lacking]


def test_weeks_of_another_seed_are_no_weeks_to_compare(tmp_path):
    """A house of the same number drawn by another seed is another house."""
    (tmp_path / "earlier.json").write_text(json.dumps({"rows": rows_of(week(0, 1.0))}))
    with pytest.raises(
        InputError, match=r"has none of the weeks asked for, such as 'generated house 0 of 2'.*'embedded 0 of 1'"
    ):
        run_detectors_bench(weeks=1, faults=0, seed=2, engine=LocalEngine(1), against=tmp_path / "earlier.json")


@pytest.mark.parametrize("name", ["embedded 0", "castle 0 of 1", "embedded 0 of 1, sun on a sensor", "embedded x of 1"])
def test_a_week_that_the_panel_does_not_have_is_refused(name, tmp_path):
    (tmp_path / "earlier.json").write_text(json.dumps({"rows": [{"week": name, "cost": 1.0, "K_h": 0.0}]}))
    with pytest.raises(InputError, match=rf"earlier\.json: week '{name}': expected 'KIND NUMBER of SEED'"):
        run_detectors_bench(engine=LocalEngine(1), against=tmp_path / "earlier.json")


def test_a_week_is_found_again_by_its_words():
    for case in clean(2 * len(KINDS), seed=3) + faulty(2, seed=4):
        assert PanelCase.named(case.in_words) == case


def test_the_weeks_that_the_repository_keeps_are_of_this_panel_at_a_revision():
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    weeks = [PanelCase.named(row["week"]) for row in kept["rows"] if "week" in row]
    assert len({case.seed for case in weeks}) == 1
    assert {bool(case.fault) for case in weeks} == {True, False}
    assert len(kept["revision"]) == 40
    assert KEPT.stat().st_size < 60_000
    option = next(one for one in detectors_command.params if one.name == "against")
    assert option.flag_value == KEPT, "what --against alone compares with"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asleep_until_h", "seed", "hours"), [(0.0, 1, set()), (5.0, 2, {0, 1, 2, 3, 4})], ids=["awake", "asleep"]
)
def test_an_air_unit_in_winter_is_blocked_only_while_it_stands(asleep_until_h, seed, hours):
    """Cooling is asked for below its set-point then, and rightly nothing comes."""
    layout = Layout.single("both", -0.6)
    run = Probing(LightOffice(-4.0, 400.0, asleep_until_h), 20 * DAY_S, seed=seed, layout=layout)
    run.go_on(3.0)
    plant = PlantInfo("test", "light office", "", "", "1")
    ((heating, cooling),) = Probed(run.record, run.blocks, plant, "").blocked(layout)
    assert set(heating.hours) == hours
    assert not cooling.hours


def test_a_week_in_which_a_window_was_opened_claims_it_once():
    n, at = 384, 300
    T_C = 21.0 + 0.05 * np.sin(np.arange(n + 1)) - 1.2 * (np.arange(n + 1) > at)
    samples = [
        SimpleNamespace(
            start_s=900.0 * k, duration_s=900.0, T_zone_C=T_C[[k + 1]], T_out_C=2.0, u_measured=np.array([0.4])
        )
        for k in range(n)
    ]
    result = SimpleNamespace(steps=[SimpleNamespace(time_s=0.0, T_zone_C=T_C[[0]], samples=samples)])
    (rule,) = [rule for rule in RULES if rule.name == "open window"]
    (claim,) = rule.claims(ControlledWeek(SimpleNamespace(layout=Layout.single()), result))
    assert claim.startswith("day 3.12: zone fell 1.")
    assert rule.claims(ControlledWeek("no model", result)) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["embedded", "bestest_air"])
def test_no_two_weeks_of_a_plant_are_alike(kind, monkeypatch):
    """By points of a test case in other years, on whichever day that year's windows begin."""
    monkeypatch.setattr(PointEmulator, "period", lambda plant, name: Period(name, 16 * DAY_S))
    places = [built(PanelCase(kind, number, 5)) for number in (1, 5, 9)]
    begun = {(place.period.start_s, place.plant.reset(place.period.start_s, 0.0).T_out_C) for place in places}
    assert len(begun) == 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["EnergyPlus zone", "FMU"])
def test_plants_of_other_programs_have_a_week_of_their_own_each(kind):
    if kind == "EnergyPlus zone" and not is_available():
        pytest.skip("EnergyPlus (extra [energyplus]) is not installed")
    begun = set()
    for number in range(6):
        place = built(PanelCase(kind, number, 5))
        with closing(place.plant):
            begun.add((place.testcase.name, place.period.start_s))
    assert len(begun) == 6


def test_the_plant_of_a_week_is_closed_also_where_the_week_fails(monkeypatch):
    closed = []
    plant = SimpleNamespace(close=lambda: closed.append(1))
    place = BuiltCase(plant, load_testcase("bestest_hydronic_heat_pump"), Period("16", 16 * DAY_S))
    monkeypatch.setitem(KINDS, "embedded", lambda case: place)
    assert run_case(PanelCase("embedded", 0, 1))["failed"]
    assert closed
