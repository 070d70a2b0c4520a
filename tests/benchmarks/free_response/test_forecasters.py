"""`tf-mpc bench forecasters`: what it says of models whose properties are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.free_response import forecasters
from benchmarks.free_response.runs import gap_rows
from benchmarks.free_response.sources import Source
from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.data.series import held, interpolated
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.registry import build_free_response


class Last:
    """Quantiles around the last value, wider with the spread of the history, from eight known values on."""

    label, modules = "last", ()

    def quantiles_C(self, contexts):
        answers = []
        for context in contexts:
            free = interpolated(held(context.free_C))
            if np.isfinite(context.free_C).sum() < 8:
                raise ValueError("too few")
            steps = np.arange(1, len(context.ahead_weather) + 1)
            answers.append(free[-1] + free.std() * np.linspace(-1, 1, 9)[:, None] * steps)
        return answers


def test_what_is_so_by_construction_is_found():
    found = forecasters.answers(Last())
    assert max(found[name] for name in ("shift", "scale", "mirror", "horizon_48", "gap_at_the_end_as_held")) < 1e-9
    assert found["constant_off_K"] < 1e-9
    assert found["crossing_share"] == 0.0
    assert found["fewest_values"] == 8
    assert found["older_values"] > 0.01
    assert forecasters.in_words(found) == {
        "moved or scaled": "same",
        "mirrored": "same",
        "first day of two": "same",
        "constant": "the constant",
        "gaps": "told",
        "cross": "0%",
    }


class Upside(Last):
    """Crosses, sees the zero of the scale, and answers differently of longer horizons."""

    def quantiles_C(self, contexts):
        return [10.0 + 0.5 * values[::-1] + 0.01 * values.shape[1] for values in super().quantiles_C(contexts)]


def test_what_does_not_hold_is_found():
    words = forecasters.in_words(forecasters.answers(Upside()))
    assert (words["moved or scaled"], words["first day of two"], words["cross"]) == ("other", "other", "100%")
    assert words["constant"].endswith("K off")


@pytest.mark.slow
def test_the_shipped_forecaster_by_its_own_weights():
    row = forecasters.one("shipped")
    assert row["weights"] == "its own"
    assert row["parameters_M"] == pytest.approx(0.49, abs=0.01)
    assert (row["moved or scaled"], row["mirrored"], row["constant"]) == ("same", "other", "the constant")
    assert row["finite"]
    assert 0 < row["ms"] < 1000


def test_an_unknown_model_is_refused():
    with pytest.raises(BackboneError, match="gpt: not among shipped"):
        forecasters.run_forecasters_bench(["gpt"])


def test_values_lost_here_and_there_cost_little():
    """The gap rows of the free-response bench: the same origins and truth, with a tenth or runs of four unseen."""
    t = np.arange(12 * 24 + 1.0)
    free = 18 + 2 * np.sin(2 * np.pi * t / 24) + 0.02 * np.random.default_rng(0).standard_normal(t.size)
    nothing = np.zeros(t.size - 1)
    history = Record(t * HOUR_S, free, 5 + 0 * t, 0 * t, nothing, nothing, nothing)
    source = Source("made up", "made up", history, free, context_steps=240, least_context_steps=168)
    rows = gap_rows([source], {name: build_free_response(name) for name in ("persistence", "chronos")}, 4)
    assert [(row["method"], row["values lost"]) for row in rows] == [
        (name, lost) for name in ("persistence", "chronos") for lost in ("none", "a tenth", "runs of four")
    ]
    assert len({row["mae_24h_K"] for row in rows[:3]}) == 1
    for lost in rows[4:]:
        assert lost["mae_6h_K"] < rows[3]["mae_6h_K"] + 0.05
