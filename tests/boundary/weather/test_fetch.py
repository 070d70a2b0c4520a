"""Fetching over a real socket: the right file, wrong ones, none, and nothing left behind."""

from __future__ import annotations

from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.boundary.weather.readers import FILE_NAME, fetch_brussels
from thermoforce_mpc.errors import WeatherError


def weather_file(T: float) -> bytes:
    row = "{} {} 1 0 101300 0 0 0 {} 0 0 0 0 0 0 200 4 0 5 10 22000"
    header = ["#1", "double tab1(8760,30)", "#LOCATION,TOWN,-,BEL,IWEC,064510,50.90,4.53,1.0,58.0"]
    return "\n".join(
        [*header, *(row.format(h * 3600.0, T + h % 2, 100 * (h % 24 == 12)) for h in range(8760))]
    ).encode()


@pytest.fixture
def server() -> Iterator[tuple[str, dict[str, bytes], list[str]]]:
    files: dict[str, bytes] = {}
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            body = files.get(self.path)
            self.send_response(200 if body is not None else 404)
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        thread = Thread(target=http.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield f"http://127.0.0.1:{http.server_port}", files, asked
        http.shutdown()
        thread.join()


@pytest.fixture
def fingerprint(tmp_path) -> str:
    path = tmp_path / "original.mos"
    path.write_bytes(weather_file(5.0))
    return load_weather(path).fingerprint


def test_it_is_fetched_once_and_then_kept(server, fingerprint, tmp_path):
    url, files, asked = server
    files["/w"] = weather_file(5.0)
    folder = tmp_path / "cache" / "weather"
    path = fetch_brussels(folder, f"{url}/w", fingerprint)
    assert load_weather(path).fingerprint == fingerprint
    assert fetch_brussels(folder, f"{url}/w", fingerprint) == path
    assert asked == ["/w"]


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (weather_file(6.0), "another weather year"),
        (b"<html>sign in</html>", "did not answer with a weather file"),
        (weather_file(5.0)[:100_000], "did not answer with a weather file"),
        (b"#" * 6_000_000, "not a weather file"),
        (None, "cannot be fetched .HTTPError."),
    ],
    ids=["other year", "page", "truncated", "huge", "missing"],
)
def test_anything_else_is_refused_and_leaves_nothing(server, fingerprint, tmp_path, body, message):
    url, files, _ = server
    if body is not None:
        files["/w"] = body
    folder = tmp_path / "cache"
    with pytest.raises(WeatherError, match=message):
        fetch_brussels(folder, f"{url}/w", fingerprint)
    assert not folder.exists() or not list(folder.iterdir())


def test_no_network_says_what_to_do(fingerprint, tmp_path):
    with pytest.raises(WeatherError, match=r"with no network, copy Brussels\.mos"):
        fetch_brussels(tmp_path, "http://127.0.0.1:9/w", fingerprint)


def test_another_file_of_that_name_is_not_taken_nor_overwritten(server, fingerprint, tmp_path):
    url, files, _ = server
    files["/w"] = weather_file(5.0)
    (tmp_path / FILE_NAME).write_bytes(weather_file(7.0))
    with pytest.raises(WeatherError, match="move the file"):
        fetch_brussels(tmp_path, f"{url}/w", fingerprint)
    assert (tmp_path / FILE_NAME).read_bytes() == weather_file(7.0)


def test_the_pinned_fingerprint_is_the_test_cases(shared):
    brussels = load_weather(shared / "boptest_hp" / "Brussels.mos")
    assert fetch_brussels(shared / "boptest_hp").name == FILE_NAME
    assert brussels.fingerprint == "7856f6e4b8b7"
