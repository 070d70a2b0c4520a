"""What the identification says about its own certainty holds, and is shown."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from houses import House, record
from matplotlib.figure import Figure
from matplotlib.text import Text

from thermoforce_mpc.cli import cli
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.model.thermal_model import load_model
from thermoforce_mpc.whatif.picture import plot_identification
from thermoforce_mpc.whatif.rollouts import rollouts

pytestmark = pytest.mark.slow

HOUSE = House()
LINEAR = IdentificationConfig(order=3, modulation="linear", sun_on_sensor=False, late_sensor=False)


@functools.cache
def model_of(days: float, seed: int):
    return identify([record(HOUSE, days, seed=seed, noise_K=0.01)], config=LINEAR, floor_area_m2=190.0)


@pytest.fixture(scope="module")
def models():
    return [model_of(3.0, seed) for seed in range(4)]


def truth_of(model):
    """Effect of full level, (49,) K, in the mean weather of the record, for which the card speaks."""
    share = 1.0 + HOUSE.slope_per_K * model.only.operator.heat_input.reference_C
    return HOUSE.effect_K(np.full(48, share), 3600.0)


def test_bands_hold_the_truth(models):
    inside, widths = [], []
    for model in models:
        known, truth = model.only.card.uncertainty, truth_of(model)
        for hours in (1, 4, 12, 24):
            sd = known[f"step_response_{hours}h_sd_K"]
            inside.append(abs(known[f"step_response_{hours}h_K"] - truth[hours]) <= 2 * sd)
            widths.append(sd / truth[hours])
    assert np.mean(inside) >= 0.85
    assert np.median(widths) < 0.12, "a band that says nothing holds everything"


@pytest.mark.parametrize("area_m2", [150.0, 235.0])
def test_bands_allow_for_a_building_that_is_not_what_the_priors_expect(area_m2):
    """A floor area that is a quarter off puts the priors per m² off, metered heat by more than its deviation."""
    errors, deviations = [], []
    for seed in range(2):
        run = record(HOUSE, 3.0, seed=seed, noise_K=0.01)
        model = identify([run], config=LINEAR, floor_area_m2=area_m2)
        known, truth = model.only.card.uncertainty, truth_of(model)
        for hours in (1, 2, 4, 8, 12, 24):
            errors.append((known[f"step_response_{hours}h_K"] - truth[hours]) / truth[hours])
            deviations.append(known[f"step_response_{hours}h_sd_K"] / truth[hours])
    off = np.array(errors) / np.array(deviations)
    assert np.sqrt(np.mean(off**2)) < 1.3
    assert np.abs(errors).max() < 0.1


def test_more_days_make_narrower_bands():
    few, many = (model_of(days, 3).only.card.uncertainty["step_response_24h_sd_K"] for days in (1.5, 6.0))
    assert many < 0.8 * few


def test_rollouts_over_the_record_are_good_and_drawn(models, tmp_path):
    record_ = record(HOUSE, 3.0, seed=0, noise_K=0.01)
    found = rollouts(models[0], record_)
    assert found.rmse_K < 0.6
    assert np.isnan(found.predicted_C[0, :48]).all()
    assert np.isfinite(found.predicted_C[0, 49:]).all()
    for name in ("a.png", "b.png"):
        plot_identification(tmp_path / name, models[0], record_)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("origin", "below", "label"),
    [
        (None, "21 Jan to 24 Jan", "22 Jan"),
        (pd.Timestamp("2026-01-01", tz="Europe/Brussels"), "2026-01-21 to 2026-01-24, standard time of Europe/Brussels",
         "22 Jan"),
    ],
)  # fmt: skip
def test_times_below_a_picture_are_dates(models, tmp_path, monkeypatch, origin, below, label):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    plot_identification(tmp_path / "a.png", models[0], replace(record(HOUSE, 3.0, seed=0), origin=origin))
    drawn[0].draw_without_rendering()
    axes = drawn[0].subfigs[0].axes[-1]
    assert axes.get_xlabel() == below
    assert label in [tick.get_text() for tick in axes.get_xticklabels()]


def test_levels_of_cooling_are_drawn(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], 24), 8)
    run = record(House(machine_W=(0.0, 10000.0)), 2.0, u=u, noise_K=0.01, heat_measured=False)
    run = replace(run, power_W=np.full(u.size, np.nan))
    model = identify([run], config=LINEAR, mode="both", u_min=-1.0)
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    plot_identification(tmp_path / "a.png", model, run)
    (levels,) = (axes for part in drawn[0].subfigs for axes in part.axes if axes.get_ylabel() == "level u")
    assert levels.get_ylim() == pytest.approx((-1.05, 1.05))
    # The legend above the courses leaves their title free.
    drawn[0].draw_without_rendering()
    courses = drawn[0].subfigs[0].axes[0]
    title = courses.get_title(loc="left")
    (shown,) = (text for text in courses.findobj(Text) if title and text.get_text() == title)
    assert not shown.get_window_extent().overlaps(courses.get_legend().get_window_extent())


def test_inspect_shows_bands_and_they_survive_saving(models, tmp_path):
    folder = models[0].save(tmp_path / "model")
    assert load_model(folder).only.card.uncertainty == dict(models[0].only.card.uncertainty)
    shown = CliRunner().invoke(cli, ["inspect", str(folder)], catch_exceptions=False).output
    known = models[0].only.card.uncertainty
    assert f"{known['step_response_24h_K']:.2f}" in shown
    assert f"{known['step_response_24h_K'] + 1.645 * known['step_response_24h_sd_K']:.2f}" in shown


def test_a_model_that_knows_little_says_so():
    little = np.zeros(96)
    little[[10, 11, 30, 31, 60, 61]] = 1.0
    model = identify([record(HOUSE, 1.0, seed=2, u=little, noise_K=0.01)], config=LINEAR, floor_area_m2=190.0)
    assert any("uncertain: the effect of a day of action is known to" in note for note in model.only.card.notes)
    assert not any("uncertain" in note for note in model_of(6.0, 3).only.card.notes)
