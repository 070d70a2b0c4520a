"""`tf-mpc schema KIND`: the JSON Schema of a YAML file, for editors."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("kind", metavar="scenario|testcase|comparison|fleet|map")
@click.option("--out", type=click.Path(path_type=Path), help="File to write to.  [default: print it]")
def command(kind: str, out: Path | None) -> None:
    """Write the JSON Schema of a kind of file: scenario, testcase, comparison, fleet, or map (of
    measurements).

    An editor with a YAML language server completes and checks a file whose first line names its schema:

    \b
      # yaml-language-server: $schema=scenario.json

    `tf-mpc init` writes files that do. Options of controllers are in it; what several keys must fulfil together is
    checked by `tf-mpc validate` alone.

    \b
    Example:
      tf-mpc schema scenario --out scenario.json
    """
    from thermoforce_mpc.files import write_whole
    from thermoforce_mpc.simulation.schemas import schema_text

    text = schema_text(kind)
    if out is None:
        click.echo(text, nl=False)
        return
    write_whole(out, text)
    click.echo(f"Schema: {out}")
