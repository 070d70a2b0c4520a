"""Probing goes on until the model is worth it, ends early where it is, and stays polite in light zones."""

from __future__ import annotations

import re

import numpy as np
import pytest
from simple_house import SimpleHouse, outdoor_C

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Measurement, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.probing.politeness import Foresight
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.identification.validation import competence
from thermoforce_mpc.identification.validation.competence import SETTLED_SD
from thermoforce_mpc.loop.probing import Identifying, Probing, probe, probe_until_known
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase

pytestmark = pytest.mark.slow

TESTCASE = load_testcase("bestest_hydronic_heat_pump").model_copy(update={"floor_area_m2": 192.0})
LINEAR = IdentificationConfig(modulation="linear")
SHORT = ProbingConfig(warmup_days=1.0, candidates=6)


class Watched(SimpleHouse):
    """Remembers when it was advanced to; `deaf`: the actuator does nothing."""

    def __init__(self, deaf: bool = False) -> None:
        super().__init__()
        self.deaf, self.latest_s, self.resets = deaf, 0.0, 0

    def reset(self, start_s, warmup_s, price="constant"):
        self.resets += 1
        return super().reset(start_s, warmup_s, price)

    def step(self, u, duration_s):
        if not self.deaf or u is None:
            return super().step(u, duration_s)
        super().step(0.2, duration_s)
        self._rows.pop()
        measurement = self.measure(u)
        self._rows.append((duration_s, measurement))
        return measurement

    def advance(self, u, duration_s):
        measurement = super().advance(u, duration_s)
        self.latest_s = self.now_s
        return measurement


def _identified(house, days, most_days=None, end_early=False):
    progress, identifying = [], Identifying(TESTCASE, LINEAR)
    probed, look = probe_until_known(
        house, identifying, before=house.period("x"), days=days, most_days=most_days or days, end_early=end_early,
        seed=1, probing=SHORT, on_progress=progress.append,
    )  # fmt: skip
    return identifying.conclude(probed, look), probed.record, progress


def test_probing_goes_on_day_by_day_until_the_bar_is_reached(monkeypatch):
    # A day is enough on this house: the bar is made one that the first day misses.
    verdicts = iter(["it knows too little", ""])
    monkeypatch.setattr(competence, "lacking", lambda verdict: next(verdicts))
    house = Watched()
    model, record, progress = _identified(house, 1.0, most_days=10.0)
    assert model.only.card.competence.competent
    assert record.n_steps == 192
    assert house.resets == 1, "on the same run of the plant"
    assert model.only.card.notes[-1] == "probing ended after 2 days: enough is known"
    assert "2 days of probing" in model.only.card.source
    assert [round(24 * p.days) for p in progress] == list(range(1, 49)), "every hour"


def test_probing_goes_on_while_the_effect_is_hardly_known(monkeypatch):
    model, record, _ = _identified(Watched(), 2.0, most_days=3.0)
    assert record.n_steps == 192
    assert 0.01 < model.only.card.competence.relative_sd <= SETTLED_SD
    monkeypatch.setattr(competence, "SETTLED_SD", 0.01)
    model, record, _ = _identified(Watched(), 2.0, most_days=3.0)
    assert record.n_steps == 3 * 96
    assert model.only.card.competence.competent, "it may be acted on all the same"
    note = model.only.card.notes[-1]
    assert re.fullmatch(
        r"probing ended after 3 days: the most days are over; the effect is known to ± \d % only, need 1 %", note
    )


def test_probing_never_enters_the_scored_window():
    house = Watched(deaf=True)
    window = house.period("x")
    with pytest.raises(DataError, match=r"probing ended after 3 days: the scored window begins"):
        _identified(house, 1.0, most_days=10.0)
    assert house.latest_s == window.start_s, "one day before the warm-up of two days, and those"
    house = Watched(deaf=True)
    with pytest.raises(DataError, match=r"probing ended after 2 days: the most days are over"):
        _identified(house, 1.0, most_days=2.0)
    assert house.latest_s == window.start_s - DAY_S


