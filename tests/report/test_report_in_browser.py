"""What a report draws and how it answers, in a headless Chromium. Skips where the machine has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from browser import Seen, chromium
from report_runs import HOSTILE_NAMES, N, layout_of, planned, report_of
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.data import HOUR_S, Block, Layout, Plan, PlanStatus
from thermoforce_mpc.loop.closed_loop import run_closed_loop

# Whether the canvas of a chart has a colour within two pixels of a point of one of its scales.
NEAR = """([t, value, name, scale]) => {
  const plot = CHART.plot, ctx = plot.ctx;
  const mark = document.createElement("canvas").getContext("2d");
  mark.fillStyle = Theme.colour(name); mark.fillRect(0, 0, 1, 1);
  const wanted = mark.getImageData(0, 0, 1, 1).data;
  const x = Math.round(plot.valToPos(t, "x", true)), y = Math.round(plot.valToPos(value, scale || "y", true));
  const found = ctx.getImageData(x - 2, y - 2, 5, 5).data;
  for (let i = 0; i < found.length; i += 4) {
    if ([0, 1, 2].every((k) => Math.abs(found[i + k] - wanted[k]) < 24) && found[i + 3] > 150) return true;
  }
  return false;
}"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def one_zone(tmp_path_factory):
    """A run of the MPC on the simple house, with a thermostat beside it: the run and its page."""
    folder, house, model = tmp_path_factory.mktemp("one"), SimpleHouse(), simple_model()
    mpc = ThermoForceMPC(
        model, MPCConfig.model_validate({"step_s": None, "horizon_h": 12}), free_response=OutdoorResponse()
    )
    run = run_closed_loop(house, mpc, house.period("x"))
    other = SimpleHouse()
    beside = run_closed_loop(other, Thermostat(), other.period("x"))
    report_of(run, {"thermostat": beside}, folder, Layout.single(), model=model)
    return run, folder / "report.html"


@pytest.fixture(scope="module")
def opened(browser, one_zone):
    found = Seen(browser, one_zone[1])
    yield found
    found.close()


@pytest.fixture
def seen(opened):
    """The page of `one_zone`, all of it in view; loaded once, since that takes the longest."""
    opened.page.mouse.move(0, 0)
    opened.ask("Report.course.group.zoom()")
    drawn(opened)
    yield opened
    assert opened.wrong == []


def near(seen, chart, t, value, colour, scale="y"):
    return seen.page.evaluate(NEAR.replace("CHART", chart), [float(t), float(value), colour, scale])


def series(seen, chart, key, which="y"):
    return np.array(seen.ask(f"Array.from({chart}.parts.get('{key}').{which})"), dtype=float)


def move(seen, slider, to):
    seen.page.locator(slider).fill(str(to))
    drawn(seen)


def drawn(seen):
    """Wait for what the next frames draw."""
    seen.ask("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")


@pytest.mark.slow
def test_the_course_is_drawn_where_it_was_measured(seen, one_zone):
    run, _ = one_zone
    samples = run.samples
    for sample in samples[10:90:17]:
        t, T = sample.start_s + sample.duration_s, sample.T_zone_C[0]
        assert near(seen, "Report.course.temperatures[0]", t, T, "--measured"), (t, T)
        assert not near(seen, "Report.course.temperatures[0]", t, T + 0.6, "--measured")
    plan = run.steps[20].plan
    at = run.steps[20].time_s + HOUR_S
    assert near(seen, "Report.course.parts[0]", at, plan.T_free_C[0, 0], "--free")
    assert near(seen, "Report.course.parts[0]", at, plan.T_forced_K[0, 0], "--forced", "r")
    last = run.samples[-1]
    end = last.start_s + last.duration_s
    cost = series(seen, "Report.cumulative.cost", "run-0")
    assert near(seen, "Report.cumulative.cost", end - 60, cost[-1], "--planned")
    assert cost[-1] == pytest.approx(run.kpis["cost_tot"] / 100.0, rel=1e-3)


def test_every_chart_of_the_page_has_something_in_it(seen):
    blank = seen.ask("""Chart.all.filter((chart) => {
      const { ctx, bbox } = chart.plot;
      return !ctx.getImageData(bbox.left, bbox.top, bbox.width, bbox.height).data.some((value) => value > 0);
    }).length""")
    assert blank == 0
    assert seen.ask("Chart.all.length") == 3 + 3 + 4 + 2 + 1 + 2
    assert seen.page.locator("#answers svg path.answer-line").count() == 1


@pytest.mark.parametrize("value", [-3.8, 0.0, 0.3])
def test_what_does_not_change_has_an_axis_with_different_labels(seen, value):
    low, high = seen.ask(f"Chart.all.find((chart) => chart.spec.unit === 'outdoor, °C').height({value}, {value})")
    assert low < value < high
    assert high - low > 0.1 * (abs(value) or 1.0)


