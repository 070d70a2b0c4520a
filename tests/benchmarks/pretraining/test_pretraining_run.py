"""Training learns, resumes to the same weights and overwrites nothing unasked; evaluation tells good from bad."""

import json
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from later import Later, safetensors_torch, torch

from benchmarks.free_response import scales
from benchmarks.pretraining.evaluation import CONTEXTS, evaluate
from benchmarks.pretraining.model import CONTEXT, HORIZON, build_model, build_weather_model
from benchmarks.pretraining.series import draw_batch
from thermoforce_mpc.errors import BackboneError, ConfigError

SHIPPED = Path(str(resources.files("thermoforce_mpc"))) / "model/free_response/backbones/weights/bolt_thermal"
SMALLER = list(scales.SMALLER.values())
command = Later("benchmarks.pretraining.__main__")
groups = Later("benchmarks.pretraining.groups")
training = Later("benchmarks.pretraining.training")


def tiny():
    return training.TrainingConfig(steps=4, batch=8, save_every=2, validation_batches=1)


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    pytest.importorskip("chronos")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    lines = []
    training.pretrain(folder, tiny(), lines.append)
    return folder, lines


def weights(folder):
    return safetensors_torch.load_file(folder / "checkpoint" / "model.safetensors")


@pytest.mark.slow
def test_a_run_leaves_a_loadable_checkpoint_and_its_curve(trained):
    from chronos import BaseChronosPipeline

    folder, lines = trained
    pipeline = BaseChronosPipeline.from_pretrained(str(folder / "checkpoint"), device_map="cpu", dtype=torch.float32)
    quantiles, _ = pipeline.predict_quantiles(torch.arange(100.0)[None], 24, [0.1, 0.5, 0.9])
    assert quantiles.shape == (1, 24, 3)
    assert torch.isfinite(quantiles).all()
    record = json.loads((folder / "checkpoint" / "training.json").read_text())
    assert [point["step"] for point in record["curve"]] == [2, 4]
    assert len(lines) == 2


@pytest.mark.slow
def test_an_interrupted_run_ends_with_the_same_weights(trained, tmp_path, monkeypatch):
    real = training.save_checkpoint

    def interrupted(*args):
        real(*args)
        raise KeyboardInterrupt

    monkeypatch.setattr("benchmarks.pretraining.training.save_checkpoint", interrupted)
    with pytest.raises(KeyboardInterrupt):
        training.pretrain(tmp_path, tiny(), lambda _: None)
    monkeypatch.setattr("benchmarks.pretraining.training.save_checkpoint", real)
    lines = []
    training.pretrain(tmp_path, tiny(), lines.append)
    assert lines[0] == "resuming at step 2"
    whole, resumed = weights(trained[0]), weights(tmp_path)
    assert whole.keys() == resumed.keys()
    for name, tensor in whole.items():
        torch.testing.assert_close(resumed[name], tensor, rtol=0, atol=0)


@pytest.mark.slow
def test_a_finished_run_is_kept_unless_forced(trained):
    folder, _ = trained
    before = weights(folder)
    with pytest.raises(ConfigError, match=r"finished run of 4 steps.*--force"):
        training.pretrain(folder, tiny(), lambda _: None)
    training.pretrain(folder, tiny(), lambda _: None, force=True)
    after = weights(folder)
    assert all(torch.equal(before[name], after[name]) for name in before)


def test_a_run_of_other_options_is_not_continued(trained):
    with pytest.raises(ConfigError, match="other batch"):
        training.pretrain(trained[0], replace(tiny(), batch=9), lambda _: None)


@pytest.mark.slow
def test_a_second_stage_starts_from_the_first_ones_weights(trained, tmp_path):
    first = trained[0] / "checkpoint"
    still = replace(tiny(), steps=2, rate_scale=0.0, start_sha256=training.weights_sha256(first))
    training.pretrain(tmp_path / "still", still, lambda _: None, start=first)
    moved = replace(still, rate_scale=1.0)
    training.pretrain(tmp_path / "moved", moved, lambda _: None, start=first)
    before, unmoved, after = weights(trained[0]), weights(tmp_path / "still"), weights(tmp_path / "moved")
    assert all(torch.equal(before[name], unmoved[name]) for name in before)
    assert not all(torch.equal(before[name], after[name]) for name in before)


