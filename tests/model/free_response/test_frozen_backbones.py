"""Frozen backbones: found by name, refused with a reason, frozen, deterministic, and blind to the control."""

from __future__ import annotations

import gc
import importlib.util
import json
import shutil
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from forecasting import LEVELS, boundary_of, daily, history_of, hours
from later import safetensors_torch, torch

from benchmarks.free_response.scales import SMALLER
from thermoforce_mpc.errors import BackboneError, ConfigError, DataError
from thermoforce_mpc.model.free_response.backbones import loading
from thermoforce_mpc.model.free_response.backbones.loading import load_backbone
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
from thermoforce_mpc.model.free_response.registry import build_free_response

NAMES = ("shipped", "shipped_weather", "bolt", "chronos2", "fracast")


@pytest.fixture(scope="module", params=NAMES)
def forecaster(request: pytest.FixtureRequest) -> ChronosFreeResponse:
    if request.param == "fracast" and importlib.util.find_spec("fracast") is None:
        pytest.skip("optional package fracast is not installed")
    name = request.param if request.param in ("shipped", "shipped_weather", "fracast") else ""
    return ChronosFreeResponse(name or str(request.getfixturevalue(f"{request.param}_folder")))


@pytest.fixture
def copy(bolt_folder: Path, tmp_path: Path) -> Path:
    """A checkpoint that may be damaged."""
    return Path(shutil.copytree(bolt_folder, tmp_path / "copy"))


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 24, 100])
def test_every_horizon_has_ordered_finite_quantiles(forecaster: ChronosFreeResponse, steps: int) -> None:
    free = daily(hours(240)) + 0.1 * np.random.default_rng(0).standard_normal(241)
    forecast = forecaster.forecast(free, history_of(free), boundary_of(240, steps))
    np.testing.assert_allclose(forecast.levels, LEVELS)
    assert forecast.quantiles_C.shape == (9, steps)
    assert np.isfinite(forecast.quantiles_C).all()
    assert (np.diff(forecast.quantiles_C, axis=0) >= 0).all()
    assert forecast.note.endswith(forecaster.label)


@pytest.mark.slow
def test_many_at_once_are_what_each_is_alone(forecaster: ChronosFreeResponse) -> None:
    """Buildings of different history, gaps and horizon in one pass; one of them has too little and is told so."""
    rng = np.random.default_rng(1)
    tasks = []
    for known, steps in ((240, 24), (100, 24), (600, 24), (240, 70), (10, 24)):
        free = daily(hours(known)) + 0.1 * rng.standard_normal(known + 1)
        free[5:8] = np.nan
        tasks.append((free, history_of(free), boundary_of(known, steps)))
    together = forecaster.forecast_many(tasks)
    assert len(together) == len(tasks)
    for forecast, task in zip(together, tasks, strict=True):
        alone = forecaster.forecast(*task)
        assert forecast.note == alone.note
        np.testing.assert_allclose(forecast.quantiles_C, alone.quantiles_C, atol=2e-3)
    assert together[-1].note.startswith("persistence")


def test_same_bits_and_same_weights_however_many_threads(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(200))
    before, threads = forecaster.weight_hash(), torch.get_num_threads()
    first = forecaster.forecast(free, history_of(free), boundary_of(200, 30)).quantiles_C
    torch.set_num_threads(2)
    try:
        second = forecaster.forecast(free, history_of(free), boundary_of(200, 30)).quantiles_C
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    np.testing.assert_array_equal(first, second)
    assert forecaster.weight_hash() == before


@pytest.mark.parametrize("one_in", [2, 3])
def test_values_lost_here_and_there_change_little(forecaster: ChronosFreeResponse, one_in: int) -> None:
    """A sensor that reports every second or third hour; models that are told of each gap move by more than 1 K."""
    free = daily(hours(240))
    seldom = np.where(np.arange(free.size) % one_in == 0, free, np.nan)
    history, boundary = history_of(free), boundary_of(240, 24)
    whole, gapped = (forecaster.forecast(values, history, boundary) for values in (free, seldom))
    assert gapped.note == whole.note
    assert np.abs(gapped.median_C - whole.median_C).max() < 0.3


