"""Heat of a level over the outdoor temperature, where heat is not measured."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from houses import House, effect_rmse, random_levels, record, weather
from later import torch_operator

from thermoforce_mpc.data import HOUR_S, Layout, Names
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.effects.confounding import confounding, shared_sd, unknown_heat
from thermoforce_mpc.identification.effects.level_laws import HELD, OUTDOORS, laws_of, levels_only
from thermoforce_mpc.identification.effects.meters import identified_heat_input
from thermoforce_mpc.model.exported import step_function
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model

pytestmark = pytest.mark.usefixtures("identified_once")

CONFIG = IdentificationConfig(order=3, modulation="linear", sun_on_sensor=False, late_sensor=False)
DAYS = 12.0


def curve(days: float) -> np.ndarray:
    """Levels of a timer with an outdoor curve: most heat is asked for when it is cold."""
    time_s, T_out, _ = weather(days, HOUR_S, seed=0)
    hour = time_s[:-1] / HOUR_S % 24
    return np.clip((14.0 - T_out[:-1]) / 20.0, 0.0, 1.0) * np.where((hour >= 6) & (hour < 22), 1.0, 0.4)


def operated(slope_per_K: float, days: float = DAYS):
    house = House(machine_W=(0.0, 10000.0), slope_per_K=slope_per_K)
    return house, record(house, days, HOUR_S, u=curve(days), noise_K=0.01, heat_measured=False)


@pytest.mark.slow
def test_the_temperature_tells_how_heat_goes_with_the_weather():
    found = {}
    for slope in (0.03, -0.02):  # heat pump, circuit on a heating curve
        zone = identify(operated(slope)[1], config=CONFIG).only
        factor = zone.operator.heat_input
        true = slope / (1.0 + slope * factor.reference_C)  # per K of the heat at the mean outdoor temperature
        (said,) = (note for note in zone.card.notes if note.startswith("heat was not measured: from the temperatures"))
        sd = float(re.search(r"± ([\d.]+) %", said).group(1)) / 100.0
        assert abs(factor.per_K - true) < 2.0 * sd + 0.0005, (slope, said)
        found[slope] = factor.per_K
    assert found[0.03] > 0.02 > -0.01 > found[-0.02], found


@pytest.mark.slow
def test_the_effect_of_a_heat_pump_is_found_from_operation():
    house, run = operated(0.03)
    followed, ignored = (
        identify(run, config=CONFIG.model_copy(update={"heat_input": chosen})) for chosen in ("auto", "identity")
    )
    error, of = effect_rmse(followed, house)
    assert error < 0.75 * effect_rmse(ignored, house)[0]
    assert error < 0.2 * of
    card = followed.only.card
    assert any(note.startswith("heat was not measured: from the temperatures") for note in card.notes)
    cards = (card, ignored.only.card)
    share = [c.uncertainty["step_response_8h_sd_K"] / c.uncertainty["step_response_8h_K"] for c in cards]
    assert share[0] > share[1], "what is not known of the heat counts in the effect"


@pytest.mark.slow
def test_where_heat_is_known_nothing_is_estimated():
    house, run = operated(0.03)
    metered = replace(run, heat_W=house.heat_W(run.u[0], run.T_out_C[:-1])[None])
    assert identify(metered, config=CONFIG).only.operator.heat_input.per_K == 0.0
    for options in ({"heat_input": "identity"}, {"method": "two_stage", "order": 1}):
        assert not levels_only(IDENTITY, Layout.single(), 0, CONFIG.model_copy(update=options))
    assert not levels_only(HeatInput(u_min=-1.0), Layout.single("both", -1.0), 0, CONFIG)
    assert levels_only(IDENTITY, Layout.single(), 0, CONFIG)
    assert laws_of([], Layout.single(), 0, IDENTITY, CONFIG) == []


@pytest.mark.slow
def test_every_form_of_the_operator_has_the_same_heat(tmp_path):
    model = identify(operated(0.03)[1], config=CONFIG)
    model.save(tmp_path / "model")
    operator = load_model(tmp_path / "model").only.operator
    assert operator.heat_input == model.only.operator.heat_input
    assert operator.heat_input.per_K > 0.01
    assert certificate(operator).certified
    step, torch_form = (
        step_function(ThermalModel.single(operator), operator.step_s, part_load="held"),
        torch_operator.ForcedResponseOperator(operator),
    )
    for T_out in (-30.0, -2.0, 4.0, 40.0):
        features = np.array([18.0, T_out, 100.0, 0.5])
        expected = operator.step(np.zeros(operator.order), 0.6, features)
        np.testing.assert_allclose(np.asarray(step(np.zeros(operator.order), 0.6, features)).ravel(), expected)
        heat = torch_form.heat(*(torch_form.pole_bounds.new_tensor(x) for x in (0.6, T_out)))
        assert float(heat) == pytest.approx(float(operator.heat_input(np.array(0.6), np.array(T_out))))
    low, high = operator.heat_input.slope_bounds()
    assert 0.0 < low < 1.0 < high == operator.heat_input.largest()


def test_heat_that_would_fall_with_the_level_is_refused():
    with pytest.raises(DataError, match="not positive from -20 to 10 °C"):
        HeatInput(reference_C=5.0, per_K=0.05, T_out_range_C=(-20.0, 10.0))
    with pytest.raises(DataError, match="lowest level"):
        HeatInput(u_min=-1.0, per_K=0.01, T_out_range_C=(0.0, 1.0))


@pytest.mark.parametrize(("at_first_W", "fewest", "most"), [(10000.0, 0.2, 0.6), (5000.0, 0.0, 0.001)])
def test_heat_that_falls_while_a_level_is_held_makes_the_effect_less_sure(at_first_W, fewest, most):
    n = 96 * 3
    u = (random_levels(n, 1, hold=8) > 0.5).astype(float)
    held = np.array([u[max(0, t - 3) : t + 1].min() for t in range(n)])  # on for an hour or more
    run = record(House(), 3.0, 900.0, u=u)
    run = replace(run, heat_W=np.where(held, 5000.0, at_first_W * u)[None])
    layout = Layout.single()
    heat_input, _ = identified_heat_input([run], CONFIG, 1)
    unknown = unknown_heat([run], layout, 0, heat_input, {}, CONFIG)
    assert fewest <= unknown.sd < most
    assert [note.endswith("with how long it is held") for note in unknown.notes] == [True] * (fewest > 0.0)
    levels = unknown_heat([run], layout, 0, IDENTITY, {}, CONFIG.model_copy(update={"heat_input": "identity"}))
    assert levels.sd == 0.0


@pytest.mark.slow
def test_rooms_that_are_heated_together_cannot_be_told_apart():
    names = Names(("north", "south"), ("a", "b"), ("pump",))
    layout = Layout(names, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.8, 0.8), (10.0, 90.0))
    days = 6.0
    run = operated(0.0, days)[1]
    two = {name: np.repeat(getattr(run, name), 2, axis=0) for name in ("T_zone_C", "heat_W")}
    n = run.n_steps
    together = replace(run, **two, u=np.stack([curve(days)] * 2), names=names)
    apart = replace(together, u=np.stack([random_levels(n, 1, hold=12), random_levels(n, 2, hold=12)]))
    one, other = (confounding([r], layout, 0, CONFIG) for r in (together, apart))
    assert one[0] > 0.25 > 0.1 > other[0]
    assert "levels went together with those of b:" in one[1]
    assert other[1] == ""
    # Cold days open both for most of the time, each at its own times: as the fit sees them, they are apart.
    cold = np.repeat(np.random.default_rng(3).random(n // 96 + 1) > 0.5, 96)[:n]
    rng = np.random.default_rng(4)
    by_weather = replace(together, u=(rng.random((2, n)) < np.where(cold, 0.9, 0.1)).astype(float))
    assert confounding([by_weather], layout, 0, CONFIG) == (pytest.approx(0.0, abs=0.12), "")
    part_load = CONFIG.model_copy(update={"part_load": True})
    found = laws_of([together], layout, 0, IDENTITY, part_load)
    assert [law.name for law in found] == [OUTDOORS, HELD], "at part load one gets what the other leaves"
    assert 0.1 < shared_sd(layout, 0) < 0.2, "the machine gives both but 0.6 of their full level"
    unknown = unknown_heat([together], layout, 0, IDENTITY, {}, CONFIG)
    assert unknown.sd > one[0]
    assert shared_sd(layout, 0) <= unknown.heat_sd < unknown.sd, "other rooms get what the heat is, not what is theirs"
    known, levels = (
        identify(together, layout=layout, config=CONFIG.model_copy(update={"heat_input": chosen})).cards[0]
        for chosen in ("auto", "identity")
    )
    assert one[1] in known.notes
    assert known.competence.advice[0] == one[1]
    assert not any("went together" in note for note in levels.notes), "levels were said to be the heat themselves"
    assert known.competence.relative_sd > max(one[0], levels.competence.relative_sd)
