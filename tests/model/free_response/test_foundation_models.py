"""Foundation models by name, directory and hub name: what each is told, what it reads, and why one cannot be used."""

from __future__ import annotations

import importlib.util
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from later import Later, safetensors_torch, torch

from thermoforce_mpc.data.series import interpolated
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones import known
from thermoforce_mpc.model.free_response.backbones.base import Backbone, Context
from thermoforce_mpc.model.free_response.backbones.loading import load_backbone

# Of what the packages themselves warn.
pytestmark = pytest.mark.filterwarnings("ignore")
OF_NAME = {model.name: model for model in known.KNOWN}
foundation_models = Later("foundation_models")


@pytest.fixture
def anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Python and a torch that all models work with."""
    monkeypatch.setattr(known, "python_version", lambda: "3.12.1")
    monkeypatch.setattr(known, "version", lambda package: "2.11.0")


@pytest.fixture(params=[one.name for one in known.KNOWN if one.extra and one.checkpoint])
def model(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, anywhere: None
) -> tuple[str, Path]:
    """A name and a folder with tiny random weights of that family."""
    torch.manual_seed(0)
    folder = tmp_path / "model"
    folder.mkdir()
    foundation_models.MAKERS[request.param](folder, monkeypatch)
    return request.param, folder


def context(known_steps: int, ahead: int, *, seed: int = 0, warmer_K: float = 0.0, offset_K: float = 0.0) -> Context:
    rng = np.random.default_rng(seed)
    free = 21.0 + offset_K + np.sin(np.arange(known_steps) * 2 * np.pi / 24) + 0.1 * rng.standard_normal(known_steps)
    free[[2, 7, -3]] = np.nan
    return Context(free, rng.standard_normal((known_steps, 3)), rng.standard_normal((ahead, 3)) + warmer_K)


def quantiles(backbone: Backbone, *contexts: Context) -> list[np.ndarray]:
    with torch.inference_mode():
        return backbone.quantiles_C(contexts)


def test_quantiles_of_any_length_and_horizon_alone_and_together(model: tuple[str, Path]) -> None:
    """Gaps, contexts longer than the model reads, and horizons that it must unroll."""
    backbone = load_backbone(str(model[1]))
    contexts = [context(241, 24), context(100, 24), context(241, 24, seed=1), context(300, 90), context(30, 5)]
    together = quantiles(backbone, *contexts)
    for one, values in zip(contexts, together, strict=True):
        assert values.shape == (9, len(one.ahead_weather))
        assert np.isfinite(values).all()
        np.testing.assert_allclose(values, quantiles(backbone, one)[0], atol=1e-4)
        assert abs(values[4].mean() - 21.0) < 5.0
    assert np.abs(together[0] - together[2]).max() > 1e-3


def test_the_zero_of_the_scale_does_not_matter(model: tuple[str, Path]) -> None:
    backbone = load_backbone(str(model[1]))
    low, high = quantiles(backbone, context(200, 70), context(200, 70, offset_K=-30.0))
    np.testing.assert_allclose(high + 30.0, low, atol=1e-3)


def test_the_weather_is_read_by_those_that_say_so(model: tuple[str, Path]) -> None:
    name, folder = model
    backbone = load_backbone(str(folder))
    cold, mild = quantiles(backbone, context(200, 24), context(200, 24, warmer_K=5.0))
    assert (np.abs(cold - mild).max() > 1e-3) == (OF_NAME[name].covariates == known.WEATHER)


def test_weights_are_frozen_and_all_of_them_from_the_file(model: tuple[str, Path], tmp_path: Path) -> None:
    _, folder = model
    backbone = load_backbone(str(folder))
    assert not any(parameter.requires_grad for module in backbone.modules for parameter in module.parameters())
    weights = safetensors_torch.load_file(folder / "model.safetensors")
    less = Path(shutil.copytree(folder, tmp_path / "less"))
    lost = sorted(weights)[-1]
    safetensors_torch.save_file(
        {name: value for name, value in weights.items() if name != lost}, less / "model.safetensors"
    )
    with pytest.raises(BackboneError, match=r"less"):
        load_backbone(str(less))


def test_a_name_stands_for_a_model_of_the_hub(
    model: tuple[str, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """From the cache of the hub's library without asking the hub, as the revision that the name stands for."""
    name, folder = model
    in_cache(OF_NAME[name].checkpoint, folder, tmp_path / "cache", monkeypatch)
    assert load_backbone(name).label == f"{load_backbone(str(folder)).label}".replace(str(folder), name)