def test_a_second_stage_says_what_it_starts_from(trained, tmp_path):
    first = trained[0] / "checkpoint"
    with pytest.raises(ConfigError, match="start_sha256"):
        training.pretrain(tmp_path, tiny(), lambda _: None, start=first)
    with pytest.raises(ConfigError, match=r"no model\.safetensors"):
        training.pretrain(tmp_path, tiny(), lambda _: None, start=tmp_path)
    safetensors_torch.save_file({"shared.weight": torch.zeros(2, 64)}, tmp_path / "model.safetensors")
    other = replace(tiny(), start_sha256=training.weights_sha256(tmp_path))
    with pytest.raises(ConfigError, match="another architecture"):
        training.pretrain(tmp_path / "out", other, lambda _: None, start=tmp_path)


@pytest.mark.slow
def test_a_second_stage_may_have_more_layers_that_start_without_effect(trained, tmp_path):
    first = trained[0] / "checkpoint"
    deeper = replace(
        tiny(), steps=1, rate_scale=0.0, weight_decay=0.0, start_sha256=training.weights_sha256(first), encoder_layers=3
    )
    training.pretrain(tmp_path, deeper, lambda _: None, start=first)
    before, after = weights(trained[0]), weights(tmp_path)
    assert set(before) < set(after)
    short, deep = (evaluate(folder / "checkpoint", series=8)["contexts"][-1] for folder in (trained[0], tmp_path))
    assert deep["model"] == pytest.approx(short["model"], rel=1e-3)
    narrow = replace(deeper, d_model=32)
    with pytest.raises(ConfigError, match="another architecture"):
        training.pretrain(tmp_path / "narrow", narrow, lambda _: None, start=first)


@pytest.mark.slow
def test_series_drawn_by_other_processes_are_the_same(trained, tmp_path):
    training.pretrain(tmp_path, tiny(), lambda _: None, workers=2)
    whole, beside = weights(trained[0]), weights(tmp_path)
    assert all(torch.equal(whole[name], beside[name]) for name in whole)


def test_what_corrects_a_linear_model_reads_the_end_of_what_that_was_fitted_to():
    batch = draw_batch(np.random.default_rng(4), 3, CONTEXT + 160, HORIZON)
    seen, coming, wanted = (values.numpy().reshape(3, 5, -1) for values in training.corrections(batch))
    assert seen.shape[2] == CONTEXT
    assert coming.shape[2] == wanted.shape[2] == HORIZON
    np.testing.assert_allclose(seen[:, 0] + seen[:, 4], batch.context[:, 160:], atol=1e-4)
    np.testing.assert_allclose(wanted[:, 0] + coming[:, 4], batch.future, atol=1e-4)
    assert np.isnan(wanted[:, 1:]).all()
    assert np.isnan(coming[:, 0]).all()


