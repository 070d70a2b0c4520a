"""Training of the shipped forecaster: seeded, resumable, on a GPU if available, else on the CPU."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from benchmarks.pretraining.groups import attend_within_groups
from benchmarks.pretraining.model import CONTEXT, HORIZON, PATCH, build_model, build_weather_model
from benchmarks.pretraining.series import Batch, courses, draw_batch
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.model.free_response.backbones.base import COVARIATES

# Targets further than this many standard deviations of the context away are masked: they would dominate the loss.
_LARGEST_Z = 8.0
# The same of what a linear model leaves over, which after a day is little before and much after; a Chronos-2 reads and
# says arcsinh of it.
_LARGEST_REST_Z = 1000.0
_WARM_UP = 200
_CLIP = 1.0
# Lengths, steps, of what the linear model of a batch is fitted to, up to two weeks at 15 min; the last `CONTEXT` of it
# are read. Shorter ones cost less, and a building begins with a day.
_FITTED = (112, 192, 352, CONTEXT, 1344)
# The series, its covariates, and the course of the linear model.
_ROWS = 2 + len(COVARIATES)
# Computed at import, since the files may change during a long run.
_CODE_HASH = hashlib.sha256(
    b"".join(
        (Path(__file__).parent / f"{name}.py").read_bytes()
        for name in ("series", "climate", "occupants", "model", "groups", "training")
    )
).hexdigest()


@dataclass(frozen=True)
class TrainingConfig:
    """Training options; `steps` also sets the length of the learning-rate schedule.

    `start_sha256` is the hash of the weights that a later stage starts from, empty for a random start; a later stage
    needs smaller learning rates (`rate_scale`). It may have more encoder layers than those weights; the new ones start
    with zero output. `bfloat16` computes matrix products in that precision, weights stay in single precision. `weather`
    trains a Chronos-2 with known weather ahead instead of a Chronos-Bolt.
    """

    steps: int = 12_000
    batch: int = 128
    seed: int = 0
    muon_lr: float = 0.02
    adamw_lr: float = 3e-3
    weight_decay: float = 0.01
    save_every: int = 500
    validation_batches: int = 4
    rate_scale: float = 1.0
    start_sha256: str = ""
    d_model: int = 64
    encoder_layers: int = 2
    bfloat16: bool = False
    weather: bool = False


def pretrain(
    folder: Path,
    config: TrainingConfig,
    report: Callable[[str], None] = print,
    *,
    start: Path | None = None,
    force: bool = False,
    workers: int = 0,
) -> Path:
    """Train, or resume from `folder/state.pt`; writes `folder/checkpoint` with weights and `training.json`.

    The batch of step k depends only on the seed and k, so an interrupted run ends with the same weights as an
    uninterrupted one (on the same machine and number of threads).

    Args:
        start: folder of a checkpoint to start from instead of random weights; `config.start_sha256` must be its
            `weights_sha256`.
        force: overwrite a run in `folder`.
        workers: processes that draw series ahead, none: the training process draws them; the series are the same.

    Raises:
        ConfigError: `folder` holds a finished run, or one of another configuration or code, and `force` is not set;
            or `start` is not the checkpoint that `config` names.
    """
    state_path = folder / "state.pt"
    if config.start_sha256 != (weights_sha256(start) if start else ""):
        raise ConfigError(f"start_sha256 of the configuration is not the hash of the start checkpoint {start}")
    if force:
        state_path.unlink(missing_ok=True)
    torch.manual_seed(config.seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    build = build_weather_model if config.weather else build_model
    model = build(config.d_model, 4 * config.d_model, config.encoder_layers)
    if start is not None:
        _start_from(model, start)
    model = model.to(device)
    matrices, rest = split_parameters(model)
    optimisers = [
        torch.optim.Muon(matrices, lr=config.muon_lr, weight_decay=config.weight_decay),
        torch.optim.AdamW(rest, lr=config.adamw_lr, weight_decay=config.weight_decay),
    ]
    curve: list[dict[str, float]] = []
    first = 0
    folder.mkdir(parents=True, exist_ok=True)
    if state_path.exists():
        state = torch.load(state_path, map_location=device, weights_only=True)
        _check_resumable(state, config, folder)
        model.load_state_dict(state["model"])
        for optimiser, saved in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(saved)
        first, curve = int(state["step"]), list(state["curve"])
        report(f"resuming at step {first}")
    rates = [config.rate_scale * config.muon_lr, config.rate_scale * config.adamw_lr]
    began, running = time.perf_counter(), 0.0
    model.train()
    ahead = DataLoader(_Draws(config), batch_size=None, sampler=range(first, config.steps), num_workers=workers)
    for step, tensors in enumerate(ahead, first):
        for optimiser, rate in zip(optimisers, rates, strict=True):
            for group in optimiser.param_groups:
                group["lr"] = rate * _schedule(step, config.steps)
        with torch.autocast(device, dtype=torch.bfloat16, enabled=config.bfloat16):
            loss = loss_of(model, tensors)
        for optimiser in optimisers:
            optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), _CLIP)
        for optimiser in optimisers:
            optimiser.step()
        running = 0.98 * running + 0.02 * loss.item() if step > first else loss.item()
        done = step + 1
        if done % config.save_every == 0 or done == config.steps:
            validation = _validation_loss(model, config)
            curve.append({"step": done, "training": running, "validation": validation})
            speed = (done - first) / (time.perf_counter() - began)
            report(
                f"step {done}/{config.steps}  training {running:.3f}  validation {validation:.3f}  {speed:.1f} steps/s"
            )
            state = {
                "model": model.state_dict(),
                "optimisers": [optimiser.state_dict() for optimiser in optimisers],
                "step": done,
                "curve": curve,
                "config": asdict(config),
                "code": code_hash(),
            }
            torch.save(state, state_path.with_suffix(".new"))
            state_path.with_suffix(".new").replace(state_path)
            record = {
                "config": asdict(config),
                "code_sha256": code_hash(),
                "parameters": sum(p.numel() for p in model.parameters()),
                "device": device,
                "torch": torch.__version__,
                "curve": curve,
            }
            save_checkpoint(model, folder / "checkpoint", record)
    return folder / "checkpoint"


def code_hash() -> str:
    """SHA-256 of the sources of series, model and training, as they were at import."""
    return _CODE_HASH


def weights_sha256(checkpoint: Path) -> str:
    """SHA-256 of a checkpoint's weight file; raises `ConfigError` when there is none."""
    path = checkpoint / "model.safetensors"
    if not path.is_file():
        raise ConfigError(f"{checkpoint} holds no model.safetensors to start from")
    return file_sha256(path)


