"""Models saved in older file formats, by the code of that time, are rewritten, or refused with what to do.

stored_models/ holds the model of `test_model_file` as the revisions before c8da736 (version 2), 7783019 (version 3) and
9058fcb (version 4) saved it.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from operators import HEAT_MAP, random_features, random_operator

from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.model.migration import migrate_model
from thermoforce_mpc.model.operator import forced_rollout
from thermoforce_mpc.model.saved.model_file import ARRAYS_NAME, JSON_NAME
from thermoforce_mpc.model.thermal_model import load_model

STORED = Path(__file__).parent / "stored_models"


@pytest.mark.parametrize("version", ["v2", "v3", "v4"])
def test_an_older_model_predicts_as_it_did(tmp_path, version):
    with pytest.raises(ArtifactError, match=rf"format version {version[1]}, this release reads 5; .*tf-mpc migrate"):
        load_model(STORED / version)
    done = CliRunner().invoke(cli, ["migrate", str(STORED / version), "--out", str(tmp_path / "new")])
    assert done.exit_code == 0, done.output
    model = load_model(tmp_path / "new").only
    features = random_features(np.random.default_rng(0), 10)
    u = np.linspace(0, 1, 10)
    np.testing.assert_array_equal(
        forced_rollout(model.operator, np.ones(3), u, features),
        forced_rollout(random_operator(1, 3, heat_input=HEAT_MAP), np.ones(3), u, features),
    )
    assert model.power is not None
    assert model.power.load == HEAT_MAP.heat
    assert (model.power.rmse_W, model.power.r2, model.power.source) == (12.0, 0.99, "fitted")
    assert model.free is not None
    np.testing.assert_array_equal(model.free.weights, np.arange(16.0).reshape(2, 8) / 100)
    assert model.card.notes == ("one", "two")
    assert model.card.competence is None


@pytest.fixture
def old(tmp_path) -> Path:
    return Path(shutil.copytree(STORED / "v3", tmp_path / "old"))


def _edit(folder: Path, **changes: object) -> None:
    document = json.loads((folder / JSON_NAME).read_text())
    (folder / JSON_NAME).write_text(json.dumps(document | changes))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"version": 1}, "migrates from 2 on; identify again from the same data, or use thermoforce-mpc 0.1.0"),
        ({"version": 99, "code_version": "7.0"}, "thermoforce-mpc 7.0 wrote it: pip install --upgrade"),
        ({"version": "3"}, "format version '3'"),
        ({"version": True}, "format version True"),
        ({"format": "something else"}, "not a model of thermoforce-mpc"),
        ({"pairs": [{}]}, "missing"),
        ({"actuators": 3}, "damaged or edited"),
        ({"version": 2}, "damaged or edited"),
        ({"arrays_sha256": "0" * 64}, f"{ARRAYS_NAME}: damaged or swapped"),
    ],
)
def test_what_cannot_be_migrated_is_refused_with_what_to_do(old, tmp_path, changes, told):
    _edit(old, **changes)
    with pytest.raises(ArtifactError, match=told):
        migrate_model(old, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_edited_sign_fails_its_certificate(old, tmp_path):
    document = json.loads((old / JSON_NAME).read_text())
    _edit(old, pairs=[document["pairs"][0] | {"sign": -1}])
    with pytest.raises(ArtifactError, match="gains"):
        migrate_model(old, tmp_path / "new")


def test_the_power_of_a_shared_machine_is_not_carried_over(old, tmp_path):
    document = json.loads((old / JSON_NAME).read_text())
    valve = document["actuators"][0]
    _edit(old, actuators=[valve, valve | {"name": "other"}])
    with pytest.raises(ArtifactError, match=r"model\.json: machine 'machine' feeds several actuators.*identify again"):
        migrate_model(old, tmp_path / "new")


def test_an_edited_model_with_a_hash_is_refused(tmp_path):
    old = Path(shutil.copytree(STORED / "v4", tmp_path / "old"))
    _edit(old, n_trained=7)
    with pytest.raises(ArtifactError, match="damaged or edited"):
        migrate_model(old, tmp_path / "new")


def test_nothing_is_overwritten_and_nothing_done_twice(old, tmp_path):
    with pytest.raises(ArtifactError, match="exists already"):
        migrate_model(old, old)
    migrate_model(old, tmp_path / "new")
    with pytest.raises(ArtifactError, match="nothing to migrate"):
        migrate_model(tmp_path / "new", tmp_path / "newer")
