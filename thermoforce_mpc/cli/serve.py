"""`tf-mpc serve`: the embedded plant behind BOPTEST's REST protocol."""

from __future__ import annotations

import ipaddress
from pathlib import Path

import click

from thermoforce_mpc.errors import ConfigError


@click.command(short_help="Offer the embedded plant to clients written for BOPTEST.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="0 takes a free one.")
@click.option("--weather", default="synthetic", show_default=True, help="'synthetic', or a .mos or .epw file.")
@click.option("--prices", type=click.Path(path_type=Path), help="CSV (time, price) with a highly dynamic tariff.")
@click.option("--tests", type=click.IntRange(1, 100), default=8, show_default=True, help="Most tests at a time.")
@click.option("--idle", type=click.FloatRange(1.0), default=900.0, show_default=True, help="Drop idle tests after, s.")
def command(host: str, port: int, weather: str, prices: Path | None, tests: int, idle: float) -> None:
    """Offer the embedded plant behind BOPTEST's REST protocol, as test case bestest_hydronic_heat_pump.

    Each test takes up to some 150 MB when a year is simulated in it. There is no authentication: keep to the loopback
    address unless everybody who can reach this machine may use it. Stop with Ctrl-C.
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
        click.echo(f"Warning: {host} is open to other machines, without any authentication.", err=True)

    def ready(url: str) -> None:
        click.echo(f"Serving bestest_hydronic_heat_pump ({year.name}) at {url}. Stop with Ctrl-C.")

    serve(year, host=host, port=port, highly_dynamic=tariff, most_tests=tests, idle_s=idle, on_ready=ready)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