def _start_from(model: Any, checkpoint: Path) -> None:
    from safetensors.torch import load_file

    weights = {name: tensor.float() for name, tensor in load_file(checkpoint / "model.safetensors").items()}
    own = model.state_dict(keep_vars=True)
    wrong = [name for name, tensor in weights.items() if name in own and own[name].shape != tensor.shape]
    if not wrong:
        # Tied tensors are stored once: a missing one must be an alias of a stored one or belong to a new layer.
        missing, unexpected = model.load_state_dict(weights, strict=False)
        stored = {own[name].data_ptr() for name in weights if name not in unexpected}
        foreign = [name for name in missing if own[name].data_ptr() not in stored]
        layers = {name.split(".")[2] for name in weights if name.startswith("encoder.block.")}
        new = [name for name in foreign if name.startswith("encoder.block.") and name.split(".")[2] not in layers]
        with torch.no_grad():
            for name in new:
                if name.endswith((".o.weight", ".wo.weight")):
                    own[name].zero_()  # residual block: zero output at the start
        wrong = [*(name for name in foreign if name not in new or not layers), *unexpected]
    if wrong:
        raise ConfigError(f"{checkpoint} is of another architecture: {', '.join(wrong)[:200]}")


def _check_resumable(state: dict[str, Any], config: TrainingConfig, folder: Path) -> None:
    advice = "give another folder, or use --force to overwrite it"
    if state["config"] != asdict(config):
        changed = [key for key, value in asdict(config).items() if state["config"].get(key) != value]
        raise ConfigError(f"{folder} holds a run with other {', '.join(changed) or 'options'}: {advice}")
    if state["code"] != code_hash():
        raise ConfigError(f"{folder} holds a run made by another version of the training code: {advice}")
    if int(state["step"]) >= config.steps:
        raise ConfigError(f"{folder} holds a finished run of {config.steps} steps: {advice}")


class _Draws(Dataset[tuple[Tensor, ...]]):
    """What training reads of step k, `drawn` for a seed that only the configuration's and k decide."""

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config

    def __getitem__(self, step: int) -> tuple[Tensor, ...]:
        return drawn(np.random.default_rng([self.config.seed, 1, step]), self.config)


