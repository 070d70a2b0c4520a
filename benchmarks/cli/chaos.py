"""`tf-mpc chaos`: runs behind a proxy that makes troubles on purpose."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.cli.options import JSON
from thermoforce_mpc.cli.options import FiniteRange


@click.command()
@click.option("--episodes", type=click.IntRange(1, 100_000), default=20, show_default=True, help="Number of episodes.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Seed of the troubles.")
@click.option("--days", type=FiniteRange(0.1, 60), default=2.0, show_default=True, help="Scored days an episode.")
@click.option(
    "--controller",
    metavar="NAME",
    default="thermoforce_mpc",
    show_default=True,
    help="An MPC (see `tf-mpc controllers`).",
)
@click.option("--model", type=click.Path(path_type=Path), help="Saved model to use instead of probing first.")
@click.option(
    "--jobs", "--workers", "jobs", type=click.IntRange(1, 256), default=1, show_default=True, help="Parallel processes."
)
@click.option("--keep", type=click.Path(path_type=Path), help="Keep the journal of every episode in this folder.")
@JSON
def command(
    episodes: int,
    seed: int,
    days: float,
    controller: str,
    model: Path | None,
    jobs: int,
    keep: Path | None,
    json_file: Path | None,
) -> None:
    """Run episodes of an MPC on the embedded plant over REST, with a faulty proxy between client and service.

    Each episode meets one to three troubles, drawn from the seed: errors (400, 429, 5xx), time-outs, connections reset
    before or after the request was handed on, half answers, doubled and late requests, JSON of another kind, redirects,
    pages, null and old answers in place of the service's, clocks that are wrong, readings in °C, prices times 100,
    power or heat in kW, a service away for up to 14 minutes, one that gives no forecasts, for hours or for good, or
    forgot its test, readings missing, NaN or stuck, and a solver or forecaster that raises, hangs, returns NaN, levels
    out of range or of another shape, or 59,574 °C. Pauses of the client pass at once; services run in these processes.

    A quarter as many trials follow: journals with flipped bits, folders of other people with a link, a pipe or an
    address, tables that never end, are damaged, or torn while they are read, models whose heat cannot be or whose card
    is made up, stamps ahead or behind, two controllers of one house, a house whose network, broker or readings are
    away, whose clock is stepped or whose controller is killed, FMUs that hang, creep, fail or crash.

    Of every episode it is checked that no error ended it (a service that forgot its test may, with a named one), that
    every action sent was finite and in range, that the journal has every simulated step once, that the test was
    stopped, that wrong units were said, that it was not silent for 10 s, and that discomfort was at most 1.5 times that
    of the same run without faults and 1 K·h. Exit code 1 where one of these does not hold. After Ctrl-C the table is
    that of the episodes until then (exit code 130).

    \b
    Examples:
      tf-mpc chaos
      tf-mpc chaos --episodes 200 --seed 7 --jobs 4 --json chaos.json --keep chaos
    """
    from benchmarks.chaos.episodes import run_chaos
    from benchmarks.cli.show import show
    from thermoforce_mpc.model.thermal_model import load_model

    found = run_chaos(
        episodes=episodes,
        seed=seed,
        days=days,
        controller=controller,
        model=load_model(model) if model else None,
        jobs=jobs,
        keep=keep,
        progress=lambda line: click.echo(line, err=True),
    )
    show(found, json_file)
    if not all(target["holds"] for target in found["targets"]):
        raise SystemExit(1)
    if found["rows"][-1]["episodes"] < episodes:
        raise SystemExit(130)