def test_rows_of_a_group_attend_to_each_other_as_in_the_library():
    torch.manual_seed(0)
    model = build_weather_model(16, 32, 2).eval()
    rows = torch.randn(12, 96)
    rows[4, :40] = torch.nan

    def quantiles():
        with torch.no_grad():
            ids = torch.arange(3).repeat_interleave(4)
            return model(context=rows, group_ids=ids, num_output_patches=2).quantile_preds

    library = quantiles()
    with groups.attend_within_groups(model, 4):
        torch.testing.assert_close(quantiles(), library, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(quantiles(), library, rtol=0.0, atol=0.0)


@pytest.mark.slow
def test_a_run_with_weather_leaves_a_chronos2_that_reads_it(tmp_path):
    from chronos import BaseChronosPipeline

    weather = replace(tiny(), weather=True, d_model=16, encoder_layers=1, steps=2)
    training.pretrain(tmp_path, weather, lambda line: None)
    pipeline = BaseChronosPipeline.from_pretrained(str(tmp_path / "checkpoint"), device_map="cpu", dtype=torch.float32)

    def median(outdoor_ahead):
        known = {"past_covariates": {"outdoor": np.arange(96.0)}, "future_covariates": {"outdoor": outdoor_ahead}}
        task = {"target": np.sin(np.arange(96.0)), **known}
        return pipeline.predict_quantiles([task], prediction_length=16, quantile_levels=[0.5])[0][0]

    assert (median(np.full(16, 90.0)) - median(np.full(16, 10.0))).abs().max() > 1e-6
    rows = evaluate(tmp_path / "checkpoint", series=4)["contexts"]
    assert [row["context"] for row in rows] == [length for length in CONTEXTS if length >= 96], "a day at 15 min"
    assert all(np.isfinite(row["model"]) for row in rows)


@pytest.mark.slow
def test_the_loss_falls():
    """Twenty-five steps on one fixed batch: gradients reach the weights through both optimisers."""
    torch.manual_seed(0)
    model = build_model()
    matrices, rest = training.split_parameters(model)
    assert len(matrices) > 10
    assert {id(p) for p in matrices + rest} == {id(p) for p in model.parameters()}
    optimisers = [torch.optim.Muon(matrices, lr=0.01), torch.optim.AdamW(rest, lr=2e-3)]
    losses = []
    for _ in range(25):
        loss = training.loss_of(model, training.drawn(np.random.default_rng(0), tiny()))
        for optimiser in optimisers:
            optimiser.zero_grad()
        loss.backward()
        for optimiser in optimisers:
            optimiser.step()
        losses.append(loss.item())
    assert np.mean(losses[-5:]) < 0.7 * losses[0]


@pytest.mark.slow
def test_the_shipped_checkpoint_beats_plain_forecasts_on_held_out_series(trained):
    shipped = evaluate(SHIPPED, series=256, seed=5)["contexts"]
    assert [row["context"] for row in shipped] == list(CONTEXTS)
    for row in shipped:
        assert row["series"] == 256
        assert list(row["coverage"]) == sorted(row["coverage"])
    longest = shipped[-1]
    assert longest["model"] < 0.7 * min(longest["persistence"], longest["seasonal_naive"])
    assert 0.72 < longest["inside_80"] < 0.88
    small, tiniest = (evaluate(folder, series=256, seed=5)["contexts"][-1] for folder in SMALLER)
    assert 1.0 < small["model"] / longest["model"] < 1.15
    assert 1.0 < tiniest["model"] / small["model"] < 1.15
    # Four steps of training are no training: the same yardstick must tell.
    untrained = evaluate(trained[0] / "checkpoint", series=64, seed=5)["contexts"][-1]
    assert untrained["model"] > 1.3 * longest["model"]


@pytest.mark.parametrize("folder", [SHIPPED, *SMALLER])
def test_a_shipped_checkpoint_is_small_and_says_where_it_comes_from(folder):
    assert (folder / "model.safetensors").stat().st_size < 4e6
    record = json.loads((folder / "training.json").read_text())
    assert record["curve"][-1]["step"] == record["config"]["steps"]
    assert json.loads((folder / "evaluation.json").read_text())["contexts"][-1]["context"] == CONTEXTS[-1]
    assert "Synthetic series only" in (folder / "DATA_CARD.md").read_text()


def test_evaluation_names_what_is_wrong(tmp_path):
    with pytest.raises(BackboneError, match=r"no config\.json"):
        evaluate(tmp_path)
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(BackboneError, match="cannot be loaded"):
        evaluate(tmp_path)
    with pytest.raises(ConfigError, match="1 to 64"):
        evaluate(tmp_path, steps=65)
    with pytest.raises(ConfigError, match="at least one"):
        evaluate(tmp_path, series=0)


@pytest.mark.slow
def test_command_line_trains_evaluates_and_refuses(tmp_path):
    run = CliRunner().invoke(command.main, ["train", "--out", str(tmp_path), "--steps", "1", "--batch", "4"])
    assert run.exit_code == 0, run.output
    again = CliRunner().invoke(command.main, ["train", "--out", str(tmp_path), "--steps", "1", "--batch", "4"])
    assert again.exit_code == 2
    assert "finished run" in again.output
    scored = CliRunner().invoke(command.main, ["evaluate", str(tmp_path / "checkpoint"), "--series", "8"])
    assert scored.exit_code == 0, scored.output
    written = json.loads((tmp_path / "checkpoint" / "evaluation.json").read_text())
    assert len(written["contexts"]) == len(CONTEXTS)
    missing = CliRunner().invoke(command.main, ["evaluate", str(tmp_path / "nothing")])
    assert missing.exit_code == 2
    assert "nothing" in missing.output
