"""Answers of services of weather and prices, in their documented layout, on loopback."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

import pandas as pd


@contextmanager
def service(answer: Callable[[str, dict, dict, bytes], tuple[int, str] | tuple[int, str, dict]]):
    """The address of a server that answers by `answer(path, parameters, headers, body)`; `asked` counts requests."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            there = urlsplit(self.path)
            parameters = {key: values[0] for key, values in parse_qs(there.query).items()}
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            status, text, *more = answer(there.path, parameters, dict(self.headers), body)
            self.send_response(status)
            for key, value in (more[0] if more else {}).items():
                self.send_header(key, value)
            self.end_headers()
            self.wfile.write(text.encode())

        do_POST = do_GET

        def log_message(self, *words):
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def open_meteo(begin: pd.Timestamp, hours: int, **changes) -> dict:
    """Layout of open-meteo.com/en/docs, `minutely_15` with `timeformat=unixtime`."""
    times = [int(begin.timestamp()) + 900 * k for k in range(4 * hours)]
    rows = {
        "time": times,
        "temperature_2m": [2.0 + 0.01 * k for k in range(len(times))],
        "shortwave_radiation_instant": [100.0] * len(times),
    }
    said = {
        "latitude": 52.0, "longitude": 13.0, "utc_offset_seconds": 0, "timezone": "GMT", "elevation": 30.0,
        "minutely_15_units": {"time": "unixtime", "temperature_2m": "°C", "shortwave_radiation_instant": "W/m²"},
        "minutely_15": rows,
    }  # fmt: skip
    return said | changes


def met_norway(begin: pd.Timestamp, cloud: float = 50.0) -> dict:
    """Layout of api.met.no/weatherapi/locationforecast/2.0: hourly for two days, then every six hours."""
    at = [begin + pd.Timedelta(hours=h) for h in (*range(54), *range(60, 200, 6))]
    series = [
        {
            "time": f"{t:%Y-%m-%dT%H:%M:%SZ}",
            "data": {"instant": {"details": {"air_temperature": 3.0, "cloud_area_fraction": cloud}}},
        }
        for t in at
    ]
    units = {"air_temperature": "celsius", "cloud_area_fraction": "%"}
    return {"type": "Feature", "properties": {"meta": {"units": units}, "timeseries": series}}


def entsoe(parts: list[tuple[str, str, str, dict[int, float]]], curve: str = "A03", unit: str = "MWH") -> str:
    """A Publication_MarketDocument with a time series for each (start, end, resolution, prices by position)."""
    series = "".join(
        f"<TimeSeries><mRID>{k}</mRID><currency_Unit.name>EUR</currency_Unit.name>"
        f"<price_Measure_Unit.name>{unit}</price_Measure_Unit.name><curveType>{curve}</curveType><Period>"
        f"<timeInterval><start>{start}</start><end>{end}</end></timeInterval><resolution>{resolution}</resolution>"
        + "".join(
            f"<Point><position>{p}</position><price.amount>{price}</price.amount></Point>"
            for p, price in prices.items()
        )
        + "</Period></TimeSeries>"
        for k, (start, end, resolution, prices) in enumerate(parts, 1)
    )
    space = "urn:iec62325.351:tc57wg16:451-3:publicationdocument:7:3"
    name = "Publication_MarketDocument"
    return f'<?xml version="1.0" encoding="utf-8"?><{name} xmlns="{space}">{series}</{name}>'
