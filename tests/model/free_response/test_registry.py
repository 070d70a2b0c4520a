"""What a user may name: five free responses, their options, and what a wrong name or value is told."""

from __future__ import annotations

import numpy as np
import pytest
from forecasting import boundary_of, history_of

from controllers.mpc.config import FreeResponseConfig
from controllers.registry import controller_config
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.outside import python_of
from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.free_response.registry import (
    build_free_response,
    check_free_response,
    needs_identified,
    own_options,
)
from thermoforce_mpc.plants.testcases import load_testcase


def test_there_are_five() -> None:
    assert list(own_options()) == ["residual", "chronos", "linear_weather", "rc", "persistence"]


def test_the_default_of_the_mpc_is_the_weather_model_with_the_forecaster_calibrated() -> None:
    config = FreeResponseConfig()
    built = build_free_response(config.name, **config.options)
    assert built.name == "residual"
    assert isinstance(built, CalibratedFreeResponse)
    assert isinstance(built.inner, ChronosFreeResponse)
    assert built.inner.backbone == "shipped_weather"


def test_the_default_is_the_mean_with_the_models_own_free_part_where_it_has_one() -> None:
    own = RcParameters(
        np.array([0.97]), np.array([[0.03, 1e-3, 0.0, 0, 0, 0, 0, 0]]), 3600.0, np.eye(1), 100.0 * np.eye(1)
    )
    n, ahead = 72, 12
    t = np.arange(n + ahead + 1)
    outdoor, solar = 5.0 + 4.0 * np.sin(t / 24.0), np.maximum(0.0, 300.0 * np.sin(2 * np.pi * t / 24.0))
    free = 8.0 + np.sin(t[: n + 1] / 9.0)
    history = history_of(free, T_out_C=outdoor[: n + 1], solar_W_m2=solar[: n + 1])
    boundary = boundary_of(n, ahead, T_out_C=outdoor[n:], solar_W_m2=solar[n:])
    alone, of_model, mean = (
        method.forecast(free, history, boundary)
        for method in (
            build_free_response("residual", calibrate=False),
            build_free_response("rc", rc=own),
            build_free_response("residual", calibrate=False, rc=own),
        )
    )
    np.testing.assert_allclose(mean.quantiles_C, 0.5 * (alone.quantiles_C + of_model.quantiles_C))
    assert np.abs(alone.median_C - of_model.median_C).max() > 0.1, "else the mean proves nothing"
    assert alone.note in mean.note
    calibrated = build_free_response("residual", rc=own)
    assert calibrated.name == "residual"
    assert calibrated.weight_hash() == build_free_response("residual").weight_hash()  # type: ignore[attr-defined]
    assert not needs_identified("residual")
    assert needs_identified("rc")


def test_calibration_is_an_option_of_the_default_alone() -> None:
    assert isinstance(build_free_response("residual", calibrate=False), ChronosFreeResponse)
    assert isinstance(build_free_response("chronos"), ChronosFreeResponse)
    assert {name: list(options) for name, options in own_options().items() if options} == {
        "residual": ["backbone", "calibrate"],
        "chronos": ["backbone", "resolutions"],
    }


@pytest.mark.parametrize("name", ["calibrated", "selected", "ar", "arx", "ets", "seasonal_naive"])
def test_what_is_no_choice_any_more_is_refused_with_what_is(name: str) -> None:
    with pytest.raises(
        ConfigError, match=f"unknown free response '{name}'.*known: residual, chronos, linear_weather, rc, persistence"
    ):
        check_free_response(name, {})


def test_unknown_names_and_options_are_refused_with_what_is_known() -> None:
    with pytest.raises(ConfigError, match=r"chronoss.*did you mean 'chronos'.*known: .*persistence"):
        build_free_response("chronoss")
    with pytest.raises(ConfigError, match=r"unknown option 'resolution'.*did you mean 'resolutions'"):
        build_free_response("chronos", resolution="one")
    with pytest.raises(ConfigError, match="'linear_weather': unknown option 'calibrate'; known: none"):
        build_free_response("linear_weather", calibrate=True)


def test_calibrate_is_true_or_false_and_no_word() -> None:
    with pytest.raises(ConfigError, match="'residual': calibrate is 'no', write true or false"):
        check_free_response("residual", {"calibrate": "no"})


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({"name": "calibrated"}, r"free_response: unknown free response 'calibrated'; known: residual"),
        ({"name": "rc", "options": {"backbone": "shipped"}}, "'rc': unknown option 'backbone'; known: none"),
        ({"options": {"backbones": "shipped"}}, "did you mean 'backbone'"),
    ],
)
def test_a_wrong_choice_is_found_when_the_scenario_is_read(chosen: dict[str, object], words: str) -> None:
    """Not days later, when the building has been probed and the controller is built."""
    with pytest.raises(ConfigError, match=words):
        controller_config("thermoforce_mpc", {"free_response": chosen}, load_testcase("bestest_hydronic_heat_pump"))


def test_a_class_in_a_file_is_a_free_response_with_its_parameters_as_options(tmp_path, monkeypatch) -> None:
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    config = FreeResponseConfig(name="mine.py:Yesterday", options={"spread_K": 0.5})
    built = build_free_response(config.name, **config.options)
    free = 20.0 + np.sin(np.arange(49) / 4.0)
    found = built.forecast(free, history_of(free), boundary_of(48, 3))
    np.testing.assert_allclose(found.quantiles_C[2] - found.quantiles_C[0], 1.0)
    for name, options, why in (
        ("mine.py:Yesterday", {"spread": 1}, "did you mean 'spread_K'"),
        ("mine.py:Tomorrow", {}, "has no 'Tomorrow'; it has Yesterday, bare"),
        ("mine.py:bare", {}, "its parameters x have no default"),
    ):
        with pytest.raises(ConfigError, match=why):
            check_free_response(name, options)
    # As code of a file it is asked for wherever a file names it.
    assert python_of({"controller": {"options": {"free_response": {"name": "mine.py:Yesterday"}}}}) == ["mine.py"]


MINE = """
import numpy as np
from thermoforce_mpc.data import FreeForecast

class Yesterday:
    name = "yesterday"

    def __init__(self, spread_K: float = 0.1):
        self.spread_K = spread_K

    def forecast(self, free_C, history, boundary):
        ahead = np.full(boundary.n_steps, free_C[-1])
        return FreeForecast(np.array([0.1, 0.5, 0.9]), np.stack([ahead - self.spread_K, ahead, ahead + self.spread_K]))

def bare(x):
    return Yesterday()
"""
