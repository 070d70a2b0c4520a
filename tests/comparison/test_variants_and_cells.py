"""What is compared, and which runs count as the same run."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
from pydantic import BaseModel

from thermoforce_mpc.cli.running.comparing import contestants_in_words
from thermoforce_mpc.comparison import cells
from thermoforce_mpc.comparison.cells import (
    Variant,
    expand,
    load_comparison,
    numeric_option,
    swept_variants,
    variants_by_name,
)
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment import experiment as experiment_module
from thermoforce_mpc.experiment.identifying import IdentificationTask
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate

TESTCASE = "bestest_hydronic_heat_pump"
BASE = Scenario(testcase=TESTCASE, days=1)


def keys(
    variant: Variant, base: Scenario = BASE, window: str = "44", price: str = "constant"
) -> tuple[str, str | None]:
    (cell,) = expand(base, {"any name": variant}, [window], [price])
    return cell.key, cell.identification_key


@pytest.mark.slow
@pytest.mark.parametrize("name", named_configs("comparisons"))
def test_every_comparison_that_ships_is_valid(name):
    file = load_comparison(name)
    cells = expand(BASE, file.variants, file.windows, file.prices)
    assert len(cells) == len(file.variants) * len(file.windows) * len(file.prices)
    assert len({cell.key for cell in cells}) == len(cells), "two variants are the same run"


def test_the_ablation_changes_one_part_at_a_time():
    variants = load_comparison("ablation").variants
    changed = [v for v in variants.values() if v.controller == "thermoforce_mpc" and (v.options or v.identification)]
    assert len(changed) >= 8
    parts = [{key.split("_")[0] for key in v.options} | set(v.identification) for v in changed]
    assert all(len(part) == 1 for part in parts)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("variants: {a: {controler: native}}", "controler"),
        ("variants: {}", "variants"),
        ("variants: {'a/b': {controller: native}}", "a/b"),
        ("variants: {a: {controller: native}}\nprices: [cheap]", "prices"),
        ("variants: {a: {controller: native}}\nwindows: [44, 44]", "44 is given twice"),
    ],
)
def test_a_wrong_file_is_refused_with_file_and_key(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_comparison(str(path))
    assert message in str(refused.value)
    assert str(path) in str(refused.value)


def test_windows_may_be_day_numbers(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("variants: {a: {controller: native}}\nwindows: [44, peak_heat_day]", encoding="utf-8")
    assert load_comparison(str(path)).windows == ("44", "peak_heat_day")


def test_names_given_twice_unknown_or_missing_are_refused():
    with pytest.raises(ConfigError, match="did you mean 'thermostat'"):
        variants_by_name(["thermostatt"], None)
    with pytest.raises(ConfigError, match="given twice"):
        variants_by_name(["native"], load_comparison("ablation"))
    with pytest.raises(ConfigError, match="nothing to compare"):
        variants_by_name([], None)


def test_a_wrong_option_names_its_variant_before_anything_runs():
    with pytest.raises(ConfigError, match=r"(?s)variant 'b': .*horizon_hours"):
        expand(BASE, {"b": Variant(controller="rc_mpc", options={"horizon_hours": 3})}, ["44"], ["constant"])


def test_options_of_the_scenario_are_those_of_its_controller():
    base = Scenario(testcase=TESTCASE, controller={"name": "pi", "options": {"kp": 0.4, "offset_K": 0.2}})
    variants = {"pi": Variant(controller="pi", options={"kp": 0.5}), "native": Variant(controller="native")}
    options = [cell.scenario.controller.options for cell in expand(base, variants, ["44"], ["constant"])]
    assert options == [{"kp": 0.5, "offset_K": 0.2}, {}]
    with pytest.raises(ConfigError, match=r"controller\.options: .*'pi', and no variant"):
        expand(base, {"native": Variant(controller="native")}, ["44"], ["constant"])


def test_a_run_is_known_by_what_decides_it_not_by_its_name():
    plain = keys(Variant(controller="thermoforce_mpc"))
    assert plain == keys(Variant(controller="thermoforce_mpc"))
    dearer = keys(Variant(controller="thermoforce_mpc", options={"objective": {"comfort_weight_per_m2": 9}}))
    assert dearer[0] != plain[0]
    assert dearer[1] == plain[1], "options of the controller play no part in the identification"
    priced = keys(Variant(controller="thermoforce_mpc"), price="dynamic")
    assert priced[0] != plain[0]
    assert priced[1] == plain[1]
    elsewhere = keys(Variant(controller="thermoforce_mpc"), window="45")
    assert elsewhere[0] != plain[0]
    assert elsewhere[1] != plain[1]
    identified = keys(Variant(controller="thermoforce_mpc", identification={"options": {"order": 1}}))
    assert identified[0] != plain[0]
    assert identified[1] != plain[1]
    assert keys(Variant(controller="native"))[1] is None


def test_forecast_errors_play_a_part_in_learning():
    """Probing chooses its draws for the weather that is forecast, so what errs there decides what is probed."""
    found = {}
    for seed in (1, 2):
        base = BASE.model_copy(update={"seed": seed})
        axes = (["44"], ["constant", "dynamic"], ["none", "high"])
        for cell in expand(base, {"v": Variant(controller="rc_mpc")}, *axes):
            found.setdefault((seed, cell.uncertainty), set()).add(cell.identification_key)
    assert all(len(keys) == 1 for keys in found.values()), "tariffs learn together"
    assert len(set.union(*found.values())) == 4


def test_every_identification_has_a_title_of_its_own():
    """Progress is shown by title."""
    variants = {"a": Variant(controller="rc_mpc"), "b": Variant(controller="rc_mpc", identification={"days": 2})}
    made = expand(BASE, variants, ["44", "45"], ["constant", "dynamic"], ["none", "low"])
    assert len({cell.identification_title for cell in made}) == len({cell.identification_key for cell in made}) == 8


@pytest.mark.parametrize("field", [item.name for item in fields(IdentificationTask)])
def test_everything_that_learning_is_given_is_in_its_key(field, monkeypatch, tmp_path):
    variant = {"v": Variant(controller="rc_mpc")}
    (before,) = expand(BASE, variant, ["44"], ["constant"])
    value = getattr(before.task, field)
    if isinstance(value, BaseModel):
        name = {"testcase": "floor_area_m2", "plant": "url", "probing": "excursion_K", "identification": "gamma"}[field]
        changed = value.model_copy(update={name: "http://elsewhere" if name == "url" else 0.9 * getattr(value, name)})
    elif field == "probed":
        (tmp_path / "probing").mkdir()
        changed = str(tmp_path)
    elif field == "comfort":
        changed = Comfort(schedule="else 20-24")
    else:
        changed = value + type(value)(1)
    other = replace(before.task, **{field: changed})
    monkeypatch.setattr(experiment_module, "identification_task", lambda scenario, chosen: other)
    (after,) = expand(BASE, variant, ["44"], ["constant"])
    assert after.identification_key != before.identification_key
    assert after.key != before.key


def test_a_model_learned_by_other_code_is_not_taken_up(monkeypatch):
    variant = {"v": Variant(controller="rc_mpc")}
    (before,) = expand(BASE, variant, ["44"], ["constant"])
    monkeypatch.setattr(cells, "source_fingerprint", lambda: "other")
    (after,) = expand(BASE, variant, ["44"], ["constant"])
    assert after.identification_key != before.identification_key
    assert after.key == before.key, "finished cells are kept, with a note"


def test_code_of_the_users_counts_by_content(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rules, kpis = tmp_path / "rules.py", tmp_path / "kpis.py"
    text = "class Hold:\n    step_s = horizon_s = 3600.0\n    def plan(self, observation, state=None): ...\n"

    def key(*own: str) -> str:
        return keys(Variant(controller="rules.py:Hold"), Scenario(testcase=TESTCASE, days=1, kpis=own))[0]

    rules.write_text(text)
    kpis.write_text("def one(trajectory):\n    return 1.0\n")
    first, second = key(), key("kpis.py:one")
    rules.write_text(text + "# changed\n")
    third = key()
    kpis.write_text("def one(trajectory):\n    return 2.0\n")
    assert len({first, second, third, key("kpis.py:one")}) == 4


def test_files_that_decide_a_run_count_by_content(tmp_path):
    """The FMU at the same path may be another one tomorrow, and so may a forecaster's checkpoint."""
    fmu, backbone = tmp_path / "wrapped.fmu", tmp_path / "checkpoint"
    backbone.mkdir()
    plant = {"kind": "fmu", "path": str(fmu)}
    options = {"free_response": {"options": {"backbone": str(backbone)}}}

    def key() -> str:
        base = Scenario(testcase=TESTCASE, days=1, plant=plant)
        return keys(Variant(controller="thermoforce_mpc", options=options), base)[0]

    fmu.write_bytes(b"one")
    (backbone / "config.json").write_text("one", encoding="utf-8")
    first = key()
    assert key() == first
    fmu.write_bytes(b"two")
    second = key()
    (backbone / "config.json").write_text("two", encoding="utf-8")
    third = key()
    (backbone / "below").mkdir()
    (backbone / "below" / "weights.bin").write_bytes(b"three")
    assert len({first, second, third, key()}) == 4


