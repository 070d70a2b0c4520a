"""`tf-mpc serve`: serve the embedded plant over BOPTEST's REST protocol."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from thermoforce_mpc.cli.options import PATH, FiniteRange
from thermoforce_mpc.errors import ConfigError

_TESTS, _LEAST_1 = click.IntRange(1, 100), FiniteRange(1.0)


@click.command()
@click.option(
    "--testcase",
    type=click.Choice(["bestest_hydronic_heat_pump", "bestest_hydronic", "bestest_air"]),
    default="bestest_hydronic_heat_pump",
    show_default=True,
    help="Which of the embedded test cases.",
)
@click.option("--host", default="127.0.0.1", help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=8000, help="Port; 0 picks a free one.")
@click.option(
    "--name", "names", multiple=True, help="Name by which clients ask, besides its address and localhost; repeatable."
)
@click.option("--weather", default="synthetic", help="'synthetic', or a .mos or .epw file.")
@click.option("--prices", type=PATH, help="CSV (time s, price per kWh): highly dynamic tariff.")
@click.option("--tests", "most_tests", type=_TESTS, default=8, help="Largest number of tests at a time.")
@click.option(
    "--tests-each",
    type=_TESTS,
    help="Largest number of tests that one address started.  [default: all; half where other machines can ask]",
)
@click.option("--idle", "idle_s", type=_LEAST_1, default=900.0, help="Seconds after which an idle test is dropped.")
@click.option(
    "--lifetime", "lifetime_s", type=_LEAST_1, default=7 * 86400.0, help="Seconds after which any test is dropped."
)
@click.option(
    "--request-bytes",
    "most_bytes",
    type=click.IntRange(1000, 100_000_000),
    default=1_000_000,
    help="Longest request body, bytes; longer ones get status 413.",
)
@click.option(
    "--rate",
    "per_second",
    type=_LEAST_1,
    default=500.0,
    help="Requests a second from one address; more get status 429.",
)
@click.option(
    "--token",
    envvar="BOPTEST_TOKEN",
    show_envvar=True,
    help="Every request must send it as 'Authorization: Bearer TOKEN'. As an option it shows in the process list.",
)
def serve(testcase: str, host: str, weather: str, prices: Path | None, token: str | None, **options: Any) -> None:
    """Serve an embedded plant over BOPTEST's REST protocol.

    A test takes up to about 150 MB of memory for a simulated year. An address that other machines can reach needs a
    token: set BOPTEST_TOKEN here and where the client runs. Traffic is not encrypted. /openapi.json describes the
    protocol. Stop with Ctrl-C.
    """
    try:
        import flask  # noqa: F401

        from thermoforce_mpc.files import is_loopback
        from thermoforce_mpc.service.access import check_token
        from thermoforce_mpc.service.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("flask", "waitress", "werkzeug"):
            raise
        raise ConfigError(
            f"serving needs {error.name}, which is not installed: pip install 'thermoforce-mpc[serve]'"
        ) from error
    from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather
    from thermoforce_mpc.plants.embedded.cases import CASES
    from thermoforce_mpc.plants.registry import tariff_of

    synthetic = weather == "synthetic"
    year = synthetic_weather(climate=CASES[testcase].climate) if synthetic else load_weather(Path(weather))
    tariff = tariff_of(prices) if prices else None
    check_token(host, token or None)
    if not is_loopback(host):
        click.echo(
            f"Warning: {host} can be reached from other machines. Every request needs the token; the traffic is not "
            "encrypted: outside a network that you trust, put a proxy with TLS in front.",
            err=True,
        )

    def ready(url: str) -> None:
        needed = " Requests need the token." if token else ""
        click.echo(f"Serving {testcase} ({year.name}) at {url}.{needed} Stop with Ctrl-C.")

    serve(year, testcase=testcase, host=host, highly_dynamic=tariff, token=token or None, on_ready=ready, **options)
