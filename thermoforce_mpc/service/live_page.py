"""A page that shows a running controller and, where somebody hears it, takes what people ask.

It asks for the view every few seconds, by addresses relative to its own, so that it may stand behind Home Assistant's
ingress. It holds nothing of the building itself: what does is asked for with the login.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Protocol

from flask import Flask, Response, request
from werkzeug.exceptions import HTTPException

from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.files import is_loopback
from thermoforce_mpc.service.access import (
    HostNames,
    Rate,
    Refusal,
    check_authorization,
    check_page,
    is_signed,
    signed,
)
from thermoforce_mpc.service.server import Server, bound, run_to_its_end, serve_on

HOST = "127.0.0.1"
SUPERVISOR = "172.30.32.2"
"""From where ingress asks, for users that Home Assistant has logged in; nobody else may:
https://developers.home-assistant.io/docs/add-ons/presentation/#ingress"""
_MOST_BYTES, _THREADS, _PER_SECOND = 10_000, 4, 20.0
_COOKIE, _LOGIN_S = "tf-mpc", 90 * 86_400
_HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors "
)


class Hears(Protocol):
    """Who hears what people ask."""

    def shown(self) -> Mapping[str, Any]:
        """What is asked now, for the page; `asks`: the keys that may be."""

    def ask(self, key: str, text: str) -> None:
        """Ask for something; raises `ConfigError` for what cannot be."""


@dataclass(frozen=True)
class PageAccess:
    """Who may see the page and ask by it: who has the `token`, if there is one, by `names`, addresses or localhost.

    `ingress`: only whom Home Assistant lets through, and this machine; `option`: of the command line, for `names`.
    """

    token: str | None = None
    names: Collection[str] = ()
    ingress: bool = False
    option: str = ""


def live_app(view: Callable[[], Mapping[str, Any]], hears: Hears | None, access: PageAccess | None) -> Flask:
    """The application: the page at `/`, what `view`, called by one thread at a time, tells at `/view.json`, and what
    people ask at `/ask`, as JSON {"key": "boost", "text": "60"}.
    """
    app, access = Flask(__name__, static_folder=None), access or PageAccess()
    app.config["MAX_CONTENT_LENGTH"] = _MOST_BYTES
    page = files("thermoforce_mpc.service").joinpath("live_page.html").read_text(encoding="utf-8")
    lock, asking = threading.Lock(), threading.Lock()
    own, rate, logins = HostNames(access.names, access.option), Rate(_PER_SECOND), Rate(1.0)
    headers = _HEADERS | {"Content-Security-Policy": _POLICY + ("'self'" if access.ingress else "'none'")}

    @app.before_request
    def only_whom_it_is_for() -> None:
        peer = request.remote_addr or ""
        if access.ingress and peer == SUPERVISOR:  # asks by whatever name people reach Home Assistant
            check_page(request.headers, request.headers.get("Host", ""), request.headers.get("X-Forwarded-Host", ""))
        elif access.ingress and not is_loopback(peer):
            raise Refusal(403, "This page is for Home Assistant alone.")
        else:
            rate.admit(peer)
            own.check(request.headers)
        token = access.token if request.endpoint in ("now", "ask") else None
        if token is not None and not is_signed(request.cookies.get(_COOKIE, ""), token, time.time()):
            check_authorization(request.headers.get("Authorization"), token)

    @app.errorhandler(Refusal)
    def refused(error: Refusal) -> Response:
        return _json(error.status, {"error": error.message})

    @app.errorhandler(ThermoForceError)
    def failed(error: ThermoForceError) -> Response:
        return _json(500, {"error": str(error)})

    @app.errorhandler(Exception)
    def broken(error: Exception) -> Response:
        if isinstance(error, HTTPException):
            return _json(error.code or 500, {"error": error.name})
        return _json(500, {"error": f"the page failed ({type(error).__name__})"})

    @app.after_request
    def with_headers(response: Response) -> Response:
        response.headers.update(headers)
        return response

    @app.get("/")
    def index() -> Response:
        return Response(page, mimetype="text/html")

    @app.get("/view.json")
    def now() -> Response:
        with lock:
            told = dict(view())
        return _json(200, told | ({} if hears is None else {"people": dict(hears.shown())}))

    @app.post("/ask")
    def ask() -> Response:
        said = _said("key", "text")
        if hears is None:
            raise Refusal(404, "Nobody hears this page: it only shows.")
        with asking:  # not behind a view, which takes a minute where the journal of a year is read first
            try:
                hears.ask(said["key"], said["text"])
            except ThermoForceError as error:
                raise Refusal(400, str(error)) from error
        return _json(200, {"people": dict(hears.shown())})

    @app.post("/login")
    def login() -> Response:
        logins.admit(request.remote_addr or "")
        given = _said("token")["token"]
        if access.token is not None:
            check_authorization(f"Bearer {given}", access.token)
        answer = _json(200, {})
        if access.token is not None:
            proof = signed(access.token, int(time.time()) + _LOGIN_S)
            answer.set_cookie(_COOKIE, proof, max_age=_LOGIN_S, httponly=True, samesite="Strict")
        return answer

    return app


def _said(*keys: str) -> dict[str, str]:
    """Texts by `keys` of a request; raises `Refusal` for any other, which a form of another site can send too."""
    if request.mimetype != "application/json":
        raise Refusal(415, "Send application/json.")
    try:
        said = json.loads(request.get_data())
    except (ValueError, RecursionError) as error:
        raise Refusal(400, "The body is not JSON.") from error
    if not isinstance(said, dict) or set(said) != set(keys) or not all(isinstance(one, str) for one in said.values()):
        raise Refusal(400, f"Expected an object of texts: {', '.join(keys)}.")
    return said


def _json(status: int, content: Mapping[str, Any]) -> Response:
    return Response(json.dumps(content, allow_nan=False), status, mimetype="application/json")


def page_server(
    view: Callable[[], Mapping[str, Any]],
    port: int,
    *,
    host: str = HOST,
    hears: Hears | None = None,
    access: PageAccess | None = None,
) -> Server:
    """Bind the page; `run()` of the server serves until `close()`. Raises `PlantError` where the port is taken."""
    listening = bound(host, port, "another --port")
    return serve_on(listening, live_app(view, hears, access), threads=_THREADS, most_bytes=_MOST_BYTES)


def serve_page(view: Callable[[], Mapping[str, Any]], port: int, on_ready: Callable[[str], None]) -> None:
    """Serve until interrupted; `on_ready` is called with the address. Errors as for `page_server`."""
    run_to_its_end(page_server(view, port), lambda at: on_ready(f"http://{HOST}:{at}/"))
