"""A page on this machine that shows a running controller; it asks for the view of `tf-mpc watch` every few seconds."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

from flask import Flask, Response, request

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.service.access import HostNames, Refusal
from thermoforce_mpc.service.server import Server, bound, run_to_its_end, serve_on

HOST = "127.0.0.1"
_MOST_BYTES, _THREADS = 10_000, 4
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


def live_app(view: Callable[[], Mapping[str, Any]]) -> Flask:
    """The application: the page at `/`, and what `view`, called by one thread at a time, tells at `/view.json`."""
    app = Flask(__name__, static_folder=None)
    page = files("thermoforce_mpc.service").joinpath("live_page.html").read_text(encoding="utf-8")
    own, lock = HostNames(), threading.Lock()

    @app.before_request
    def only_here() -> None:
        own.check(request.headers)

    @app.errorhandler(Refusal)
    def refused(error: Refusal) -> Response:
        return Response(error.message, error.status, mimetype="text/plain")

    @app.after_request
    def with_headers(response: Response) -> Response:
        response.headers.update(_HEADERS)
        return response

    @app.get("/")
    def index() -> Response:
        return Response(page, mimetype="text/html")

    @app.get("/view.json")
    def now() -> Response:
        try:
            with lock:
                told = view()
            return Response(json.dumps(told, allow_nan=False), mimetype="application/json")
        except ThermoForceError as error:
            return Response(json.dumps({"error": str(error)}), 500, mimetype="application/json")

    return app


def page_server(view: Callable[[], Mapping[str, Any]], port: int) -> Server:
    """Bind the page; `run()` of the server serves until `close()`. Raises `PlantError` where the port is taken."""
    listening = bound(HOST, port, "another --port")
    return serve_on(listening, live_app(view), threads=_THREADS, most_bytes=_MOST_BYTES)


def serve_page(view: Callable[[], Mapping[str, Any]], port: int, on_ready: Callable[[str], None]) -> None:
    """Serve until interrupted; `on_ready` is called with the address. Errors as for `page_server`."""
    run_to_its_end(page_server(view, port), lambda at: on_ready(f"http://{HOST}:{at}/"))