def test_probing_ends_early_where_the_effect_is_known_well(monkeypatch):
    monkeypatch.setattr(competence, "WELL_KNOWN_SD", 0.12)
    model, record, _ = _identified(Watched(), 4.0, end_early=True)
    assert 1.5 * 96 <= record.n_steps < 4 * 96
    assert record.n_steps % 48 == 0
    assert model.only.card.competence.relative_sd < 0.13
    assert model.only.card.notes[-1] == f"probing ended after {record.n_steps / 96:.3g} days: enough is known"
    _, whole, _ = _identified(Watched(), 4.0, end_early=False)
    assert whole.n_steps == 4 * 96
    np.testing.assert_array_equal(whole.u[0, : record.n_steps], record.u[0])


def test_a_probing_continued_is_the_same_probing():
    plant = EmbeddedPlant(synthetic_weather())
    at_once = probe(plant, 20 * DAY_S, 2.0, seed=1, config=SHORT)
    run = Probing(plant, 20 * DAY_S, seed=1, config=SHORT)
    run.go_on(1.0)
    run.go_on(1.0)
    np.testing.assert_array_equal(run.record.u[0], at_once.u[0])
    np.testing.assert_array_equal(run.record.T_zone_C[0], at_once.T_zone_C[0])


class LightHouse(SimpleHouse):
    """Air that follows within minutes what its walls and a strong fan coil say: 11 K in a quarter of an hour."""

    def reset(self, start_s, warmup_s, price="constant"):
        self.walls_C = self.T_start_C
        return super().reset(start_s, warmup_s, price)

    def step(self, u, duration_s):
        level = float(self.T < 21.2) * 0.03 if u is None else u
        share = 1.0 - np.exp(-duration_s / 300.0)
        target = self.walls_C - 1.0 + 12.0 * level
        self.T += share * (target - self.T)
        self.walls_C += (
            duration_s
            / HOUR_S
            * (0.08 * (self.T - self.walls_C) + 0.01 * (float(outdoor_C(self.now_s)) - self.walls_C))
        )
        self.now_s += duration_s
        measurement: Measurement = self.measure(level)
        self._rows.append((duration_s, measurement))
        return measurement


def test_a_light_zone_is_probed_inside_its_band():
    polite = probe(LightHouse(), 20 * DAY_S, 2.0, seed=1, config=SHORT)
    rude = probe(LightHouse(), 20 * DAY_S, 2.0, seed=1, config=SHORT.model_copy(update={"margin_K": 50.0}))
    assert rude.T_zone_C[0].max() > 29.0, "what one full step does here"
    assert polite.T_zone_C[0].max() < 25.0 + 0.2, "comfort band to 24 °C, margin 1 K"
    assert polite.T_zone_C[0, 12:].min() > 20.0 - 0.5
    assert np.std(polite.u[0]) > 0.03, "still excited"
    assert len(np.unique(polite.u[0].round(3))) > 5


def test_a_heavy_zone_is_probed_as_if_nobody_looked_ahead(monkeypatch):
    plant = EmbeddedPlant(synthetic_weather())
    looked = probe(plant, 20 * DAY_S, 1.0, seed=1)
    monkeypatch.setattr(Foresight, "polite", lambda self, level, *now: level)
    np.testing.assert_array_equal(looked.u[0], probe(plant, 20 * DAY_S, 1.0, seed=1).u[0])


def test_foresight_learns_what_a_level_does():
    none = np.empty(0)
    now = Record(*(np.array([v]) for v in (0.0, 21.0, 5.0, 0.0)), none, none, none)
    foresight = Foresight(now, 1.0, 900.0)
    assert foresight.effect_K == pytest.approx(10.0), "unknown: on the safe side"
    rng, record = np.random.default_rng(0), now
    for k in range(60):
        u = float(rng.uniform(0, 0.4))
        T = 21.0 + 8.0 * u
        record = record.extended(Measurement(900.0 * (k + 1), T, 5.0, 0.0, u))
        foresight.learn(record)
    assert 6.0 < foresight.effect_K < 10.0
    level = foresight.polite(1.0, 1.0, 21.0, 5.0, 0.0, 20.0, 23.0)
    assert 0.15 < level < 0.35
    assert foresight.polite(1.0, 1.0, 23.5, 5.0, 0.0, 20.0, 23.0) < level