def test_every_axis_has_two_labels_and_every_dash_its_own_in_the_legend(seen):
    labels = seen.ask("""Chart.all.filter((chart) => chart.spec.unit).map((chart) =>
      chart.plot.axes.filter((axis) => axis.show).map((axis) => axis._values.filter(Boolean).length))""")
    assert len(labels) > 5
    assert min(n for chart in labels for n in chart) >= 2
    dashes = seen.ask("""[...document.querySelectorAll("#cumulative-legend line")]
      .map((line) => line.getAttribute("stroke-dasharray"))""")
    assert len(dashes) == len(set(dashes)) == 2


def test_the_slider_shows_the_plan_made_then_beside_what_came(seen, one_zone):
    run, _ = one_zone
    told = []
    for p in (5, 44):
        move(seen, "#plan-slider", p)
        step = run.steps[p]
        planned_C = series(seen, "Report.plans.temperatures[0]", "plan")
        np.testing.assert_allclose(planned_C[1:], step.plan.T_zone_C[0], atol=0.01)
        assert planned_C[0] == pytest.approx(step.T_zone_C[0], abs=0.01)
        np.testing.assert_allclose(series(seen, "Report.plans.levels[0]", "u-plan-0")[:-1], step.plan.u[0], atol=0.005)
        price = step.boundary.price_per_kWh[0, :12]
        spent = np.cumsum(step.plan.power_W[0] * price) / 1e3 / 100.0
        np.testing.assert_allclose(series(seen, "Report.plans.costs", "cost-plan")[1:], spent, atol=1e-4)
        assert seen.page.locator("#plan-why").inner_text() == step.plan.why
        assert seen.page.locator("#plan-status").inner_text() == step.plan.status
        told.append(seen.page.locator("#plan-instant").inner_text())
    assert told == ["day 10 05:00 (11 Jan)", "day 11 20:00 (12 Jan)"]
    # Beyond the end of the run there is nothing measured in front of the plan.
    chart = "Report.plans.temperatures[0]"
    for hours in (6, 8, 11):
        assert near(seen, chart, step.time_s + hours * HOUR_S, step.plan.T_zone_C[0, hours - 1], "--planned")
    assert not near(seen, chart, step.time_s + 8 * HOUR_S, step.plan.T_zone_C[0, 7] + 1.0, "--planned")
    seen.page.locator("#plan-on").click()
    assert seen.page.locator("#plan-slider").input_value() == "45"
    # A click into the course of the run chooses the plan in force there.
    place = seen.page.locator("#course .u-over").first
    width = place.bounding_box()["width"]
    place.click(position={"x": 0.5 * width + 3, "y": 40})
    assert seen.page.locator("#plan-slider").input_value() == "24"


def test_the_page_of_a_real_building_has_its_dates_also_after_the_clock_went_forward(browser, one_zone, tmp_path):
    """Day 10 is 29 March, which has 23 hours; no sun is mapped, and none has an axis."""
    run, _ = one_zone
    report_of(run, {}, tmp_path, Layout.single(), origin=pd.Timestamp("2026-03-19", tz="Europe/Berlin"))
    page = Seen(browser, tmp_path / "report.html")
    told = {hours: page.ask(f"Page.instant({run.steps[0].time_s + hours * HOUR_S})") for hours in (1, 5, 23, 29)}
    assert told == {1: "Sun 29 Mar 01:00", 5: "Sun 29 Mar 06:00", 23: "Mon 30 Mar 00:00", 29: "Mon 30 Mar 06:00"}
    labels = page.ask("Report.course.temperatures[0].plot.axes[0]._values.filter(Boolean)")
    assert [label for label in labels if ":" not in label] == ["29 Mar", "30 Mar", "31 Mar"]
    assert page.ask("Chart.all.filter((chart) => chart.spec.unit === 'outdoor, °C' && chart.spec.right).length") == 0
    assert page.wrong == []
    page.close()


@pytest.mark.slow
def test_playing_goes_on_from_plan_to_plan_until_stopped(seen):
    move(seen, "#plan-slider", 3)
    seen.page.locator("#plan-play").click()
    for _ in range(1000):  # the page's own policy refuses what waits inside the page
        if int(seen.page.locator("#plan-slider").input_value()) >= 5:
            break
        seen.page.wait_for_timeout(100)
    else:
        pytest.fail("it does not play")
    seen.page.locator("#plan-play").click()
    at = seen.page.locator("#plan-slider").input_value()
    seen.page.wait_for_timeout(450)
    assert seen.page.locator("#plan-slider").input_value() == at


