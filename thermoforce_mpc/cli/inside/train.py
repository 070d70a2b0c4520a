"""`tf-mpc train`: train the policy of `controller: dpc` and write it."""

from __future__ import annotations

import time
from pathlib import Path

import click

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.settings import parse_overrides

_EVERY = 25


@click.command()
@click.argument("model", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--testcase", required=True, help="Test case that the model was identified on.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the policy.")
@click.option("--force", is_flag=True, help="Overwrite a policy there.")
@click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Option of the controller, such as training.seed=2."
)
def command(model: Path, testcase: str, out: Path, force: bool, settings: tuple[str, ...]) -> None:
    """Train a policy through the saved MODEL (`tf-mpc identify`), for use by the controller dpc.

    It is trained on courses of free response, comfort bounds and prices drawn at random; about a minute on one core.

    \b
    Example:
      tf-mpc identify --testcase bestest_hydronic_heat_pump --out my_model
      tf-mpc train my_model --testcase bestest_hydronic_heat_pump --out my_policy
      tf-mpc run --testcase bestest_hydronic_heat_pump --controller dpc --model my_model \\
        --set controller.options.policy=my_policy
    """
    from controllers.dpc.config import DPCConfig
    from controllers.dpc.controller import DPC
    from controllers.dpc.policy import check_target
    from controllers.registry import controller_config
    from thermoforce_mpc.model.thermal_model import load_model
    from thermoforce_mpc.plants.testcases import load_testcase

    if out.exists() and not force:
        raise ConfigError(f"--out: {out} exists already; choose another folder, or give --force")
    check_target(out, overwrite=force)
    building = load_testcase(testcase)
    config = controller_config("dpc", parse_overrides(settings), building)
    assert isinstance(config, DPCConfig)
    if config.policy is not None:
        raise ConfigError("--set policy: this command trains one; leave it out")
    began, total = time.perf_counter(), config.training.iterations

    def report(done: int, loss: float) -> None:
        if done % _EVERY == 0 or done == total:
            click.echo(f"{done:5d} of {total}  loss {loss:.3f}  {time.perf_counter() - began:.0f} s", err=True)

    policy = DPC(load_model(model), config, progress=report).policy
    policy.save(out, overwrite=force)
    click.echo(f"{out}: policy of {policy.iterations} iterations, loss {policy.loss:.3f} (1: full level all the time)")
