"""What travels in a report's page, read back without a browser."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from report_page import body_of, data_of, numbers
from report_runs import HOSTILE, HOSTILE_NAMES, N, layout_of, planned, report_of, two_weeks
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from two_houses import TWO

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Layout, Names, Period, PlanStatus
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.report.html import kpi_rows
from thermoforce_mpc.report.page import packed, smooth
from thermoforce_mpc.report.panels import MOST_STEPS, course_of, decisions_json, other_levels_json, plans_json

AREA_M2 = 100.0


@pytest.fixture(scope="module")
def result():
    return planned()


def test_arrays_come_back_with_their_holes_and_within_their_resolution():
    values = np.array([20.0, np.nan, 21.2345, np.inf, -3.0])
    found = numbers(packed(values, coarsest=0.01))
    np.testing.assert_allclose(found, np.where(np.isfinite(values), values, np.nan), atol=0.5 * 24.3 / 65534)
    assert packed(values, coarsest=0.01)["as"] == "int16"
    # A sensor that once read nonsense does not cost the other readings their digits.
    wild = packed(np.array([20.0, 20.01, 1e9]), coarsest=0.01)
    np.testing.assert_allclose(numbers(wild), [20.0, 20.01, 1e9], rtol=1e-6)
    np.testing.assert_array_equal(numbers(packed(np.full(3, 21.0), 0.01)), 21.0)
    assert np.isnan(numbers(packed(np.full(3, np.nan), 0.01))).all()
    levels = np.array([-1.0, np.nan, 0.33, 1.0])
    np.testing.assert_allclose(numbers(packed(levels, 0.01, bits=8)), levels, atol=1 / 254)


def test_smooth_courses_come_back_from_their_changes():
    random = np.random.default_rng(0)
    courses = 20.0 + 0.1 * random.normal(size=(5, 96)).cumsum(axis=1)
    courses[2] = np.nan
    told = smooth(courses, finest=0.01, coarsest=0.05)
    assert told["as"] == "changes"
    np.testing.assert_allclose(numbers(told), courses.ravel(), atol=0.0051)
    courses[1, 7] += 3.0
    wider = smooth(courses, finest=0.01, coarsest=0.05)
    np.testing.assert_allclose(numbers(wider), courses.ravel(), atol=0.5 * 3.5 / 126)
    courses[1, 7] += 30.0
    np.testing.assert_allclose(numbers(smooth(courses, finest=0.01, coarsest=0.05)), courses.ravel(), atol=0.0051)
    courses[3, 5] = np.nan
    np.testing.assert_allclose(numbers(smooth(courses, finest=0.01, coarsest=0.05)), courses.ravel(), atol=0.0051)


def test_the_page_holds_what_was_measured_and_planned(result, tmp_path):
    data = data_of(report_of(result, {"baseline": result}, tmp_path))
    assert data["names"] == {"zones": list(TWO.zones), "actuators": list(TWO.actuators), "machines": list(TWO.machines)}
    assert data["serves"] == [[1], [0]]
    measured = np.array([sample.T_zone_C for sample in result.samples]).T
    for z in range(2):
        np.testing.assert_allclose(numbers(data["own"]["T_zone_C"][z]), measured[z], atol=0.002)
        np.testing.assert_allclose(numbers(data["baselines"][0]["T_zone_C"][z]), measured[z], atol=0.002)
    plans = data["plans"]
    assert (plans["every"], plans["n"], len(numbers(plans["time_s"]))) == (1, N, 48)
    for z in range(2):
        free = np.array([step.plan.T_free_C[z] for step in result.steps]).ravel()
        np.testing.assert_allclose(numbers(plans["T_free_C"][z]), free, atol=0.0051)
    assert [data["steps"]["statuses"][code] for code in data["steps"]["status"]] == ["solved"] * 48
    assert {data["steps"]["texts"][i] for i in data["steps"]["why"]} == {"as ever"}


def test_cost_and_discomfort_so_far_are_sums_over_the_blocks():
    from controllers.rules.thermostat import Thermostat

    house = SimpleHouse()
    run = run_closed_loop(house, Thermostat(), house.period("x"))
    course = course_of(run, Layout.single(), AREA_M2, most=1000)
    hours = course.duration_s / HOUR_S
    np.testing.assert_allclose(course.cost[-1] * AREA_M2, run.kpis["cost_tot"])
    below = np.maximum(course.lower_C[0] - course.T_zone_C[0], 0.0)
    before = np.maximum(course.lower_C[0] - np.append(run.start.T_zone_C, course.T_zone_C[0, :-1]), 0.0)
    np.testing.assert_allclose(course.discomfort_Kh[0, -1], (0.5 * (below + before) * hours).sum())
    assert (np.diff(course.cost) >= 0).all()


def test_the_page_says_where_cost_so_far_does_not_end_at_the_kpi(tmp_path):
    from controllers.rules.thermostat import Thermostat

    house = SimpleHouse()
    run = run_closed_loop(house, Thermostat(), house.period("x"))
    cost = run.kpis["cost_tot"] / AREA_M2
    own, dearer = (replace(run, kpis={"ener_tot": 1.0, "cost_tot": k * cost}) for k in (1, 2))
    told = body_of(report_of(own, {}, tmp_path, Layout.single()))
    assert "They do not end at the KPIs" not in told
    told = body_of(report_of(own, {"gas": dearer}, tmp_path, Layout.single()))
    assert f"cost of gas: {cost:.4g}, KPI {2 * cost:.4g}" in told
    assert "cost of thermostat" not in told
    # A generated house counts discomfort by its temperature, its sensor is late: the blocks alone are not the reason.
    assert "which a sensor with noise, a lag or sun on it misreads" in told


def test_figures_are_rounded_to_what_is_meant():
    rows = kpi_rows({"a": {"cost_tot": 0.6, "tdis_tot": 0.00172}, "b": {"cost_tot": 0.91034, "tdis_tot": 11.24}}, "EUR")
    assert [row["texts"] for row in rows] == [["0.600", "0.910"], ["0.00", "11.24"]]


def test_a_peak_is_that_of_its_carrier(result, tmp_path):
    kpis = {**result.kpis, "pele_tot": 0.0046, "pgas_tot": 0.0925}
    body = body_of(report_of(replace(result, kpis=kpis), {}, tmp_path))
    for label, value in (("Peak of electricity", "0.0046"), ("Peak of gas", "0.0925")):
        assert value in body.split(label)[1].split("</tr>")[0]
    assert "Peak power" not in body
    assert "Peak of district heat" not in body


def test_the_planned_cost_is_that_of_the_planned_power(result):
    plans = plans_json(result, layout_of(), AREA_M2)
    price = result.steps[0].boundary.price_per_kWh[:, :N].sum(axis=0)
    np.testing.assert_allclose(numbers(plans["cost"])[:N], np.cumsum(price) / AREA_M2, rtol=1e-3)


def test_long_runs_are_averaged_without_losing_energy_or_time(result):
    whole = course_of(result, layout_of(), AREA_M2, most=1000)
    fewer = course_of(result, layout_of(), AREA_M2, most=20)
    assert fewer.start_s.size == 16
    assert fewer.averaged == 3
    assert fewer.duration_s.sum() == whole.duration_s.sum()
    np.testing.assert_allclose((fewer.power_W[0] * fewer.duration_s).sum(), (whole.power_W[0] * whole.duration_s).sum())
    assert fewer.cost[-1] == whole.cost[-1]


def test_set_points_given_to_the_plants_own_loops_are_told(result, tmp_path):
    block = Block((0.5, 0.25), HOUR_S, ((20.0, 26.0), None))
    steps = [replace(step, plan=replace(step.plan, blocks=(block,))) for step in result.steps]
    steps[5] = replace(steps[5], refused="refused a level of 7")
    heating, cooling = data_of(report_of(replace(result, steps=steps), {}, tmp_path))["own"]["band_C"]
    given = np.arange(48) != 5
    np.testing.assert_array_equal(numbers(heating[0]), np.where(given, 20.0, np.nan))
    np.testing.assert_array_equal(numbers(cooling[0]), np.where(given, 26.0, np.nan))
    assert np.isnan(numbers(heating[1])).all()
    assert data_of(report_of(result, {}, tmp_path))["own"]["band_C"] is None


def test_cost_with_a_second_carrier_ends_at_the_plants_bill(result, tmp_path):
    """The meter of a machine adds gas and the fan's electricity; what each was, only the plant's bill knows."""

    def gas(boundary):
        return replace(boundary, heating_price_per_kWh=0.3 * boundary.price_per_kWh)

    def cost_of(run):
        page = report_of(run, {}, tmp_path)
        return numbers(data_of(page)["own"]["cost"]), "ends at the plant's own bill" in page.replace(
            "end at", "ends at"
        )

    steps = [replace(step, boundary=gas(step.boundary)) for step in result.steps]
    billed = replace(result, steps=steps, kpis=result.kpis | {"cost_tot": 0.5})
    cost, told = cost_of(billed)
    assert told
    assert cost[-1] == pytest.approx(0.5, rel=1e-3)
    one, told = cost_of(replace(result, kpis=result.kpis | {"cost_tot": 0.5}))
    assert not told
    np.testing.assert_allclose(cost / cost[-1], one / one[-1], atol=1e-3)


def test_decisions_of_long_runs_are_thinned(result):
    steps = [step for step in result.steps for _ in range(MOST_STEPS // 20)]
    told = decisions_json(replace(result, steps=steps))
    assert told["every"] == 4
    np.testing.assert_array_equal(numbers(told["time_s"]), [step.time_s for step in steps[::4]])
    np.testing.assert_allclose(
        numbers(told["T_forced_K"][1]), [step.plan.T_forced_K[1, 0] for step in steps[::4]], atol=0.002
    )
    assert {told["texts"][i] for i in told["solver"]} == {"optimal"}


def test_stretches_of_one_reason_are_one_row_and_the_page_stays_readable_with_many(result, tmp_path):
    def with_notes(notes):
        steps = [replace(step, notes=note) for step, note in zip(result.steps, notes, strict=True)]
        return report_of(replace(result, steps=steps), {}, tmp_path)

    page = with_notes([("the sensor of bath is silent",) if 10 <= k < 20 else () for k in range(48)])
    assert body_of(page).count("the sensor of bath is silent") == 1
    assert '<td class="text">day 10 10:00</td><td>10</td>' in page


@pytest.mark.slow
@pytest.mark.parametrize(("zones", "every"), [(1, 1), (5, 4), (20, 16)])
def test_two_weeks_of_plans_are_at_most_five_megabytes_and_the_page_says_what_is_left_out(zones, every, tmp_path):
    each = [tuple(f"{kind} {i}" for i in range(zones)) for kind in ("zone", "valve")]
    names = Names(each[0], each[1], ("heat pump",))
    run = two_weeks(names)
    layout = Layout(
        names, (1,) * zones, tuple(range(zones)), (0,) * zones, (0.0,) * zones, (1 / zones,) * zones, (20.0,) * zones
    )
    page = report_of(run, {"native": run, "thermostat": run}, tmp_path, layout)
    assert len(page.encode()) < 5_000_000
    data = data_of(page)
    plans = data["plans"]
    assert plans["every"] == every
    assert len(numbers(plans["T_free_C"][0])) == len(run.steps) // every * 192
    assert (f"Of the plans one in {every} is here" in page) == (every > 1)
    assert (f"Courses are means over {data['own']['averaged']} blocks" in page) == (zones == 20)


def test_names_and_reasons_stay_text_in_the_page(tmp_path):
    run = planned(HOSTILE_NAMES, f"because {HOSTILE}")
    fallen = replace(run.steps[0].plan, status=PlanStatus.SHIFTED)
    run = replace(run, steps=[replace(run.steps[0], plan=fallen), *run.steps[1:]], controller=HOSTILE)
    page = report_of(run, {HOSTILE: run}, tmp_path, layout_of(HOSTILE_NAMES))
    assert "<script>alert" not in page
    assert "<img" not in page
    data = data_of(page)
    assert data["names"]["zones"][0] == HOSTILE_NAMES.zones[0]
    assert f"because {HOSTILE}" in data["steps"]["texts"]


def test_what_is_not_a_number_is_null_or_a_hole(result, tmp_path):
    sample = replace(
        result.steps[0].samples[0], T_zone_C=np.array([np.nan, np.inf]), power_W=np.array([np.nan, -np.inf])
    )
    run = replace(result, steps=[replace(result.steps[0], samples=(sample,)), *result.steps[1:]])
    run = replace(run, kpis=run.kpis | {"cost_tot": float("nan")})
    data = data_of(report_of(run, {}, tmp_path))
    assert np.isnan(numbers(data["own"]["T_zone_C"][1])[0])
    assert np.isfinite(numbers(data["own"]["cost"])).all()


def test_a_machine_that_is_not_metered_does_not_hide_what_the_others_cost(result):
    def cost(*metered: float) -> float:
        steps = [
            replace(step, samples=tuple(replace(s, power_W=s.power_W * np.array(metered)) for s in step.samples))
            for step in result.steps
        ]
        return float(course_of(replace(result, steps=steps), layout_of(), 100.0, 1000).cost[-1])

    assert cost(1.0, np.nan) == pytest.approx(cost(1.0, 0.0))
    assert 0.0 < cost(1.0, 0.0) < cost(1.0, 1.0)


def test_the_page_says_how_far_it_rounds(result, tmp_path):
    """A plan that moves by 4 K in a step does not fit into 0.01 K and 8 bits."""
    assert "rounded to 0.01 K" in report_of(result, {}, tmp_path)
    step = result.steps[3]
    jump = step.plan.T_forced_K + 4.0 * (np.arange(step.plan.u.shape[-1]) > 2)
    fast = replace(step, plan=replace(step.plan, T_forced_K=jump))
    page = report_of(replace(result, steps=[*result.steps[:3], fast, *result.steps[4:]]), {}, tmp_path)
    assert "rounded to 0.032 K" in page


def test_other_levels_and_step_responses_are_those_of_the_model(tmp_path):
    house, model = SimpleHouse(), simple_model()
    config = MPCConfig.model_validate({"step_s": None, "horizon_h": 6})
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    run = run_closed_loop(house, mpc, house.period("x"))
    data = data_of(report_of(run, {}, tmp_path, Layout.single(), model=model))
    other = data["other_levels"]
    assert other["levels"] == ["off", "half", "full"]
    np.testing.assert_allclose(numbers(other["time_s"]) - run.start.time_s, np.arange(24, 25, 6) * HOUR_S)
    off, full = (numbers(other["T_other_C"][k][0]) for k in (0, 2))
    second_day = [step.samples for step in run.steps[24:]]
    applied = np.array(
        [np.average([s.u_measured[0] for s in of], weights=[s.duration_s for s in of]) for of in second_day]
    )
    measured = np.array([of[-1].T_zone_C[0] for of in second_day])
    impulse = model.operator.pairs[0][0].impulse(24)
    np.testing.assert_allclose(full - off, np.cumsum(impulse), atol=0.01)
    np.testing.assert_allclose(off - measured, -np.convolve(applied, impulse)[:24], atol=0.01)
    ((answer,),) = data["answers"]
    np.testing.assert_allclose(answer["K"][1:25], np.cumsum(impulse), atol=1e-3)


@pytest.mark.slow
def test_other_levels_are_not_asked_about_where_a_level_was_not_measured():
    house, model = SimpleHouse(), simple_model()
    config = MPCConfig.model_validate({"step_s": None, "horizon_h": 6})
    mpc = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    run = run_closed_loop(house, mpc, Period("x", 10 * DAY_S, scored_s=3 * DAY_S, warmup_s=2 * DAY_S))
    unknown = tuple(replace(sample, u_measured=np.array([np.nan])) for sample in run.steps[30].samples)
    run = replace(run, steps=[*run.steps[:30], replace(run.steps[30], samples=unknown), *run.steps[31:]])
    other = other_levels_json(run, model, Layout.single())
    assert ((numbers(other["time_s"]) - run.start.time_s) / HOUR_S).tolist() == [36.0, 42.0, 48.0]


def test_rules_have_no_plans_to_show(tmp_path):
    from controllers.rules.thermostat import Thermostat

    house = SimpleHouse()
    page = report_of(run_closed_loop(house, Thermostat(), house.period("x")), {}, tmp_path, Layout.single())
    data = data_of(page)
    assert data["plans"] is None
    assert data["other_levels"] is None
    assert "plan-slider" not in body_of(page)
    assert "free and forced part" not in body_of(page)


def test_the_library_goes_with_its_licence(result, tmp_path):
    page = report_of(result, {}, tmp_path)
    package = resources.files("thermoforce_mpc.report")
    licence = (package / "vendor" / "uplot" / "LICENSE").read_text()
    assert "Leon Sorokin" in licence
    assert "Leon Sorokin" in page
    assert "default-src 'none'" in page


def test_what_is_cheap_because_it_is_cold_is_not_marked_as_best():
    everyone = {
        "planner": {"cost_tot": 0.6, "tdis_tot": 0.1, "pele_tot": 0.02},
        "asleep": {"cost_tot": 0.1, "tdis_tot": 141.0, "pele_tot": 0.001},
        "thermostat": {"cost_tot": 0.7, "tdis_tot": 0.0},
    }
    best = {row["label"]: row["best"] for row in kpi_rows(everyone, "EUR")}
    assert best == {"Cost": 0.6, "Discomfort": 0.0, "Peak of electricity (15 min)": 0.02}