def test_gaps_are_passed_on_and_not_mended_on_the_way(forecaster: ChronosFreeResponse) -> None:
    """The forecast with a gap differs from that with the gap bridged by a line, and stays finite."""
    free = daily(hours(240))
    gap = free.copy()
    gap[215:233] = np.nan
    bridged = free.copy()
    bridged[215:233] = np.linspace(free[214], free[233], 20)[1:-1]
    history, boundary = history_of(free), boundary_of(240, 24)
    with_gap = forecaster.forecast(gap, history, boundary).quantiles_C
    assert np.isfinite(with_gap).all()
    assert np.abs(with_gap - forecaster.forecast(bridged, history, boundary).quantiles_C).max() > 1e-3


def test_the_control_is_never_seen(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(240))
    other = history_of(free + 7.0, u=np.linspace(0, 1, 240), power_W=np.full(240, 3e3), heat_W=np.full(240, 9e3))
    np.testing.assert_array_equal(
        forecaster.forecast(free, history_of(free), boundary_of(240, 24)).quantiles_C,
        forecaster.forecast(free, other, boundary_of(240, 24)).quantiles_C,
    )


def test_level_shifts_pass_through(forecaster: ChronosFreeResponse) -> None:
    """A thermometer that reads 8 K more gives a forecast 8 K higher: no backbone depends on the zero of the scale."""
    # Chronos-2 normalises by arcsinh, in single precision.
    tolerance = 0.05 if "Chronos-2" in forecaster.label else 0.005
    free = daily(hours(240))
    low = forecaster.forecast(free, history_of(free), boundary_of(240, 24)).quantiles_C
    high = forecaster.forecast(free + 8.0, history_of(free), boundary_of(240, 24)).quantiles_C
    np.testing.assert_allclose(high - low, 8.0, atol=tolerance)


def test_less_than_a_day_is_left_to_persistence_and_said(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(240))
    free[:-20] = np.nan
    forecast = forecaster.forecast(free, history_of(free), boundary_of(240, 24))
    assert forecast.note == "persistence: only 19 h of history measured"
    np.testing.assert_array_equal(forecast.median_C, np.full(24, free[-1]))
    present = free[-1:]
    forecast = forecaster.forecast(present, history_of(present), boundary_of(0, 24))
    assert forecast.note == "persistence: only 0 h of history measured"


def test_a_long_silence_is_left_to_persistence_and_said(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(700))
    free[-510:] = np.nan
    forecast = forecaster.forecast(free, history_of(free), boundary_of(700, 24))
    assert forecast.note == "persistence: only 2 of the last 512 values were measured"


def test_steps_of_history_and_forecast_must_agree(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(240))
    with pytest.raises(DataError, match="1800 s and forecast at 3600 s"):
        forecaster.forecast(free, history_of(free, step_s=1800.0), boundary_of(240, 24))


def test_only_chronos2_sees_the_weather(forecaster: ChronosFreeResponse) -> None:
    free = daily(hours(240))
    mild, cold = (boundary_of(240, 24, T_out_C=np.linspace(5, t, 25)) for t in (15.0, -15.0))
    change = np.abs(
        forecaster.forecast(free, history_of(free), mild).quantiles_C
        - forecaster.forecast(free, history_of(free), cold).quantiles_C
    ).max()
    assert (change > 1e-3) == ("Chronos-2" in forecaster.label)


def test_only_chronos2_sees_the_hour_of_the_day(forecaster: ChronosFreeResponse) -> None:
    """The same temperatures and weather, eight hours later; a whole day later is the same."""
    free = daily(hours(240))
    history, boundary = history_of(free), boundary_of(240, 24)

    def shifted(hours_later: float) -> np.ndarray:
        past, ahead = (replace(of, time_s=of.time_s + hours_later * 3600.0) for of in (history, boundary))
        return forecaster.forecast(free, past, ahead).quantiles_C

    np.testing.assert_allclose(shifted(24.0), shifted(0.0), atol=1e-4)
    assert (np.abs(shifted(8.0) - shifted(0.0)).max() > 1e-3) == ("Chronos-2" in forecaster.label)


def test_shipped_checkpoint_learns_a_daily_course_and_beats_persistence() -> None:
    free = daily(hours(336))
    truth = daily(np.arange(337, 361))
    history, boundary = history_of(free), boundary_of(336, 24)
    error = np.abs(build_free_response("chronos").forecast(free, history, boundary).median_C - truth).mean()
    naive = np.abs(build_free_response("persistence").forecast(free, history, boundary).median_C - truth).mean()
    assert error < 0.25
    assert error < 0.25 * naive


