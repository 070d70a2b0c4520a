"""Saved models: a changed one is refused by its hash, and one made to deceive ends in a named error."""

from __future__ import annotations

import json
import pickle
import re

import numpy as np
import pytest
from fuzzing import fuzz, mutated, result_or_error, tampered
from hypothesis import given
from hypothesis import strategies as st
from operators import HEAT_MAP, random_operator

from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel, ReturnWater
from thermoforce_mpc.model.saved import ARRAYS_NAME, JSON_NAME, read_model_file, write_model_file
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    card = ModelCard(
        source="test",
        data={"probe": "ab" * 32},
        ranges={"T_out_C": (-3.0, 10.0)},
        scores={"rmse_K": 0.02},
        config={"order": 3},
        notes=("one",),
        competence=Competence(False, ("x",), (), (HorizonScore(1.0, 0.1, 0.2, 0.3, 2.0, 9),), 1.0, 0.1, 1.0, 0.5, 24.0),
    )
    free = RcParameters(np.array([0.5, 0.98]), np.ones((2, 8)), 3600.0, np.diag([0.0025, 1e-4]), np.eye(2))
    assert HEAT_MAP.heat is not None
    power = PowerModel(HEAT_MAP.heat, 12.0, 0.99, "fitted", ReturnWater(0.01, 30.0, (20.0, 45.0), 8.0), HEAT_MAP.heat)
    model = ThermalModel.single(random_operator(1, 3, heat_input=HEAT_MAP), power, free, card)
    return model.save(tmp_path_factory.mktemp("model") / "model")


def refused_or_whole(folder):
    """Whether the folder was refused by a named error of moderate length; what is taken can be saved again."""
    model = result_or_error(ArtifactError, lambda: load_model(folder), names=str(folder))
    if model is not None:
        model.save(folder, overwrite=True)
    return model is None


def test_a_model_is_made_of_json_and_safetensors_only(folder):
    assert {path.name for path in folder.iterdir()} == {JSON_NAME, ARRAYS_NAME}
    json.loads((folder / JSON_NAME).read_text())
    header = int.from_bytes((folder / ARRAYS_NAME).read_bytes()[:8], "little")
    assert json.loads((folder / ARRAYS_NAME).read_bytes()[8 : 8 + header])


def test_a_pickle_in_its_place_is_not_run(folder, tmp_path):
    class Bomb:
        def __reduce__(self):
            return (tmp_path.joinpath("run").write_text, ("x",))

    other = tmp_path / "model"
    content, _ = read_model_file(folder)
    write_model_file(other, {key: content[key] for key in ("zones", "pairs")}, {})
    (other / ARRAYS_NAME).write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ArtifactError, match="sha256"):
        load_model(other)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("number", range(0, 40, 3))
def test_any_edit_of_a_number_or_a_word_is_refused_by_the_hash(folder, tmp_path, number):
    text = (folder / JSON_NAME).read_text()
    # What says which file it is has its own message.
    words = [m for m in re.finditer(r"(?<=: )(-?[\d.]+|true|false|\"\w+\")", text) if m.start() > text.index("arrays")]
    word = words[number * len(words) // 40]
    other = {"true": "false", "false": "true"}.get(word[0], '"edited"' if word[0].startswith('"') else "0.123")
    (tmp_path / ARRAYS_NAME).write_bytes((folder / ARRAYS_NAME).read_bytes())
    (tmp_path / JSON_NAME).write_text(text[: word.start()] + other + text[word.end() :])
    with pytest.raises(ArtifactError, match=r"edited|sha256"):
        load_model(tmp_path)


def test_another_layout_of_the_same_content_is_the_same_model(folder, tmp_path):
    (tmp_path / ARRAYS_NAME).write_bytes((folder / ARRAYS_NAME).read_bytes())
    (tmp_path / JSON_NAME).write_text(json.dumps(json.loads((folder / JSON_NAME).read_text())))
    load_model(tmp_path)


@pytest.mark.parametrize("name", [JSON_NAME, ARRAYS_NAME])
def test_bytes_that_were_changed_are_refused(folder, tmp_path, name):
    files = {path.name: path.read_bytes() for path in folder.iterdir()}

    @fuzz(60)
    @given(content=mutated(files[name]))
    def check(content):
        for file, original in files.items():
            (tmp_path / file).write_bytes(content if file == name else original)
        same = name == ARRAYS_NAME and content == files[name]
        assert refused_or_whole(tmp_path) or same or name == JSON_NAME

    check()


@pytest.mark.slow
def test_a_document_made_to_deceive_is_refused_or_a_model(folder, tmp_path):
    content, arrays = read_model_file(folder)
    kept = {key: content[key] for key in ("zones", "actuators", "machines", "exclusive", "n_trained", "pairs")}
    taken = 0

    @fuzz(150)
    @given(document=tampered(kept))
    def check(document):
        nonlocal taken
        try:
            write_model_file(tmp_path / "model", document if isinstance(document, dict) else {}, arrays)
        except (ValueError, UnicodeEncodeError):
            return  # a key that no JSON file can hold
        taken += not refused_or_whole(tmp_path / "model")

    check()
    assert taken, "a tampered label or score leaves a model"


ODD = st.sampled_from(
    [np.nan, np.inf, 1e308, -1.0, 0.0, np.zeros(0), np.zeros((2, 2)), np.zeros(3, dtype=np.int64), np.array(True),
     np.zeros(2000), np.full(3, 0.5, dtype=np.float16), np.zeros(3, dtype=np.complex64)]
)  # fmt: skip


def test_arrays_made_to_deceive_are_refused_or_a_model(folder, tmp_path):
    content, arrays = read_model_file(folder)
    kept = {key: content[key] for key in ("zones", "actuators", "machines", "exclusive", "n_trained", "pairs")}

    @fuzz(60)
    @given(name=st.sampled_from(sorted(arrays)), odd=ODD)
    def check(name, odd):
        array = np.full_like(arrays[name], odd) if isinstance(odd, float) else odd
        write_model_file(tmp_path / "model", kept, arrays | {name: array})
        refused_or_whole(tmp_path / "model")

    check()


def test_a_verdict_is_true_or_false_and_nothing_else(folder, tmp_path):
    content, arrays = read_model_file(folder)
    content["actuators"][0]["card"]["competence"]["competent"] = "false"
    write_model_file(tmp_path / "model", content, arrays)
    with pytest.raises(ArtifactError, match="'false' where true or false is expected"):
        load_model(tmp_path / "model")
