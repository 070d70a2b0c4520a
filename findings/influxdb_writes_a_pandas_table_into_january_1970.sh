#!/usr/bin/env bash
# The client of InfluxDB 1 stamps the rows of a pandas 3 table with January 1970; its own successors do not.
#
# Versions: influxdb 5.3.2, influxdb-client 1.50.0, pandas 3.1.1
# A good guess: `DataFrameClient.write_points(table)` sends the instants of the index, in nanoseconds as InfluxDB's line protocol has
# them by default
# Seen: of an index in nanoseconds it does. pandas 3 makes microseconds of text and of CSV: their count is sent as one of
# nanoseconds, and 12 January 2026 is written as 21 January 1970, by time_precision="s" too; the server and the client say nothing.
# With protocol="json" the time is right, and influxdb-client (InfluxDB 2) is right for every unit
# Why it matters: a job that has filled a building's historian for years goes on without an error after an update of pandas, and
# every dashboard and every model is without readings from then on; with a retention policy they are dropped at once
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile influxdb==5.3.2 influxdb-client==1.50.0 pandas==3.1.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import io
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pandas as pd
from influxdb import DataFrameClient
from influxdb_client.client.write.dataframe_serializer import data_frame_to_list_of_points
from influxdb_client.client.write_api import PointSettings

sent = []


class Historian(BaseHTTPRequestHandler):
    """Takes what is written, as InfluxDB's /write does."""

    def do_POST(self):
        sent.append(self.rfile.read(int(self.headers["Content-Length"])).decode())
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


server = HTTPServer(("127.0.0.1", 0), Historian)
threading.Thread(target=server.serve_forever, daemon=True).start()
client = DataFrameClient("127.0.0.1", server.server_port, database="house")

read = pd.read_csv(io.StringIO("time,T\n2026-01-12 06:00,21.0\n"), index_col=0, parse_dates=True)
found = {}
for unit in (read.index.unit, "ns"):
    table = read.set_axis(read.index.as_unit(unit))
    for way in ({}, {"time_precision": "s"}, {"protocol": "json", "time_precision": "s"}):
        client.write_points(table, "room", **way)
        count = int(sent[-1].split()[-1])
        found[unit, *way.values()] = pd.Timestamp(count, unit="s" if way else "ns").floor("s")
    successor = data_frame_to_list_of_points(table, PointSettings(), data_frame_measurement_name="room")
    found[unit, "influxdb-client"] = pd.Timestamp(int(successor[0].split()[-1])).floor("s")
server.shutdown()
for way, time in found.items():
    print(*way, "->", time)
right, wrong = read.index[0], (1970, 1)
assert read.index.unit == "us"
assert all((found["us", *way].year, found["us", *way].month) == wrong for way in ((), ("s",)))
assert {time for way, time in found.items() if way not in {("us",), ("us", "s")}} == {right}
PY