def test_a_hub_name_is_taken_from_the_cache(bolt_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    in_cache("somebody/bolt@v2", bolt_folder, tmp_path / "cache", monkeypatch)
    assert load_backbone("somebody/bolt@v2").label == "Chronos-Bolt 'somebody/bolt@v2'"
    with pytest.raises(BackboneError, match="'somebody/bolt' is not in the local cache and HF_HUB_OFFLINE is set"):
        load_backbone("somebody/bolt")


def in_cache(checkpoint: str, folder: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lay a model out as `huggingface_hub` does, and go offline."""
    name, _, revision = checkpoint.partition("@")
    home, commit = cache / f"models--{name.replace('/', '--')}", "a" * 40
    (home / "refs").mkdir(parents=True)
    (home / "refs" / (revision or "main")).write_text(commit)
    shutil.copytree(folder, home / "snapshots" / commit)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(cache))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tirex-2", r"not installed: pip install 'thermoforce-mpc\[tirex-2\]'"),
        ("timesfm", r"not installed: pip install 'thermoforce-mpc\[timesfm\]'"),
        ("toto-2", r"needs Python >=3\.12, this is 3\.11\.4"),
        ("ttm", r"needs torch >=2\.10,<2\.12, this is 2\.13\.0: .*'thermoforce-mpc\[granite\]'"),
        ("flowstate", r"needs torch >=2\.10,<2\.12, this is 2\.13\.0"),
    ],
)
def test_what_is_missing_is_said_before_anything_is_fetched(
    name: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    monkeypatch.setattr(known, "python_version", lambda: "3.11.4")
    monkeypatch.setattr(known, "version", lambda package: "2.13.0+cpu")
    monkeypatch.setattr("requests.head", lambda *_, **__: pytest.fail("the hub was asked"))
    with pytest.raises(BackboneError, match=rf"backbone '{name}': it {words}|backbone '{name}': it is {words}"):
        load_backbone(name)


def test_a_directory_of_a_family_without_its_package_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"stack_config": {}}))
    safetensors_torch.save_file({"a": torch.zeros(1)}, tmp_path / "model.safetensors")
    monkeypatch.setattr(importlib.util, "find_spec", lambda package: None)
    with pytest.raises(BackboneError, match=r"'tirex-2': it is not installed"):
        load_backbone(str(tmp_path))


def test_a_model_of_no_family_is_refused(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"model_type": "bert"}))
    safetensors_torch.save_file({"a": torch.zeros(1)}, tmp_path / "model.safetensors")
    with pytest.raises(BackboneError, match=r"holds a bert; Chronos-Bolt, .* are supported"):
        load_backbone(str(tmp_path))


def test_a_ttm_without_quantiles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, anywhere: None) -> None:
    foundation_models.MAKERS["ttm"](tmp_path, monkeypatch)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "multi_quantile_head": False}))
    with pytest.raises(BackboneError, match="this TTM forecasts no quantiles"):
        load_backbone(str(tmp_path))


def test_an_unknown_name_gets_the_nearest() -> None:
    with pytest.raises(BackboneError, match="did you mean 'chronos-2-small'"):
        load_backbone("chronos2-small")


def test_gaps_are_bridged_by_lines_and_ends_hold() -> None:
    nan = np.nan
    np.testing.assert_allclose(interpolated(np.array([nan, 1.0, nan, 3.0, nan])), [1.0, 1.0, 2.0, 3.0, 3.0])


def test_only_what_may_be_sold_is_the_default() -> None:
    """Version 3 of TimesFM is for non-commercial use: by its own name only, and its licence stands there."""
    assert OF_NAME["timesfm"].licence == "Apache-2.0"
    assert OF_NAME["timesfm-3"].licence == "non-commercial"
    assert [one.name for one in known.KNOWN if one.licence not in {"MIT", "Apache-2.0"}] == ["timesfm-3"]