def test_context_steps_limit_what_is_seen(bolt_folder: Path) -> None:
    free = daily(hours(240))
    older = free.copy()
    older[:200] += 5.0
    history, boundary = history_of(free), boundary_of(240, 24)
    short = ChronosFreeResponse(str(bolt_folder), context_steps=32)
    np.testing.assert_array_equal(
        short.forecast(free, history, boundary).quantiles_C, short.forecast(older, history, boundary).quantiles_C
    )
    with pytest.raises(ConfigError, match="context_steps is 8"):
        ChronosFreeResponse(str(bolt_folder), context_steps=8)


def test_one_look_unrolls_and_several_do_not() -> None:
    """48 h at 15 minutes: one resolution is fed its own answers, its band stops opening; the hourly one's does not."""
    rng = np.random.default_rng(3)
    steps = np.arange(8 * 96 + 1)
    free = 15.0 + np.sin(2 * np.pi * steps / 96) + np.cumsum(0.05 * rng.standard_normal(steps.size))
    history, boundary = history_of(free, step_s=900.0), boundary_of(steps.size - 1, 192, step_s=900.0)
    several = build_free_response("chronos").forecast(free, history, boundary)
    one = build_free_response("chronos", resolutions="one").forecast(free, history, boundary)
    band = [np.diff(forecast.quantiles_C[[0, -1]], axis=0)[0, 96:].mean() for forecast in (several, one)]
    assert band[0] > 1.2 * band[1]
    with pytest.raises(ConfigError, match=r"resolutions is 'on'.*did you mean 'one'"):
        ChronosFreeResponse(resolutions="on")


def test_all_is_frozen(bolt_folder: Path) -> None:
    for module in load_backbone(str(bolt_folder)).modules:
        assert not module.training
        assert not any(parameter.requires_grad for parameter in module.parameters())


def test_hash_tells_weights_apart(bolt_folder: Path, copy: Path) -> None:
    weights = safetensors_torch.load_file(copy / "model.safetensors")
    name = next(key for key, value in weights.items() if value.ndim == 2)
    weights[name][0, 0] += 1e-3
    safetensors_torch.save_file(weights, copy / "model.safetensors", metadata={"format": "pt"})
    same = ChronosFreeResponse(str(bolt_folder)).weight_hash()
    assert same == ChronosFreeResponse(str(bolt_folder)).weight_hash()
    assert same != ChronosFreeResponse(str(copy)).weight_hash()


def test_the_last_backbone_is_kept_for_the_next_run_and_no_other() -> None:
    kept = [weakref.ref(load_backbone(str(scale))) for scale in SMALLER.values()]
    gc.collect()
    first, last = (reference() for reference in kept)
    assert first is None
    assert last is load_backbone(str(SMALLER["shipped_tiny"]))


def test_a_missing_directory_is_named(tmp_path: Path) -> None:
    with pytest.raises(BackboneError, match=r"nowhere.*no config\.json"):
        load_backbone(str(tmp_path / "nowhere"))
    with pytest.raises(BackboneError, match="neither a directory nor a hub name"):
        load_backbone("shiped")


