"""Train and evaluate the shipped forecaster: `python -m benchmarks.pretraining train|evaluate|export`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from benchmarks.pretraining.evaluation import evaluate
from benchmarks.pretraining.training import TrainingConfig, pretrain, weights_sha256
from thermoforce_mpc.errors import BackboneError, ConfigError


@click.group(context_settings={"show_default": True})
@click.option("--threads", default=1, help="CPU threads; results are reproducible with one.")
def main(threads: int) -> None:
    """Train, evaluate or export the shipped forecaster."""
    import torch

    torch.set_num_threads(threads)


@main.command()
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for state and checkpoint.")
@click.option("--steps", default=TrainingConfig.steps, help="Training steps.")
@click.option("--batch", default=TrainingConfig.batch, help="Series per step.")
@click.option("--seed", default=TrainingConfig.seed, help="Seed of weights and series.")
@click.option("--start-from", type=click.Path(path_type=Path), help="Checkpoint to start from (for a later stage).")
@click.option("--rate-scale", default=TrainingConfig.rate_scale, help="Factor on the learning rates.")
@click.option("--d-model", default=TrainingConfig.d_model, help="Width of the model; d_ff is four times as large.")
@click.option("--encoder-layers", default=TrainingConfig.encoder_layers, help="Number of encoder layers.")
@click.option("--bfloat16", is_flag=True, help="Matrix products in bfloat16 (faster if the processor supports it).")
@click.option("--weather", is_flag=True, help="A Chronos-2 with known weather ahead instead of a Chronos-Bolt.")
@click.option("--workers", default=0, help="Processes that draw series ahead; the series are the same.")
@click.option("--force", is_flag=True, help="Overwrite the run in the folder.")
def train(out: Path, start_from: Path | None, force: bool, workers: int, **options: Any) -> None:
    """Train the forecaster on synthetic series; an interrupted run is resumed.

    The checkpoint is OUT/checkpoint. To ship it, copy its files to a folder of
    thermoforce_mpc/model/free_response/backbones/weights and export it there.
    """
    try:
        start_sha256 = weights_sha256(start_from) if start_from else ""
        config = TrainingConfig(start_sha256=start_sha256, **options)
        checkpoint = pretrain(
            out, config, lambda line: click.echo(line), start=start_from, force=force, workers=workers
        )
    except ConfigError as error:
        raise _failure(error) from None
    click.echo(f"Checkpoint: {checkpoint}")


@main.command("evaluate")
@click.argument("checkpoint", type=click.Path(path_type=Path))
@click.option("--series", default=1024, help="Number of held-out synthetic series.")
@click.option("--seed", default=TrainingConfig.seed, help="Seed of the series; a stream not used in training.")
def evaluate_command(checkpoint: Path, series: int, seed: int) -> None:
    """Score CHECKPOINT on held-out synthetic series and write CHECKPOINT/evaluation.json."""
    try:
        scores = evaluate(checkpoint, series=series, seed=seed)
    except (BackboneError, ConfigError) as error:
        raise _failure(error) from None
    click.echo("context  model  persistence  seasonal naive  inside 80 %   (mean absolute error / scale of context)")
    for row in scores["contexts"]:
        click.echo(
            f"{row['context']:7d}  {row['model']:5.3f}  {row['persistence']:11.3f}  {row['seasonal_naive']:14.3f}  "
            f"{row['inside_80']:11.3f}"
        )
    click.echo(f"{scores['milliseconds']:.1f} ms per forecast")
    (checkpoint / "evaluation.json").write_text(json.dumps(scores, indent=1) + "\n", encoding="utf-8")


@main.command("export")
@click.argument("checkpoint", type=click.Path(path_type=Path))
def export_command(checkpoint: Path) -> None:
    """Write CHECKPOINT/model.onnx, its operations for ONNX Runtime; needs the packages onnx and onnxscript."""
    from benchmarks.pretraining.export import export

    try:
        written = export(checkpoint)
    except BackboneError as error:
        raise _failure(error) from None
    click.echo(f"Written: {written}, {written.stat().st_size / 1e3:.0f} kB")


def _failure(error: Exception) -> SystemExit:
    click.echo(f"Error: {error}", err=True)
    return SystemExit(2)


if __name__ == "__main__":
    main()
