"""Saved models come back as they were, and nothing else is taken for one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from operators import HEAT_MAP, random_features, random_operator

from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.saved import ARRAYS_NAME, JSON_NAME, content_sha256, read_model_file, write_model_file
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model


@pytest.fixture
def model() -> ThermalModel:
    free = RcParameters(
        poles=np.array([0.5, 0.98]),
        weights=np.arange(16.0).reshape(2, 8) / 100,
        step_s=3600.0,
        process_K2=np.array([[0.0025, 1e-4], [1e-4, 1e-4]]),
        start_K2=100.0 * np.eye(2),
    )
    card = ModelCard(
        source="test",
        data={"probe": "ab" * 32},
        ranges={"T_out_C": (-3.0, 10.0)},
        scores={"rmse_K": 0.02, "unknown": float("nan")},
        uncertainty={"gain": 0.01},
        config={"order": 3},
        notes=("one", "two"),
    )
    heat = HEAT_MAP.heat
    assert heat is not None
    return ThermalModel.single(
        random_operator(1, 3, heat_input=HEAT_MAP),
        PowerModel(replace(heat, curve_W=250.0), 12.0, 0.99, "fitted"),
        free,
        card,
    )


def test_numbers_come_back_whatever_their_order_in_memory(tmp_path):
    rows = np.arange(6.0).reshape(2, 3)
    arrays = {"transposed": rows.T, "columns": np.asfortranarray(rows), "every second": np.arange(10.0)[::2]}
    write_model_file(tmp_path, {"kind": "thermal"}, arrays)
    _, back = read_model_file(tmp_path)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)


def test_a_model_comes_back_bit_for_bit(tmp_path, model):
    back = load_model(model.save(tmp_path / "model"))
    features = random_features(np.random.default_rng(0), 10)
    u = np.linspace(0, 1, 10)
    for operator in (model.only.operator, model.only.operator.resampled(900.0)):
        step = operator.step_s
        np.testing.assert_array_equal(
            forced_rollout(back.only.operator.resampled(step), np.ones(3), u, features),
            forced_rollout(operator, np.ones(3), u, features),
        )
    assert back.power == model.power
    assert back.only.free is not None
    assert model.only.free is not None
    for name in ("poles", "weights", "process_K2", "start_K2"):
        np.testing.assert_array_equal(getattr(back.only.free, name), getattr(model.only.free, name))
    assert back.only.card.ranges == model.only.card.ranges
    assert back.only.card.scores["rmse_K"] == 0.02
    assert np.isnan(back.only.card.scores["unknown"])
    assert back.only.card.notes == ("one", "two")


def test_floor_areas_come_back(tmp_path, model):
    folder = replace(model, floor_area_m2=(84.5,)).save(tmp_path / "model")
    assert load_model(folder).floor_area_m2 == (84.5,)
    assert load_model(folder).layout.floor_area_m2 == (84.5,)
    unknown = load_model(model.save(tmp_path / "unknown"))
    assert np.isnan(unknown.floor_area_m2).tolist() == [True]
    with pytest.raises(DataError, match="floor_area_m2 has 2 entries, expected 1"):
        replace(model, floor_area_m2=(10.0, 20.0))


def test_files_call_the_lowest_level_as_those_of_before_do(tmp_path):
    cools = linear_operator([0.9], [2.0], step_s=3600.0, heat_input=HeatInput(u_min=-0.6))
    folder = ThermalModel.single(cools).save(tmp_path / "model")
    assert json.loads((folder / JSON_NAME).read_text())["pairs"][0]["heat_input"]["lowest"] == -0.6
    assert load_model(folder).layout.u_min == (-0.6,)


def test_a_bare_operator_can_be_saved(tmp_path):
    model = ThermalModel.single(linear_operator([0.9], [0.1], step_s=3600.0))
    back = load_model(model.save(tmp_path / "deep" / "model"))
    assert back.only.power is None
    assert back.only.free is None


def test_same_model_same_bytes(tmp_path, model):
    for name in ("a", "b"):
        model.save(tmp_path / name)
    for file in (JSON_NAME, ARRAYS_NAME):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_nothing_is_overwritten_unless_asked(tmp_path, model):
    folder = model.save(tmp_path / "model")
    with pytest.raises(ArtifactError, match="exists already"):
        model.save(folder)
    other = ThermalModel.single(linear_operator([0.9], [0.1], step_s=3600.0))
    other.save(folder, overwrite=True)
    assert load_model(folder).only.operator.order == 1
    precious = tmp_path / "thesis"
    precious.mkdir()
    (precious / "chapter").write_text("words")
    with pytest.raises(ArtifactError, match="not a saved model"):
        model.save(precious, overwrite=True)
    assert (precious / "chapter").read_text() == "words"
    (folder / "house.csv").write_text("measured")
    with pytest.raises(ArtifactError, match=r"since house\.csv in it would be removed"):
        model.save(folder, overwrite=True)
    (folder / "house.csv").rename(folder / "fit.png")
    model.save(folder, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"model", "thesis"}, "leftovers of an unfinished write"


def _edit(folder, **changes):
    path = folder / JSON_NAME
    document = json.loads(path.read_text())
    document.update(changes)
    document["sha256"] = content_sha256(document)
    path.write_text(json.dumps(document))


def _judged() -> ThermalModel:
    """A model with what identification writes of it."""
    operator = linear_operator([0.9], [0.4], step_s=3600.0)
    known = {f"step_response_{h}h_K": 4.0 * (1.0 - 0.9**h) for h in (1, 8, 24)}
    scores = tuple(HorizonScore(hours, 0.2, 0.5, 0.4, 3.0, 9) for hours in (1.0, 6.0))
    verdict = Competence(True, horizons=scores, effect_K=known["step_response_8h_K"], effect_sd_K=0.2)
    return ThermalModel.single(operator, card=ModelCard(source="probing", uncertainty=known, competence=verdict))


def _verdict(**changes) -> Callable[[dict, dict], None]:
    return lambda content, arrays: content["actuators"][0]["card"]["competence"].update(changes)


def _gains(factor: float) -> Callable[[dict, dict], None]:
    return lambda content, arrays: arrays.update({"pair.0.0.gains": factor * arrays["pair.0.0.gains"]})


def _of_card(**changes) -> Callable[[dict, dict], None]:
    return lambda content, arrays: content["actuators"][0]["card"].update(changes)


def _hours(*told) -> Callable[[dict, dict], None]:
    return _of_card(hour_effects=[[float(day * 86400), *told] for day in (10, 11)])


def _no_card(content: dict, arrays: dict) -> None:
    _gains(1e6)(content, arrays)
    content["actuators"][0]["card"] |= {"competence": None, "uncertainty": {}}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (_gains(1e6), "8 h at full level change the zone by 2.278e\\+06 K"),
        (_no_card, "at most 300 are plausible"),
        (_gains(1.2), "step_response_1h_K is 0.4, by its arrays 0.48"),
        (_gains(-1.0), "gains .* of sign|wrong sign"),
        (_verdict(effect_K=9.0), "its verdict is on an effect of 9 K"),
        (_verdict(effect_sd_K=3.0), "its effect is known to ± 132 % only"),
        (_verdict(reasons=["too weak"]), "is not, since too weak"),
        (_verdict(horizons=[]), "its error 1 h ahead is nan K"),
        (_hours(-1.0, 1.2, 0.0), "hour_effects: .*a promise above 0"),
        (_hours(-1.0, 1.2, None), "hour_effects: .*all finite"),
        (_hours(None, 1.2, 0.2), "hour_effects: .*all finite"),
        (_hours(-1.0, 1.2), "zip|4 values|shorter"),
        (_of_card(blocked_hours=[24]), "24 is no hour of the day"),
        (_of_card(blocked_cooling_hours=[-1]), "-1 is no hour of the day"),
        (_of_card(ranges={"T_out_C": [None, None]}), "ranges: T_out_C"),
        (_of_card(ranges={"u": [1.0, 0.0]}), "ranges: u"),
    ],
)
def test_a_card_is_not_believed_where_its_arrays_or_its_own_numbers_say_otherwise(tmp_path, edit, message):
    """All hashes are right, as in a file that somebody made."""
    assert load_model(_judged().save(tmp_path / "true")).only.card.unfit == ""
    content, arrays = read_model_file(tmp_path / "true")
    edit(content, arrays)
    write_model_file(tmp_path / "made", content, arrays)
    with pytest.raises(ArtifactError, match=message):
        load_model(tmp_path / "made")


def test_damage_is_named(tmp_path, model):
    folder = model.save(tmp_path / "model")
    arrays = folder / ARRAYS_NAME
    raw = bytearray(arrays.read_bytes())
    raw[-1] ^= 1
    arrays.write_bytes(bytes(raw))
    with pytest.raises(ArtifactError, match=rf"{ARRAYS_NAME}.*sha256"):
        load_model(folder)
    arrays.unlink()
    with pytest.raises(ArtifactError, match=rf"{ARRAYS_NAME}.*cannot be read"):
        load_model(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something else"}, "not a model of thermoforce-mpc"),
        ({"version": 99}, "version 99.*from the same data$"),
        ({"version": 8, "code_version": "0.0.9"}, r"data, or use thermoforce-mpc 0\.0\.9, which wrote it$"),
        ({"pairs": [{}]}, "missing"),
        ({"pairs": None}, "model.json"),
        ({"actuators": [{"name": "x", "home": 0, "machine": 0, "share": 0, "card": {"source": "x"}}]}, "missing"),
    ],
)
def test_foreign_or_edited_json_is_refused(tmp_path, model, changes, message):
    folder = model.save(tmp_path / "model")
    _edit(folder, **changes)
    with pytest.raises(ArtifactError, match=message):
        load_model(folder)


def test_an_edited_sign_fails_at_load(tmp_path, model):
    folder = model.save(tmp_path / "model")
    document = json.loads((folder / JSON_NAME).read_text())
    _edit(folder, pairs=[document["pairs"][0] | {"sign": -1}])
    with pytest.raises(ArtifactError, match="gains"):
        load_model(folder)


def test_missing_and_unreadable_folders(tmp_path):
    with pytest.raises(ArtifactError, match="no such folder"):
        load_model(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ArtifactError, match=JSON_NAME):
        load_model(tmp_path / "empty")
    (tmp_path / "empty" / JSON_NAME).write_text("{")
    with pytest.raises(ArtifactError, match="not valid JSON"):
        load_model(tmp_path / "empty")


def test_an_operator_without_effect_is_not_saved(tmp_path):
    with pytest.raises(ArtifactError, match="certificate"):
        ThermalModel.single(linear_operator([0.9], [0.0], step_s=3600.0)).save(tmp_path / "model")
    assert not (tmp_path / "model").exists()
