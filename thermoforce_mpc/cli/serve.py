"""`tf-mpc serve`: serve the embedded plant over BOPTEST's REST protocol."""

from __future__ import annotations

import ipaddress
from pathlib import Path

import click

from thermoforce_mpc.errors import ConfigError


@click.command(short_help="Serve the embedded plant over BOPTEST's REST protocol.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="Port; 0 picks a free one."
)
@click.option("--weather", default="synthetic", show_default=True, help="'synthetic', or a .mos or .epw file.")
@click.option("--prices", type=click.Path(path_type=Path), help="CSV (time s, price per kWh): highly dynamic tariff.")
@click.option(
    "--tests", type=click.IntRange(1, 100), default=8, show_default=True, help="Largest number of tests at a time."
)
@click.option(
    "--idle",
    type=click.FloatRange(1.0),
    default=900.0,
    show_default=True,
    help="Seconds after which an idle test is dropped.",
)
def command(host: str, port: int, weather: str, prices: Path | None, tests: int, idle: float) -> None:
    """Serve the embedded plant over BOPTEST's REST protocol, as test case bestest_hydronic_heat_pump.

    A test takes up to about 150 MB of memory for a simulated year. There is no authentication: keep the loopback
    address unless every machine that can reach this one may use the service. Stop with Ctrl-C.
    """
    try:
        from thermoforce_mpc.service.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("flask", "waitress", "werkzeug"):
            raise
        raise ConfigError(
            f"serving needs {error.name}, which is not installed: pip install 'thermoforce-mpc[serve]'"
        ) from error
    from thermoforce_mpc.boundary.tariffs import tariff_from_file
    from thermoforce_mpc.boundary.weather import load_weather, synthetic_weather

    year = synthetic_weather() if weather == "synthetic" else load_weather(Path(weather))
    tariff = tariff_from_file(prices) if prices else None
    if not _is_loopback(host):
        click.echo(f"Warning: {host} can be reached from other machines; the service has no authentication.", err=True)

    def ready(url: str) -> None:
        click.echo(f"Serving bestest_hydronic_heat_pump ({year.name}) at {url}. Stop with Ctrl-C.")

    serve(year, host=host, port=port, highly_dynamic=tariff, most_tests=tests, idle_s=idle, on_ready=ready)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
