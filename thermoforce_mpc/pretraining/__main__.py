"""Make the shipped forecaster: `python -m thermoforce_mpc.pretraining --out FOLDER`."""

from __future__ import annotations

from pathlib import Path

import click

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.pretraining.training import TrainingConfig, pretrain


@click.command(context_settings={"show_default": True})
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder for state and checkpoint.")
@click.option("--steps", default=TrainingConfig.steps, help="Training steps.")
@click.option("--batch", default=TrainingConfig.batch, help="Series per step.")
@click.option("--seed", default=TrainingConfig.seed, help="Seed of weights and series.")
@click.option("--threads", default=1, help="CPU threads; one is reproducible.")
@click.option("--force", is_flag=True, help="Train anew over what the folder holds.")
def main(out: Path, steps: int, batch: int, seed: int, threads: int, force: bool) -> None:
    """Train the forecaster on synthetic series; an interrupted run goes on where it stopped.

    The checkpoint is FOLDER/checkpoint. To ship it, copy its files to thermoforce_mpc/data/bolt_thermal.
    """
    import torch

    torch.set_num_threads(threads)
    config = TrainingConfig(steps=steps, batch=batch, seed=seed)
    try:
        checkpoint = pretrain(out, config, lambda line: click.echo(line), force=force)
    except ConfigError as error:
        click.echo(f"Error: {error}", err=True)
        raise SystemExit(2) from None
    click.echo(f"Checkpoint: {checkpoint}")


if __name__ == "__main__":
    main()