def drawn(rng: np.random.Generator, config: TrainingConfig, size: int | None = None) -> tuple[Tensor, ...]:
    """One random batch of `size` series, by default that of training, as `loss_of` reads it."""
    size = size or config.batch
    if config.weather:
        return corrections(draw_batch(rng, size, int(rng.choice(_FITTED)), HORIZON))
    batch = draw_batch(rng, size, CONTEXT, HORIZON)
    return torch.from_numpy(batch.context), torch.from_numpy(batch.future)


def corrections(batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
    """What a Chronos-2 reads and is to say: past (B rows, C), known ahead and target (B rows, H).

    A group of rows is what the linear weather model leaves of a series, its covariates and the model's course; only the
    first has a target.
    """
    n, context, horizon = len(batch.context), batch.context.shape[1], batch.future.shape[1]
    course = courses(batch)
    rest = batch.context - course[:, :context], batch.future - course[:, context:]
    known = np.concatenate([batch.covariates, course[:, None]], axis=1)
    past = np.concatenate([rest[0][:, None], known[:, :, :context]], axis=1)[:, :, -CONTEXT:]
    ahead, target = np.full((2, n, _ROWS, horizon), np.nan, dtype=np.float32)
    ahead[:, 1:], target[:, 0] = known[:, :, context:], rest[1]
    scale = np.nanstd(past[:, 0], axis=1, keepdims=True)
    middle = np.nanmean(past[:, 0], axis=1, keepdims=True)
    target[:, 0][np.abs(rest[1] - middle) > _LARGEST_REST_Z * scale] = np.nan
    seen, coming, wanted = (torch.from_numpy(values.reshape(n * _ROWS, -1)) for values in (past, ahead, target))
    return seen, coming, wanted


def loss_of(model: Any, tensors: tuple[Tensor, ...]) -> Tensor:
    """Quantile loss on what `drawn` gave: of a Chronos-Bolt, or of a Chronos-2 where there is weather."""
    on_device = [values.to(model.device, non_blocking=True) for values in tensors]
    if len(on_device) == 2:
        return _series_loss(model, *on_device)
    seen, coming, wanted = on_device
    with attend_within_groups(model, _ROWS):
        loss: Tensor = model(
            context=seen,
            group_ids=torch.arange(len(seen) // _ROWS, device=model.device).repeat_interleave(_ROWS),
            future_covariates=coming,
            num_output_patches=coming.shape[1] // PATCH,
            future_target=wanted,
        ).loss
    return loss * _ROWS


def _series_loss(model: Any, context: Tensor, future: Tensor) -> Tensor:
    _, (loc, scale) = model.instance_norm(context)
    future = torch.where(((future - loc) / scale).abs() > _LARGEST_Z, torch.nan, future)
    loss: Tensor = model(context=context, target=future).loss
    return loss


def save_checkpoint(model: Any, folder: Path, record: dict[str, Any]) -> None:
    """Write config.json, half-precision model.safetensors and training.json."""
    from copy import deepcopy

    from transformers.utils import logging

    logging.disable_progress_bar()
    deepcopy(model).half().save_pretrained(folder, safe_serialization=True)
    (folder / "training.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def _validation_loss(model: Any, config: TrainingConfig) -> float:
    model.eval()
    with torch.no_grad():
        losses = [
            loss_of(model, drawn(np.random.default_rng([config.seed, 2, i]), config, 128)).item()
            for i in range(config.validation_batches)
        ]
    model.train()
    return float(np.mean(losses))


def split_parameters(model: Any) -> tuple[list[Tensor], list[Tensor]]:
    """Hidden matrices for Muon; embeddings, the patch layers' inputs, norms and biases for AdamW."""
    matrices: list[Tensor] = []
    rest: list[Tensor] = []
    for name, parameter in model.named_parameters():
        inner = parameter.ndim == 2 and name.startswith(("encoder.block", "decoder.block"))
        (matrices if inner and "relative_attention_bias" not in name else rest).append(parameter)
    return matrices, rest


def _schedule(step: int, steps: int) -> float:
    """Learning-rate factor: linear warm-up, then a cosine to zero."""
    if step < _WARM_UP:
        return (step + 1) / _WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (step - _WARM_UP) / max(steps - _WARM_UP, 1)))
