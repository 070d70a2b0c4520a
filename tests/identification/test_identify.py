"""Identification finds what is known, refuses what cannot be known, and does so twice alike."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from houses import House, effect_rmse, make_pair, record
from threadpoolctl import threadpool_info, threadpool_limits

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification import IdentificationConfig, Pair, identify
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.scenario.settings import validate

HOUSE = House()
LINEAR = IdentificationConfig(order=3, modulation="linear", sun_on_sensor=False, late_sensor=False)
QUICK = IdentificationConfig(epochs=40, sun_on_sensor=False, late_sensor=False)


def test_three_days_of_one_run_tell_what_an_action_does():
    model = identify([record(HOUSE, 3.0, noise_K=0.01)], config=LINEAR, floor_area_m2=190.0)
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.08 * effect
    assert max(score.model_K for score in model.only.card.competence.horizons) < 0.5
    assert model.only.free is not None
    assert model.only.power is not None
    np.testing.assert_allclose(model.only.power(np.array([0.0, 1.0]), 5.0), [0, 3600], rtol=0.02)


@pytest.mark.slow
def test_steps_in_which_a_window_was_open_are_on_the_card():
    seen = record(HOUSE, 3.0, noise_K=0.01)
    T, days = np.array(seen.T_zone_C), 3
    for k in np.flatnonzero(np.isclose(seen.time_s % 86_400.0, 7.5 * 3600.0)):
        T[:, k:] -= 1.5 * np.exp(-(seen.time_s[k:] - seen.time_s[k]) / 3600.0)
    opened, off = replace(seen, T_zone_C=T), LINEAR.model_copy(update={"air_through_windows": False})
    for one, config, aired in ((opened, LINEAR, days), (opened, off, 0), (seen, LINEAR, 0)):
        model = identify([one], config=config, floor_area_m2=190.0)
        told = re.search(r"in (\d+) steps? air came in, as through a window", " ".join(model.only.card.notes))
        assert (int(told[1]) if told else 0) == pytest.approx(aired, abs=2 * (aired > 0))
        assert sum("air came in" in claim for claim in model.claims) == bool(aired)


@pytest.mark.slow
def test_blas_computes_on_one_thread_and_then_as_before():
    def threads(_=""):
        counts.append({one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"})

    counts: list[set[int]] = []
    with threadpool_limits(2, user_api="blas"):
        threads()
        identify([record(HOUSE, 1.0, 3600.0)], config=LINEAR, progress=threads)
        threads()
    first, *during, last = counts
    assert first == last
    assert during
    assert all(found == {1} for found in during)


@pytest.mark.slow
def test_without_priors_of_the_building_thirty_days_are_enough():
    record_ = record(HOUSE, 20.0, 3600.0, noise_K=0.01)
    model = identify([record_], config=LINEAR)  # no floor area: weak priors
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.05 * effect


@pytest.mark.slow
def test_pairs_find_time_constants_and_gains():
    pairs = [make_pair(HOUSE, seed) for seed in range(6)]
    model = identify(pairs=pairs, config=LINEAR, floor_area_m2=190.0)
    found = model.only.operator.time_constants_h
    np.testing.assert_allclose(found, HOUSE.tau_h, rtol=0.15)  # the prior is centred at 50 h
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.01 * effect
    assert model.only.free is None


@pytest.mark.slow
def test_by_itself_an_operator_has_three_modes():
    """A house with fewer has the same effect, with modes that are not needed."""
    pairs = [make_pair(HOUSE, seed) for seed in range(3)]
    model = identify(pairs=pairs, config=IdentificationConfig(modulation="linear"), floor_area_m2=190.0)
    assert model.only.operator.order == 3
    assert not any(name.startswith("held_out_order") for name in model.only.card.scores)
    simple = House(tau_h=(0.001, 3.0, 25.0), gain_K=(0.0, 15.0))
    model = identify(
        pairs=[make_pair(simple, seed) for seed in range(3)], config=IdentificationConfig(modulation="linear")
    )
    assert model.only.operator.order == 3
    rmse, effect = effect_rmse(model, simple)
    assert rmse < 0.05 * effect


@pytest.mark.slow
def test_feedback_does_not_turn_the_effect_around():
    """A thermostat heats when it is cold: the naive regression of eq:arx on all data sees little or nothing."""
    step_s, days = 900.0, 4.0
    n = round(days * 96)
    u = np.zeros(n)
    for _ in range(30):  # fixed point of the loop thermostat -> temperature -> thermostat, hour by hour
        T = record(HOUSE, days, step_s, seed=3, u=u).T_zone_C[0]
        wanted = np.repeat((T[:-1:4] < 19.0) * 1.0, 4)
        wrong = np.flatnonzero(wanted != u)
        if wrong.size == 0:
            break
        u = np.concatenate([wanted[: wrong[0] + 4], u[wrong[0] + 4 :]])
    loop = record(HOUSE, days, step_s, seed=3, u=u, noise_K=0.01)
    model = identify([loop], config=LINEAR, floor_area_m2=190.0)
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.2 * effect


@pytest.mark.slow
def test_cooling_has_a_negative_effect():
    house = replace(HOUSE, sign=-1)
    model = identify([record(house, 3.0)], config=LINEAR, mode="cooling", floor_area_m2=190.0)
    assert model.only.operator.sign == -1
    assert certificate(model.only.operator).effect_high_K[3] < 0
    rmse, effect = effect_rmse(model, house)
    assert rmse < 0.05 * effect


@pytest.mark.slow
def test_the_wrong_sign_is_noticed():
    with pytest.raises(DataError, match="no effect of the actuator with the sign of cooling"):
        identify([record(HOUSE, 3.0, heat_measured=False)], config=LINEAR, mode="cooling")


@pytest.mark.slow
def test_u_itself_drives_where_heat_is_not_measured():
    model = identify([record(HOUSE, 3.0, heat_measured=False)], config=LINEAR)
    assert model.only.operator.heat_input.heat is None
    assert any("heat was measured in 0 %" in note for note in model.only.card.notes)


@pytest.mark.slow
def test_the_network_learns_what_the_linear_gain_cannot():
    """Without a heat capacity the gain depends on T_out; m(x) must find that, held out days must gain from it."""
    house = replace(HOUSE, slope_per_K=0.06, machine_W=(0.0, 10000.0))
    pairs = [make_pair(house, seed) for seed in range(8)]
    results = {
        kind: identify(pairs=pairs, config=IdentificationConfig(order=3, modulation=kind, heat_input="identity"))
        for kind in ("linear", "auto")
    }
    assert results["auto"].only.card.scores["modulation_kept"] == 1.0
    rmse = {kind: effect_rmse(model, house)[0] for kind, model in results.items()}
    assert rmse["auto"] < 0.6 * rmse["linear"], rmse
    assert certificate(results["auto"].only.operator).certified


@pytest.mark.slow
def test_order_one_on_u_is_the_papers_operator():
    model = identify(
        [record(HOUSE, 3.0)],
        config=IdentificationConfig(order=1, heat_input="identity", epochs=20, sun_on_sensor=False, late_sensor=False),
    )
    assert model.only.operator.n_trained == 195
    assert model.only.operator.heat_input.heat is None
    assert model.only.operator.gamma == 0.75


@pytest.mark.slow
def test_step_of_the_model_is_the_one_asked_for():
    model = identify([record(HOUSE, 2.0)], config=LINEAR, step_s=3600.0)
    assert model.only.operator.step_s == 3600.0
    assert model.only.free is not None
    assert model.only.free.step_s == 3600.0


@pytest.mark.slow
def test_silent_sensor_in_between_is_left_out():
    history = record(HOUSE, 3.0, noise_K=0.01)
    T = np.array(history.T_zone_C[0])
    T[60:90] = np.nan
    T[0] = np.nan
    model = identify([replace(history, T_zone_C=T)], config=QUICK, floor_area_m2=190.0)
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.08 * effect


@pytest.mark.slow
def test_same_data_same_bytes(tmp_path):
    for name in ("a", "b"):
        identify([record(HOUSE, 2.0)], config=QUICK, floor_area_m2=190.0).save(tmp_path / name)
    for file in sorted(path.name for path in (tmp_path / "a").iterdir()):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.slow
def test_runs_and_pairs_go_together():
    model = identify([record(HOUSE, 2.0, 3600.0)], [make_pair(HOUSE, 4)], config=LINEAR, floor_area_m2=190.0)
    assert len(model.only.card.data) == 3
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.05 * effect


def _changed(**arrays) -> Record:
    history = record(HOUSE, 2.0)
    return replace(history, **{k: v(np.array(getattr(history, k))) for k, v in arrays.items()})


def _at(index, value):
    def put(array):
        array[..., index] = value
        return array

    return put


@pytest.mark.parametrize(
    ("history", "words"),
    [
        (lambda: record(HOUSE, 0.5), r"0\.50 days.*need at least 0\.9"),
        (lambda: record(HOUSE, 2.0, u=np.full(192, 0.4)), r"u is constant at 0\.4.*probe"),
        (lambda: record(HOUSE, 2.0, u=np.repeat([0.0, 1.0], 96)), r"too little excitation.*1 changes of u"),
        (lambda: _changed(T_zone_C=lambda T: np.full_like(T, np.nan)), "no zone temperature is known"),
        (lambda: _changed(T_zone_C=_at(slice(0, 120), np.nan)), "only .* of the zone temperatures"),
        (lambda: _changed(T_out_C=_at(slice(None), np.nan)), "u and the weather were never measured together"),
        (lambda: _changed(u=_at(slice(5, 110), np.nan)), r"run, 5 steps between gaps: 0\.05 days of data"),
        (
            lambda: _changed(u=lambda u: 100 * u),
            r"u at \d+ of 192 .* \(first \d+ .*too many for sensor faults: check the unit",
        ),
        (lambda: _changed(T_zone_C=lambda T: T + 273.15), "T_zone_C at 193 of 193 places .* check the unit"),
        (lambda: _changed(time_s=_at(5, 1728000.0)), r"time_s goes from .* \(index 4\)"),
    ],
)
def test_data_that_cannot_identify_are_refused_with_numbers(history, words):
    with pytest.raises(DataError, match=words):
        identify([history()], config=LINEAR)


def _with_gaps(**places: tuple[slice, ...]) -> Record:
    history = record(HOUSE, 4.0, noise_K=0.01)
    values = {signal: np.array(getattr(history, signal)) for signal in places}
    for signal, gaps in places.items():
        for gap in gaps:
            values[signal][..., gap] = np.nan
    return replace(history, **values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gaps", "said"),
    [
        (
            {
                "T_out_C": (slice(50, 51), slice(200, 220)),
                "solar_W_m2": (slice(100, 120),),
                "u": tuple(slice(k, k + 1) for k in range(7, 384, 20)),
            },
            r"run: bridged T_out_C: 21 values by linear interpolation, solar_W_m2: 20 values by linear interpolation, "
            r"u: 19 values \(4\.9 %\) between the levels around",
        ),
        ({"T_out_C": (slice(150, 200),)}, "run: gaps in u or in the weather divide it into 2 pieces"),
        ({"u": (slice(20, 30), slice(180, 190))}, r"run: left out: run, 20 steps between gaps: 0\.21 days"),
        ({"u": (slice(0, 70), slice(300, None))}, "run: 154 of 384 steps without level or weather left out"),
    ],
    ids=["short gaps and single levels", "long gap outdoors", "unknown levels", "no start and no end"],
)
def test_gaps_of_a_record_are_bridged_or_left_out_and_the_card_says_so(gaps, said):
    model = identify([_with_gaps(**gaps)], config=LINEAR, floor_area_m2=190.0)
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.1 * effect
    assert any(re.match(said, note) for note in model.only.card.notes), model.only.card.notes


@pytest.mark.slow
def test_the_weather_of_pairs_is_bridged_and_their_unknown_levels_are_refused():
    pairs = [make_pair(HOUSE, seed) for seed in range(3)]
    holed = [Pair(*(_holed(h, "T_out_C") for h in (p.a, p.b)), label=p.label) for p in pairs]
    rmse, effect = effect_rmse(identify(pairs=holed, config=LINEAR, floor_area_m2=190.0), HOUSE)
    assert rmse < 0.05 * effect
    with pytest.raises(DataError, match=r"pair 0 \(second run\): u is not finite at 1 of 38 places, first at 9"):
        identify(pairs=[Pair(pairs[0].a, _holed(pairs[0].b, "u"), label="0")], config=LINEAR)


def _holed(history: Record, signal: str) -> Record:
    return replace(history, **{signal: _at(9, np.nan)(np.array(getattr(history, signal)))})


@pytest.mark.slow
def test_one_absurd_reading_of_each_signal_is_not_believed():
    history, absurd = record(HOUSE, 4.0, noise_K=0.01), {"heat_W": 1e7, "power_W": 1e9, "T_zone_C": 85.0, "u": 1.4}
    for place, (signal, value) in zip((80, 160, 240, 320), absurd.items(), strict=True):
        history = replace(history, **{signal: _at(place, value)(np.array(getattr(history, signal)))})
    model = identify([history], config=LINEAR, floor_area_m2=190.0)
    rmse, effect = effect_rmse(model, HOUSE)
    assert rmse < 0.1 * effect
    assert model.only.power is not None
    np.testing.assert_allclose(model.only.power(np.array([0.0, 1.0]), 5.0), [0, 3600], rtol=0.02)
    for signal in absurd:
        assert any(note.startswith(f"run: {signal} at 1 of") for note in model.only.card.notes), signal


def test_nothing_is_refused_too():
    with pytest.raises(DataError, match="nothing to identify from"):
        identify()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mode": "cool"}, "mode is 'cool': expected heating, cooling or both"),
        ({"floor_area_m2": 0.0}, "floor_area_m2 is 0 m²: it must be above 0"),
        ({"floor_area_m2": -50.0}, "floor_area_m2 is -50 m²: it must be above 0"),
    ],
)
def test_a_wrong_mode_or_area_is_refused(options, words):
    with pytest.raises(DataError, match=words):
        identify([record(HOUSE, 2.0)], config=LINEAR, **options)


def test_records_of_different_steps_are_refused():
    with pytest.raises(DataError, match=r"steps of 900, 3600 s"):
        identify([record(HOUSE, 2.0), record(HOUSE, 3.0, 3600.0, seed=5)], config=LINEAR)


def test_pairs_must_be_pairs():
    pair = make_pair(HOUSE, 1)
    with pytest.raises(DataError, match="T_out_C differs"):
        Pair(pair.a, replace(pair.b, T_out_C=pair.b.T_out_C + 1))
    with pytest.raises(DataError, match=r"0\.500 K apart"):
        Pair(pair.a, replace(pair.b, T_zone_C=pair.b.T_zone_C[0] + 0.5))
    with pytest.raises(DataError, match=r"differs by at most 0\.000"):
        identify(pairs=[Pair(pair.a, pair.a)])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "two_stage", "order": 2}, "is of order 1, but order is 2"),
        ({"time_constants_h": [1.0, 3.0]}, "time_constants_h"),
        ({"gama": 0.5}, "gamma"),
    ],
)
def test_options_are_checked(options, words):
    with pytest.raises(ConfigError, match=words):
        validate(IdentificationConfig, options, "options")


@pytest.mark.slow
def test_the_operator_has_the_modes_that_were_asked_for():
    assert [IdentificationConfig(order=order).modes for order in ("auto", 1, 2, 3)] == [3, 1, 2, 3]
    assert IdentificationConfig(method="two_stage").modes == 1
    model = identify(
        [record(HOUSE, 2.0)],
        config=IdentificationConfig(order=2, modulation="linear", sun_on_sensor=False, late_sensor=False),
    )
    assert model.only.operator.order == 2


@pytest.mark.slow
def test_features_of_the_total_temperature_are_certified_or_refused():
    house = replace(HOUSE, slope_per_K=0.06, machine_W=(0.0, 10000.0))
    pairs = [make_pair(house, seed) for seed in range(4)]

    def found(**options):
        config = IdentificationConfig(
            order=1, heat_input="identity", feedback=True, epochs=60, sun_on_sensor=False, late_sensor=False, **options
        )
        return identify(pairs=pairs, config=config)

    model = found(gamma=0.3)
    assert model.only.operator.feedback
    assert model.only.operator.feedback_active == bool(model.only.card.scores["modulation_kept"])
    assert certificate(model.only.operator).certified
    linear = identify(pairs=pairs, config=replace_config(LINEAR, feedback=True))
    assert not linear.only.operator.feedback_active


def replace_config(config: IdentificationConfig, **changes) -> IdentificationConfig:
    return config.model_copy(update=changes)


@pytest.mark.slow
def test_an_operator_that_cannot_be_proven_is_refused(monkeypatch):
    """Training does not usually end there, so the network is swapped for one that does."""
    from thermoforce_mpc.identification import modulation

    trained = modulation.train

    def steep(*args, **kwargs):
        result = trained(*args, **kwargs)
        weights = np.zeros_like(result.hidden_weight)
        weights[:, 0] = 40.0
        return replace(result, hidden_weight=weights, output_weight=np.full(32, -10.0))

    monkeypatch.setattr(modulation, "train", steep)
    config = IdentificationConfig(
        order=1, feedback=True, modulation="always", epochs=2, sun_on_sensor=False, late_sensor=False
    )
    with pytest.raises(DataError, match=r"not certified: the modulation depends on .* per K"):
        identify(pairs=[make_pair(HOUSE, seed) for seed in range(3)], config=config)
