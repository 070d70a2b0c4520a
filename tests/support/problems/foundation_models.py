"""Tiny random checkpoints of the foundation models, by their own packages.

Where a package is not installed, a module with the signatures of its published source stands in its place: tirex-2
0.4.0, toto-2 2.0.0 and granite-tsfm 0.3.11. It checks what it is given and forecasts by a line.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from benchmarks.free_response import random_models

LEVELS = [level / 10 for level in range(1, 10)]


def installed(package: str) -> bool:
    return importlib.util.find_spec(package) is not None


class Line(nn.Module):
    """The last value, a spread by level, and what the covariates ahead add."""

    def __init__(self, **config: Any) -> None:
        super().__init__()
        self.config = SimpleNamespace(**config)
        self.slope = nn.Parameter(torch.tensor(0.1))

    def line(self, last: torch.Tensor, steps: int) -> torch.Tensor:
        """Quantiles (B, 9, steps) from the last values (B,)."""
        spread = self.slope * (torch.tensor(LEVELS) - 0.5)
        return last[:, None, None] + spread[None, :, None] * torch.arange(1, steps + 1)

    @classmethod
    def from_pretrained(cls, folder: str | Path, **_: Any) -> Line:
        config = json.loads((Path(folder) / "config.json").read_text())
        model = cls(**config)
        model.load_state_dict(load_file(Path(folder) / "model.safetensors"), strict=True)
        return model

    def save(self, folder: Path) -> None:
        save_file(self.state_dict(), folder / "model.safetensors")
        (folder / "config.json").write_text(json.dumps(vars(self.config)))


def stand_in(monkeypatch: pytest.MonkeyPatch, name: str, **names: Any) -> None:
    module = ModuleType(name)
    module.__spec__ = ModuleSpec(name, None, is_package=True)
    module.__path__ = []
    vars(module).update(names)
    monkeypatch.setitem(sys.modules, name, module)


def tirex2(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if installed("tirex2"):
        return random_models.save_tirex2(folder, True)

    @dataclass
    class TimeseriesType:
        target: torch.Tensor
        past_covariates: torch.Tensor | None
        future_covariates: torch.Tensor | None

    class Forecaster:
        def __init__(self, model: Line) -> None:
            self.model = model
            model.future_len = model.config.future_len
            model.register_buffer("quantiles", torch.tensor(LEVELS), persistent=False)

        def forecast(
            self, timeseries: list[TimeseriesType], prediction_length: int, *, output_type: str = "torch"
        ) -> list[Any]:
            assert output_type == "numpy"
            assert prediction_length <= self.model.future_len, "the package cuts longer ones short"
            answers = []
            for one in timeseries:
                assert one.target.dtype == one.future_covariates.dtype == torch.float32
                assert one.future_covariates.shape == (3, one.target.shape[1] + prediction_length)
                last = one.target[:, -1] + one.future_covariates[:, -1].sum()
                answers.append(self.model.line(last, prediction_length).numpy())
            return answers

    def load_model(ckpt_path: str | Path = "NX-AI/TiRex-2", device: str = "cuda", **_: Any) -> Forecaster:
        assert device == "cpu"
        return Forecaster(Line.from_pretrained(ckpt_path))

    stand_in(monkeypatch, "tirex2", TimeseriesType=TimeseriesType, load_model=load_model)
    return Line(stack_config={}, future_len=64).save(folder)


def timesfm(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("timesfm")
    from timesfm.timesfm_2p5 import timesfm_2p5_torch as by_torch

    random_models.save_timesfm(folder, True)
    monkeypatch.setattr(by_torch.TimesFM_2p5_200M_torch_module, "config", random_models.tiny_timesfm())


def timesfm3(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("timesfm3")
    random_models.save_timesfm3(folder, True)


def toto2(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if installed("toto2"):
        return random_models.save_toto2(folder, True)

    class Toto2Model(Line):
        def forecast(self, inputs: dict[str, torch.Tensor], horizon: int, **kwargs: Any) -> torch.Tensor:
            target, mask = inputs["target"], inputs["target_mask"]
            assert target.shape == mask.shape == (len(target), 1, target.shape[-1])
            assert target.shape[-1] % self.config.patch_size == 0
            assert mask.dtype == torch.bool
            assert bool(torch.isfinite(target).all())
            assert inputs["series_ids"].shape == (len(target), 1)
            assert kwargs == {"has_missing_values": not bool(mask.all())}
            return self.line(target[:, 0, -1], horizon).transpose(0, 1)[:, :, None]

    stand_in(monkeypatch, "toto2", Toto2Model=Toto2Model)
    Toto2Model(num_variate_layers_per_group=1, patch_size=16).save(folder)


def flowstate(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if installed("tsfm_public"):
        return random_models.save_flowstate(folder, True)

    class FlowStateForPrediction(Line):
        def forward(
            self, past_values: torch.Tensor, prediction_length: int, batch_first: bool, return_dict: bool
        ) -> SimpleNamespace:
            assert past_values.shape == (len(past_values), past_values.shape[1], 1)
            assert batch_first
            assert return_dict
            return SimpleNamespace(quantile_outputs=self.line(past_values[:, -1, 0], prediction_length)[..., None])

    _granite(monkeypatch, "flowstate", FlowStateForPrediction=FlowStateForPrediction)
    sizes = {"context_length": 256, "with_missing": True, "quantiles": LEVELS}
    FlowStateForPrediction(model_type="flowstate", **sizes).save(folder)


def ttm(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if installed("tsfm_public"):
        return random_models.save_ttm(folder, True)

    class TinyTimeMixerForPrediction(Line):
        def forward(
            self, past_values: torch.Tensor, past_observed_mask: torch.Tensor, return_loss: bool, return_dict: bool
        ) -> SimpleNamespace:
            assert past_values.shape == past_observed_mask.shape == (len(past_values), self.config.context_length, 1)
            assert bool(torch.isfinite(past_values).all())
            assert return_dict
            assert not return_loss
            steps = self.config.prediction_length
            return SimpleNamespace(quantile_outputs=self.line(past_values[:, -1, 0], steps)[..., None])

    _granite(monkeypatch, "tinytimemixer", TinyTimeMixerForPrediction=TinyTimeMixerForPrediction)
    sizes = {"context_length": 128, "prediction_length": 30, "quantile_levels": LEVELS, "multi_quantile_head": True}
    TinyTimeMixerForPrediction(model_type="tinytimemixer", architectures=["TinyTimeMixerForPrediction"], **sizes).save(
        folder
    )


def _granite(monkeypatch: pytest.MonkeyPatch, module: str, **names: Any) -> None:
    for parent in ("tsfm_public", "tsfm_public.models"):
        stand_in(monkeypatch, parent)
    stand_in(monkeypatch, f"tsfm_public.models.{module}", **names)
    vars(sys.modules["tsfm_public.models"])[module] = sys.modules[f"tsfm_public.models.{module}"]


MAKERS: dict[str, Callable[[Path, pytest.MonkeyPatch], None]] = {
    "tirex-2": tirex2,
    "timesfm": timesfm,
    "timesfm-3": timesfm3,
    "toto-2": toto2,
    "ttm": ttm,
    "flowstate": flowstate,
}