def test_other_levels_follow_their_slider(seen):
    first = seen.page.locator("#other-instant").inner_text()
    full = series(seen, "Report.others.charts[0]", "other-full")
    off = series(seen, "Report.others.charts[0]", "other-off")
    assert full[0] == off[0]
    assert (full[1:] > off[1:]).all()
    assert "day 11 00:00" in first


def test_a_legend_hides_and_shows_a_line(seen, one_zone):
    run, _ = one_zone
    sample = run.samples[40]
    at = ("Report.course.temperatures[0]", sample.start_s + sample.duration_s, sample.T_zone_C[0], "--measured")
    key = seen.page.locator("#course-legend [data-key=measured]")
    assert near(seen, *at)
    key.click()
    assert key.get_attribute("aria-pressed") == "false"
    assert not near(seen, *at)
    key.click()
    assert near(seen, *at)


def test_dragging_zooms_all_charts_of_the_run_and_a_double_click_shows_all(seen):
    span = seen.ask("Report.course.group.span")
    place = seen.page.locator("#course .u-over").first
    place.scroll_into_view_if_needed()  # from wherever the page was left
    box = place.bounding_box()
    seen.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    seen.page.mouse.down()
    seen.page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60, steps=4)
    seen.page.mouse.up()
    quarter = [span[0] + share * (span[1] - span[0]) for share in (0.25, 0.5)]
    shown = "Report.course.group.charts.map((chart) => [chart.plot.scales.x.min, chart.plot.scales.x.max])"
    for least, most in seen.ask(shown):
        assert [least, most] == pytest.approx(quarter, abs=1200)
    place.dblclick(position={"x": 30, "y": 40})
    for limits in seen.ask(shown):
        assert limits == pytest.approx(span)
    seen.page.locator("#course-tools button", has_text="day").click()
    for least, most in seen.ask(shown):
        assert most - least == pytest.approx(86400)


def test_pointing_tells_values_with_units_and_why(seen, one_zone):
    run, _ = one_zone
    place = seen.page.locator("#course .u-over").first
    box = place.bounding_box()
    t = run.steps[20].time_s + 1800
    share = (t - run.steps[0].time_s) / (48 * HOUR_S)
    place.hover(position={"x": share * box["width"], "y": 50})
    tip = seen.page.locator(".tip")
    assert tip.is_visible()
    assert "°C" in tip.inner_text()
    assert "measured" in tip.inner_text()
    assert run.steps[20].plan.why in tip.inner_text()
    assert "day 10 20:" in tip.inner_text()
    seen.page.locator("h1").hover()
    assert not tip.is_visible()


@pytest.mark.slow
def test_light_and_dark_by_system_and_by_switch(browser, one_zone):
    ground = "getComputedStyle(document.body).backgroundColor"
    dark = Seen(browser, one_zone[1], color_scheme="dark")
    assert dark.ask(ground) == "rgb(20, 24, 29)"
    sample = one_zone[0].samples[40]
    at = ("Report.course.temperatures[0]", sample.start_s + sample.duration_s, sample.T_zone_C[0])
    assert dark.ask("Theme.colour('--measured')") == "#f2f4f7"
    assert near(dark, *at, "--measured")
    dark.page.locator("#theme button", has_text="light").click()
    assert dark.ask(ground) == "rgb(255, 255, 255)"
    assert dark.ask("Theme.colour('--measured')") == "#1b1f24"
    assert near(dark, *at, "--measured"), "charts are drawn again"
    dark.close()


@pytest.mark.slow
def test_a_phone_needs_no_sideways_scrolling(browser, one_zone):
    phone = Seen(browser, one_zone[1], width=390, device_scale_factor=2)
    assert phone.ask("document.documentElement.scrollWidth") == 390
    widths = phone.ask("Chart.all.map((chart) => chart.plot.width)")
    assert max(widths) <= 390
    phone.close()