def test_defaults_written_out_are_the_same_run():
    plain = Variant(controller="thermoforce_mpc")
    spoken = Variant(controller="thermoforce_mpc", options={"horizon_h": 48.0, "step_s": 900.0})
    assert keys(plain) == keys(spoken)


def test_weather_counts_by_content_not_by_place(tmp_path):
    (tmp_path / "a.csv").write_text("x", encoding="utf-8")
    (tmp_path / "b.csv").write_text("x", encoding="utf-8")
    (tmp_path / "c.csv").write_text("y", encoding="utf-8")

    def key(name: str) -> str:
        base = Scenario(testcase=TESTCASE, days=1, plant={"prices_file": str(tmp_path / name)})
        return keys(Variant(controller="native"), base, price="highly_dynamic")[0]

    assert key("a.csv") == key("b.csv") != key("c.csv")
    with pytest.raises(ConfigError, match="cannot be read"):
        key("d.csv")


def test_an_option_is_found_by_its_last_word():
    assert numeric_option("thermoforce_mpc", "comfort_weight_per_m2") == "objective.comfort_weight_per_m2"
    assert numeric_option("thermoforce_mpc", "horizon_h") == "horizon_h"
    with pytest.raises(ConfigError, match="more than one"):
        numeric_option("thermoforce_mpc", "frozen_h")
    with pytest.raises(ConfigError, match="did you mean 'kp'"):
        numeric_option("pi", "kpp")


