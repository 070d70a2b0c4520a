"""What the page of a comparison draws and how it answers, in a headless Chromium. Skips where the machine has none."""

from __future__ import annotations

import json

import pytest
from browser import Seen, chromium
from comparison_records import record

from controllers.registry import REGISTRY
from thermoforce_mpc.comparison.files import write_outcome

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
POINTS = {
    "ours": (0.55, 0.1), EVIL: (0.60, 0.3), "thermostat": (0.65, 0.2), "native": (0.9, 8.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparison")
    records = [
        record(name, cost * scale, discomfort, needs_model=name in ("ours", EVIL), window=window)
        for window, scale in (("16", 1.0), ("44", 0.9), ("108", 0.5))
        for name, (cost, discomfort) in POINTS.items()
    ]
    write_outcome(folder, records, name="compare", title=f"A title {EVIL}", currency="EUR")
    return folder / "comparison.html"


@pytest.fixture(scope="module")
def opened(browser, page):
    found = Seen(browser, page)
    yield found
    found.close()


@pytest.fixture
def seen(opened):
    """The page, all of it in view; loaded once."""
    opened.page.locator("#pareto-tools button", has_text="all").click()
    yield opened
    assert opened.wrong == []


def places(seen, panel=0):
    """Where the marks of a panel are, in its drawing: {name: (x, y)}."""
    return seen.ask(f"""Object.fromEntries([...Report.panels[{panel}].place.querySelectorAll(".mark")].map((mark) => {{
      const [x, y] = mark.getAttribute("transform").match(/[-\\d.]+/g).map(Number);
      return [mark.dataset.name, [x, y]];
    }}))""")


@pytest.mark.slow
def test_cheaper_is_lower_and_calmer_further_left(seen):
    assert seen.page.locator("#pareto .panel").count() == 3
    at = places(seen)
    assert set(at) == set(POINTS)
    for name, (cost, discomfort) in POINTS.items():
        for other, (more, harsher) in POINTS.items():
            if cost < more:
                assert at[name][1] > at[other][1]
            if discomfort < harsher:
                assert at[name][0] < at[other][0]
    titles = seen.page.locator("#pareto figcaption").all_inner_texts()
    assert titles == ["day 16, constant tariff", "day 44, constant tariff", "day 108, constant tariff"]


# Six whose names are long and whose points nearly coincide.
CLOSE = {
    "thermoforce_mpc": (0.03887, 0.0011), "rc_mpc": (0.03963, 0.0), "pi": (0.04253, 0.0186),
    "thermostat": (0.04505, 0.0), "native": (0.07294, 0.1315), "thermoforce_paper": (0.09602, 0.0043),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("width", [600, 1400])
def test_no_name_is_on_another_or_on_a_mark(browser, tmp_path, width):
    records = [
        record(name, cost, discomfort, needs_model=True, window="108") for name, (cost, discomfort) in CLOSE.items()
    ]
    write_outcome(tmp_path, records, name="compare", title="close", currency="EUR")
    seen = Seen(browser, tmp_path / "comparison.html", width=width)
    boxes = seen.ask("""[...document.querySelectorAll("#pareto .name, #pareto .mark")].map((part) => {
      const box = part.getBBox(), at = part.getAttribute("transform")?.match(/[-\\d.]+/g).map(Number) || [0, 0];
      return [part.getAttribute("class"), part.textContent, box.x + at[0], box.x + box.width + at[0],
        box.y + at[1] + 1, box.y + box.height + at[1] - 1];
    })""")
    names = [box for box in boxes if box[0] == "name"]
    assert len(names) == len(CLOSE)
    for name in names:
        for other in boxes:
            apart = name[3] < other[2] or other[3] < name[2] or name[5] < other[4] or other[5] < name[4]
            assert name is other or apart, (name, other)
    seen.close()


def test_controllers_that_ship_look_alike_on_every_page_and_unlike_one_another(seen):
    among = seen.ask(f"Object.fromEntries(Looks.of({json.dumps([*REGISTRY.own, 'mine', 'yours'])}))")
    for name in REGISTRY.own:
        assert seen.ask(f"Looks.of(['{name}']).get('{name}')") == among[name], name
    assert len({(look["colour"], look["shape"]) for look in among.values()}) == len(among)
    # Without colour: no two of these share shape or dash.
    common = [among[name] for name in CLOSE]
    assert len({look["shape"] for look in common}) == len({str(look.get("dash")) for look in common}) == len(CLOSE)


def test_the_scale_of_discomfort_can_be_straight(seen):
    before = places(seen)
    seen.page.locator("#pareto-tools button", has_text="logarithmic").click()
    after = places(seen)
    share = (after["thermostat"][0] - after["ours"][0]) / (after["native"][0] - after["ours"][0])
    assert share == pytest.approx(0.1 / 7.9, rel=0.01)
    seen.page.locator("#pareto-tools button", has_text="logarithmic").click()
    assert places(seen) == before
    assert (before["thermostat"][0] - before["ours"][0]) > 3 * (after["thermostat"][0] - after["ours"][0])


def test_a_legend_hides_a_controller_in_every_panel_and_shows_it_again(seen):
    key = seen.page.locator("#pareto-legend [data-key=native]")
    key.click()
    assert [set(places(seen, panel)) for panel in range(3)] == [set(POINTS) - {"native"}] * 3
    key.click()
    assert set(places(seen)) == set(POINTS)


def test_dragging_zooms_and_a_double_click_shows_all(seen):
    at = places(seen)
    box = seen.page.locator("#pareto svg.pareto").first.bounding_box()
    corner = (min(at[name][0] for name in ("ours", "thermostat")) - 15, max(y for _, y in at.values()) + 15)
    other = (max(at[name][0] for name in ("ours", EVIL)) + 15, at["thermostat"][1] - 15)
    seen.page.mouse.move(box["x"] + corner[0], box["y"] + corner[1])
    seen.page.mouse.down()
    seen.page.mouse.move(box["x"] + other[0], box["y"] + other[1], steps=3)
    seen.page.mouse.up()
    assert set(places(seen)) == set(POINTS) - {"native"}
    seen.page.locator("#pareto svg.pareto").first.dblclick(position={"x": 200, "y": 30})
    assert places(seen) == at


def test_pointing_at_a_mark_tells_its_figures(seen):
    seen.page.locator("#pareto .panel").first.locator(".mark[data-name=thermostat]").hover()
    tip = seen.page.locator(".tip").inner_text()
    assert "0.6500 EUR/m²" in tip
    assert "0.20 K·h" in tip


def test_confidence_is_shown_beside_any_reference(seen):
    chosen = seen.page.locator("#reference")
    assert chosen.input_value() == "thermostat"
    seen.page.locator("summary", has_text="as a table").click()
    rows = seen.page.locator("#paired-table tr").all_inner_texts()
    assert any("ours" in row and "−15.4 %" in row for row in rows)
    assert seen.page.locator("#paired svg .difference[data-name=ours] circle.window").count() == 6
    chosen.select_option("native")
    rows = seen.page.locator("#paired-table tr").all_inner_texts()
    assert any("ours" in row and "−38.9 %" in row for row in rows)
    assert not any(row.startswith("native") for row in rows)


@pytest.mark.slow
def test_differences_are_told_with_their_own_windows(browser, tmp_path):
    costs = {"ours": {"16": 0.5, "44": 0.4}, "pi": {"44": 0.7}, "thermostat": {"16": 0.5, "44": 0.5}}
    records = [
        record(name, cost, 0.1, needs_model=name == "ours", window=window)
        for name in ("pi", "ours", "thermostat")
        for window, cost in costs[name].items()
    ]
    write_outcome(tmp_path, records, name="compare", title="t", currency="EUR")
    seen = Seen(browser, tmp_path / "comparison.html")
    line = seen.page.locator("#paired svg .difference[data-name=ours]").first
    line.locator("rect.hit").hover(position={"x": 3, "y": 3})
    tip = seen.page.locator(".tip").inner_text()
    assert "16: 0.0 %" in tip
    assert "44: −20.0 %" in tip
    seen.close()


def test_markup_in_names_is_shown_and_never_run(seen):
    assert EVIL in seen.page.locator("h1").inner_text()
    assert EVIL in seen.page.locator("#pareto-legend").inner_text()
    assert seen.page.locator("main img").count() == 0


def test_a_drawing_can_be_saved_as_it_is_seen(seen):
    with seen.page.expect_download() as waiting:
        seen.page.locator("#pareto button", has_text="save").first.click()
    text = waiting.value.path().read_text(encoding="utf-8")
    assert text.startswith("<svg")
    assert "var(--" not in text.replace("fill: var", "")
    assert waiting.value.suggested_filename == "day_16_constant_tariff.svg"


@pytest.mark.slow
def test_a_sweep_is_a_line_in_its_order(browser, tmp_path):
    values = {f"w={value}": str(value) for value in (1, 5, 20)}
    records = [record(name, 0.6 + 0.01 * k, 2.0 - k, needs_model=True) for k, name in enumerate(values)]
    write_outcome(tmp_path, records, name="sweep", title="t", currency="EUR", swept=values)
    seen = Seen(browser, tmp_path / "comparison.html", width=390)
    line = seen.page.locator("#pareto path.sweep").get_attribute("d")
    assert line.count("L") == 2
    assert seen.page.locator("#pareto svg text.name").all_text_contents() == ["1", "5", "20"]
    assert seen.ask("document.documentElement.scrollWidth") == 390
    seen.close()
