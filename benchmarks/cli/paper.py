"""`tf-mpc paper`: the paper's tables, measured here, beside its figures."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.cli.options import FILE, FOLDER, NEW_FOLDER, QUICK, say
from thermoforce_mpc.cli.options import Opening, execution_options


@click.command()
@click.option("--only", multiple=True, metavar="TABLE", help="Only this part; repeatable.  [default: all]")
@click.option("--records", multiple=True, type=FOLDER, help="Folder with measured homes, as for bench factual.")
@click.option("--weather", type=FILE, help="Weather of the closed loop.")
@click.option(
    "--out",
    type=NEW_FOLDER,
    default=Path("runs/paper"),
    show_default=True,
    help="Folder.",
)
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Seeds of the closed loop.")
@execution_options()
@QUICK
def command(
    only: tuple[str, ...],
    records: tuple[Path, ...],
    weather: Path | None,
    out: Path,
    seeds: int,
    engine: Opening,
    quick: bool,
) -> None:
    """Measure the paper's tables here, and write them beside its figures: tables.md, tables.csv and tables.json.

    Parts: interventions, homes, closed-loop, ablation, gamma, efficiency (extras [bench] and [energyplus]). What cannot
    be measured here is said in its table, and the exit code is 1. Of the closed loop every seed of probing and training
    is shown, with the mean and from three on its 95 % interval.

    \b
    Examples:
      tf-mpc paper
      tf-mpc paper --only closed-loop --weather Brussels.mos
    """
    from benchmarks.paper.parts import PARTS, Setting
    from benchmarks.paper.run import run_paper
    from thermoforce_mpc.errors import InputError, suggestion

    for name in only:
        if name not in PARTS:
            raise InputError(
                f"--only {name}: no such part{suggestion(name, list(PARTS))}; there are {', '.join(PARTS)}"
            )
    with engine(say) as where:
        content = run_paper(only or tuple(PARTS), Setting(out, records, weather, quick, where, say, seeds))
    missing = [f"{name} ({part['missing']})" for name, part in content["parts"].items() if part["missing"]]
    click.echo(f"{len(content['rows'])} figures: {out / 'tables.md'}, tables.csv, tables.json")
    if missing:
        click.echo(f"Not reproduced here: {'; '.join(missing)}")
        raise SystemExit(1)