def test_a_sweep_is_one_variant_per_value():
    testcase = load_testcase(TESTCASE)
    swept = swept_variants("pi", "kp", [0.5, 1.0], testcase)
    assert {name: v.options for name, v in swept.items()} == {"pi kp=0.5": {"kp": 0.5}, "pi kp=1": {"kp": 1}}
    with pytest.raises(ConfigError, match="twice"):
        swept_variants("pi", "kp", [1.0, 1.0], testcase)
    with pytest.raises(ConfigError, match="finite"):
        swept_variants("pi", "kp", [float("nan")], testcase)
    with pytest.raises(ConfigError, match="kp"):
        swept_variants("pi", "kp", [-1.0], testcase)


def test_limits_of_the_building_are_given_to_all_who_know_them_and_the_thermostat_is_described():
    cap = {"power_cap_kW": 2.5, "power_cap_price_per_kWh": 2.0}
    options = {"objective": {**cap, "comfort_weight_per_m2": 0.1}}
    base = Scenario(testcase=TESTCASE, days=1, controller={"name": "thermoforce_mpc", "options": options})
    other = Variant(controller="rc_mpc", options={"objective": {"power_cap_price_per_kWh": 3.0}})
    low = Variant(controller="thermostat", options={"setback": {"from_hour": 22, "to_hour": 6}})
    named = {
        "ours": Variant(controller="thermoforce_mpc"),
        "rc": other,
        "low": low,
        "native": Variant(controller="native"),
    }
    cells_ = expand(base, named, ["44"], ["constant"])
    of = {cell.variant: cell.scenario.controller.options for cell in cells_}
    assert of["ours"]["objective"]["power_cap_kW"] == 2.5
    assert of["rc"] == {"objective": {"power_cap_kW": 2.5, "power_cap_price_per_kWh": 3.0}}, "a limit, no aim"
    assert not of["native"]
    said = contestants_in_words(base, cells_)
    assert said[0].startswith(
        "power_cap_kW 2.5, power_cap_price_per_kWh 2: given to ours, rc; low, native know no limits"
    )
    assert said[1] == "low keeps 21.3 °C (± 0.1 K), off from 22 to 6 h on weekdays"
    plain = contestants_in_words(BASE, expand(BASE, {"t": Variant(controller="thermostat")}, ["44"], ["constant"]))
    assert plain == ["t keeps 21.3 °C (± 0.1 K) day and night, whatever the comfort bounds are"]


def test_seeds_are_runs_of_their_own_and_windows_of_their_own():
    base, variant = Scenario(testcase=TESTCASE, seed=3), {"a": Variant(controller="thermoforce_mpc")}
    (alone,) = expand(base, variant, ["44"], ["constant"])
    cells = expand(base, variant, ["44"], ["constant"], seeds=2)
    assert [cell.window for cell in cells] == ["44, seed 3", "44, seed 4"]
    assert [cell.scenario.seed for cell in cells] == [3, 4]
    assert cells[0].key == alone.key, "a finished run of this seed is not run again"
    assert cells[1].key != alone.key


@pytest.mark.parametrize(
    ("key", "found", "value"),
    [
        ("horizon_h", lambda s: s.controller.options["horizon_h"], 12),
        ("identification.days", lambda s: s.identification.days, 2),
        ("identification.options.gamma", lambda s: s.identification.options["gamma"], 0.5),
        ("seed", lambda s: s.seed, 7),
        ("days", lambda s: s.days, 3),
        ("step_s", lambda s: s.controller.options["step_s"], 1800),
    ],
)
def test_any_number_may_be_swept(key, found, value):
    (variant,) = swept_variants("thermoforce_mpc", key, [value], load_testcase(TESTCASE)).values()
    (cell,) = expand(Scenario(testcase=TESTCASE), {"v": variant}, ["44"], ["constant"])
    assert found(cell.scenario) == value


def test_what_a_variant_may_not_set_is_refused():
    with pytest.raises(ConfigError, match="'period' is set elsewhere"):
        validate(Variant, {"controller": "pi", "scenario": {"period": "44"}}, "v")
    with pytest.raises(ConfigError, match=r"identification\.days"):
        swept_variants("thermoforce_mpc", "identification.dayz", [1], load_testcase(TESTCASE))