@pytest.mark.slow
def test_print_is_light_fits_the_paper_and_leaves_the_controls_out(browser, one_zone):
    dark = Seen(browser, one_zone[1], color_scheme="dark")
    assert dark.page.pdf(format="A4", print_background=True)[:5] == b"%PDF-"
    dark.ask("dispatchEvent(new Event('beforeprint'))")
    assert dark.ask("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    dark.ask("dispatchEvent(new Event('afterprint'))")
    assert dark.ask("getComputedStyle(document.body).backgroundColor") == "rgb(20, 24, 29)"
    dark.page.emulate_media(media="print")
    assert not dark.page.locator("nav").is_visible()
    assert not dark.page.locator("#plan-play").is_visible()
    dark.close()


@pytest.fixture
def zones(browser, tmp_path):
    """Two zones whose names are markup, with a step that fell back: the run and its page."""
    run = planned(HOSTILE_NAMES, "because <b>of</b> </script><script>alert(3)</script>")
    fallen = replace(run.steps[7].plan, status=PlanStatus.SHIFTED, acting=(PlanStatus.SHIFTED, PlanStatus.NATIVE))
    rule = Plan(run.steps[9].plan.blocks, PlanStatus.THERMOSTAT, "no solver", names=HOSTILE_NAMES)
    steps = [*run.steps[:7], replace(run.steps[7], plan=fallen), run.steps[8], replace(run.steps[9], plan=rule)]
    steps += run.steps[10:]
    loops = (Block((0.5, 0.25), HOUR_S, (None, (15.0, 60.0))),)
    steps = [replace(step, plan=replace(step.plan, blocks=loops)) for step in steps]
    run = replace(run, steps=steps)
    report_of(run, {"<img src=x onerror=alert(4)>": run}, tmp_path, layout_of(HOSTILE_NAMES))
    found = Seen(browser, tmp_path / "report.html")
    yield run, found
    found.close()


@pytest.mark.slow
def test_zones_are_rows_and_actuators_have_lanes_of_who_acted(zones):
    run, seen = zones
    assert seen.page.locator("#course .zone-row").count() == 2
    assert seen.ask("Report.status.rungs") == ["solved", "shifted", "thermostat", "native"]
    titles = seen.page.locator("#status figcaption").all_inner_texts()
    assert titles == list(HOSTILE_NAMES.actuators)
    t = run.steps[7].time_s + 0.5 * HOUR_S
    # Lanes from top to bottom: solved, shifted, thermostat, native.
    assert near(seen, "Report.status.lanes[0]", t, 2, "--status-shifted")
    assert near(seen, "Report.status.lanes[1]", t, 0, "--status-native")
    assert near(seen, "Report.status.lanes[1]", t + HOUR_S, 3, "--status-solved")
    assert not near(seen, "Report.status.lanes[1]", t + HOUR_S, 0, "--status-native")


@pytest.mark.slow
def test_set_points_are_lines_of_their_zone_that_do_not_set_its_height(zones):
    _, seen = zones
    chart = "Report.course.temperatures[0]"
    assert set(series(seen, chart, "set-cooling")) == {60.0}
    assert seen.ask(f"{chart}.plot.scales.y.max") < 40
    assert not seen.ask("Report.course.temperatures[1].parts.has('set-cooling')")
    assert seen.page.locator("#course-legend [data-key=set-heating]").count() == 1


@pytest.mark.slow
def test_an_instant_without_a_plan_shows_what_came_and_says_so(zones):
    _, seen = zones
    move(seen, "#plan-slider", 9)
    assert seen.page.locator("#plan-status").inner_text() == "thermostat"
    assert "there is no plan of this instant" in seen.page.locator("#plan-why").inner_text()
    assert series(seen, "Report.plans.temperatures[0]", "plan").size == 0
    assert series(seen, "Report.plans.temperatures[0]", "came").size > N
    move(seen, "#plan-slider", 10)
    assert series(seen, "Report.plans.temperatures[0]", "plan").size == N + 1


@pytest.mark.slow
def test_markup_in_names_and_reasons_is_shown_and_never_run(zones):
    _, seen = zones
    assert HOSTILE_NAMES.zones[0] in seen.page.locator("#course figcaption").first.inner_text()
    assert seen.page.locator("#plan-why").inner_text().startswith("because <b>of</b> </script>")
    assert seen.page.locator("main img").count() == 0
    place = seen.page.locator("#course .u-over").first
    place.hover(position={"x": 200, "y": 50})
    assert "<b>of</b>" in seen.page.locator(".tip").inner_text()
    move(seen, "#plan-slider", N)


@pytest.mark.slow
def test_the_browser_refuses_scripts_that_are_not_the_pages_own(browser, one_zone):
    seen = Seen(browser, one_zone[1])
    seen.ask("document.body.insertAdjacentHTML('beforeend', '<img src=x onerror=\"window.hacked = 1\">')")
    seen.ask(
        "document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.hacked = 2'}))"
    )
    for _ in range(1000):  # what was refused is told when the browser finds the time
        if any("Content Security Policy" in text for text in seen.wrong):
            break
        seen.page.wait_for_timeout(100)
    else:
        pytest.fail("the browser refused nothing")
    assert seen.ask("window.hacked === undefined")
    seen.page.close()


@pytest.mark.slow
def test_a_rule_alone_is_drawn_without_plans(browser, tmp_path):
    house = SimpleHouse()
    run = run_closed_loop(house, Thermostat(), house.period("x"))
    report_of(run, {}, tmp_path, Layout.single())
    seen = Seen(browser, tmp_path / "report.html")
    assert seen.page.locator("#plan-slider").count() == 0
    assert seen.ask("Report.status.rungs") == ["rule"]
    seen.close()