def test_weights_as_a_pickle_are_refused_and_never_opened(copy: Path, tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[object, ...]:
            return (Path.touch, (tmp_path / "went off",))

    weights = safetensors_torch.load_file(copy / "model.safetensors")
    torch.save(weights | {"bomb": Bomb()}, copy / "pytorch_model.bin")
    (copy / "model.safetensors").unlink()
    with pytest.raises(BackboneError, match=r"no model\.safetensors there.*pickle: pytorch_model\.bin"):
        load_backbone(str(copy))
    (copy / "model.safetensors.index.json").write_text(json.dumps({"metadata": {}, "weight_map": {}}))
    with pytest.raises(BackboneError):
        load_backbone(str(copy))
    assert not (tmp_path / "went off").exists()


def test_a_truncated_file_is_refused(copy: Path) -> None:
    file = copy / "model.safetensors"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(BackboneError, match=r"copy cannot be loaded \(.*or use backbone: shipped"):
        load_backbone(str(copy))


def test_a_broken_config_is_refused(copy: Path) -> None:
    (copy / "config.json").write_text("{")
    with pytest.raises(BackboneError, match="cannot be loaded"):
        load_backbone(str(copy))


def test_a_checkpoint_that_lacks_weights_is_refused_instead_of_drawn_at_random(copy: Path) -> None:
    weights = safetensors_torch.load_file(copy / "model.safetensors")
    lost = sorted(key for key in weights if "encoder.block" in key)[0]
    del weights[lost]
    safetensors_torch.save_file(weights, copy / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(BackboneError, match=rf"lacks 1 of .*first {lost}"):
        load_backbone(str(copy))


def test_weights_that_are_not_finite_are_refused(copy: Path) -> None:
    weights = safetensors_torch.load_file(copy / "model.safetensors")
    name = sorted(weights)[0]
    weights[name].view(-1)[0] = float("nan")
    safetensors_torch.save_file(weights, copy / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(BackboneError, match="not finite"):
        load_backbone(str(copy))


def test_quantiles_that_do_not_span_the_interval_are_refused(copy: Path) -> None:
    config = json.loads((copy / "config.json").read_text())
    config["chronos_config"]["quantiles"] = (np.arange(1, 10) / 20 + 0.25).tolist()
    (copy / "config.json").write_text(json.dumps(config))
    with pytest.raises(BackboneError, match=r"trained for the quantiles .*0\.1 to 0\.9"):
        load_backbone(str(copy))


class _Missing(BaseHTTPRequestHandler):
    def do_HEAD(self) -> None:
        self.send_response(404)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Stay quiet."""


@pytest.fixture
def hub_without_models(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with ThreadingHTTPServer(("127.0.0.1", 0), _Missing) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        monkeypatch.setenv("HF_ENDPOINT", f"http://127.0.0.1:{server.server_port}")
        yield
        server.shutdown()
        thread.join()


def test_a_name_on_the_hub_with_a_pickle_only_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Handler(BaseHTTPRequestHandler):
        def do_HEAD(self) -> None:
            self.send_response(200 if self.path.endswith(("config.json", "pytorch_model.bin")) else 404)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("HF_ENDPOINT", f"http://127.0.0.1:{server.server_port}")
    try:
        with pytest.raises(BackboneError, match=r"has no model\.safetensors of it; weights in other files"):
            load_backbone("somebody/some-checkpoint")
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.usefixtures("hub_without_models")
def test_a_name_the_hub_does_not_know_is_refused() -> None:
    with pytest.raises(BackboneError, match=r"'nobody/nothing'.*answers 404"):
        load_backbone("nobody/nothing")


def test_a_hub_out_of_reach_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    paused: list[float] = []
    monkeypatch.setattr(time, "sleep", paused.append)
    with pytest.raises(BackboneError, match=r"cannot be reached.*backbone: shipped"):
        load_backbone("nobody/nothing")
    assert paused == [], "not after the retries of the library"


def test_offline_mode_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(BackboneError, match="HF_HUB_OFFLINE is set"):
        load_backbone("nobody/nothing")


def test_without_the_optional_package_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BackboneError, match=r"pip install 'thermoforce-mpc\[fracast\]'"):
        loading.REGISTRY.find("fracast")()


def test_residual_adds_the_backbone_to_the_linear_model_and_tells_its_hash(bolt_folder: Path) -> None:
    free = daily(hours(240)) + 0.05 * np.random.default_rng(1).standard_normal(241)
    history = history_of(free)
    residual = build_free_response("residual", backbone=str(bolt_folder), calibrate=False)
    assert residual.weight_hash() == ChronosFreeResponse(str(bolt_folder)).weight_hash()  # type: ignore[attr-defined]
    mild, cold = (boundary_of(240, 24, T_out_C=np.linspace(5, t, 25)) for t in (15.0, -15.0))
    warmer = residual.forecast(free, history, mild)
    assert "corrected by Chronos-Bolt" in warmer.note
    assert (warmer.median_C - residual.forecast(free, history, cold).median_C)[-1] > 0


@pytest.mark.slow
def test_checking_names_and_naive_forecasts_load_no_torch() -> None:
    code = (
        "import sys\n"
        "from thermoforce_mpc.model.free_response.registry import build_free_response, check_free_response\n"
        "check_free_response('chronos', {'backbone': 'shipped'})\n"
        "build_free_response('linear_weather')\n"
        "import controllers.mpc.config\n"
        "assert not {'torch', 'chronos', 'transformers'} & set(sys.modules), 'loaded'\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
