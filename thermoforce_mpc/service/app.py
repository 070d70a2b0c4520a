"""The REST interface: paths, envelope and status codes of the BOPTEST service (a WSGI application)."""

from __future__ import annotations

import functools
import io
import json
import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import IO, Any

from flask import Flask, Request, Response, request
from werkzeug.exceptions import HTTPException, MethodNotAllowed, NotFound

from thermoforce_mpc.data import Period
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP
from thermoforce_mpc.plants.embedded.emulator import Emulator
from thermoforce_mpc.service.access import HostNames, Rate, Refusal, check_authorization
from thermoforce_mpc.service.endpoints import FORMS, NAMESPACE, Endpoint, document, endpoints
from thermoforce_mpc.service.points import served_points
from thermoforce_mpc.service.sessions import Session, Sessions, UnknownTestid
from thermoforce_mpc.version import VERSION

_LOG = logging.getLogger(__name__)
# Deepest nesting of a JSON body: the deepest that is allowed anywhere is a list in an object.
_MOST_DEPTH = 8
_MOST_SAID = 500


@dataclass(frozen=True)
class ServiceLimits:
    """Bounds of the service."""

    most_tests: int = 8  # at a time
    tests_each: int | None = None  # started by one address; None: all
    idle_s: float = 900.0  # without requests until a test is dropped, s
    lifetime_s: float = 7 * 86400.0  # until a test is dropped in any case, s
    most_bytes: int = 1_000_000  # of a request body
    per_second: float = 500.0  # requests from one address; twice as many in a burst


def create_app(
    make_plant: Callable[[], Emulator],
    limits: ServiceLimits | None = None,
    *,
    testcase: str = HEAT_PUMP.name,
    token: str | None = None,
    names: Iterable[str] = (),
) -> Flask:
    """WSGI application of the service: plants of `make_plant`, of `testcase`.

    `token`: what every request needs (None: nothing). `names`: by which it may be asked, besides addresses and
    localhost.
    """
    limits = limits or ServiceLimits()
    lock, first_plant = threading.Lock(), functools.cache(make_plant)

    def period(name: str) -> Period:
        """A scored window, of one plant for all tests: finding it can take the simulation of a year."""
        with lock:
            return first_plant().period(name)

    sessions = Sessions(
        lambda: Session(make_plant(), period),
        most=limits.most_tests,
        each=limits.tests_each,
        idle_s=limits.idle_s,
        lifetime_s=limits.lifetime_s,
    )
    app = Flask(__name__, static_folder=None)
    app.config["MAX_CONTENT_LENGTH"] = limits.most_bytes
    app.url_map.merge_slashes = False
    rate, own = Rate(limits.per_second), HostNames(names, "--name")
    points = served_points(testcase)
    described = document(points, token=token is not None)

    @app.before_request
    def admit() -> None:
        rate.admit(_client())
        own.check(request.headers)
        if token:
            check_authorization(request.headers.get("Authorization"), token)

    @app.get("/openapi.json")
    def openapi() -> Response:
        return _json(200, described)

    @app.get("/version")
    def version() -> Response:
        return _envelope(200, "The version of this service.", {"version": f"{VERSION}+thermoforce-mpc"})

    @app.get("/testcases")
    @app.get(f"/testcases/{NAMESPACE}")
    def testcases() -> Response:
        return _json(200, [{"testcaseid": testcase}])

    @app.post("/testcases/<name>/select")
    @app.post("/testcases/<name>/select<how>")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select<how>")
    def select(name: str, how: str = "") -> Response:
        if name != testcase:
            return _envelope(404, f"No test case {name[:80]!r}; this service offers {testcase}.", None)
        return _json(200, {"testid": sessions.select(_client())})

    @app.get("/status/<testid>")
    def status(testid: str) -> Response:
        sessions.check(testid)
        return _json(200, "Running")

    @app.put("/stop/<testid>")
    def stop(testid: str) -> Response:
        sessions.stop(testid)
        return Response("OK", 200, mimetype="text/plain")

    def add(endpoint: Endpoint) -> None:
        def answer(testid: str | None = None) -> Response:
            body = _body(request) if endpoint.body is not None else {}
            # Up to BOPTEST 0.6 a container ran one test case, and paths had no test id.
            with sessions.using(sessions.lone(_client()) if testid is None else testid) as session:
                reply = endpoint.answer(session, body)
            return _envelope(200, reply.message, reply.payload)

        for path in (f"/{endpoint.verb}", f"/{endpoint.verb}/<testid>"):
            app.add_url_rule(path, f"{endpoint.method} {path}", answer, methods=[endpoint.method])

    for endpoint in endpoints(points):
        add(endpoint)

    @app.errorhandler(Refusal)
    def refused(error: Refusal) -> Response:
        answer = _envelope(error.status, error.message, None)
        if error.status == 429:
            answer.headers["Retry-After"] = "1"
        if error.status == 401:
            answer.headers["WWW-Authenticate"] = "Bearer"
        return answer

    @app.errorhandler(UnknownTestid)
    def unknown(error: UnknownTestid) -> Response:
        testid = str(error)[:80]
        item = {"value": testid, "msg": f"Invalid testid: {testid}", "param": "testid", "location": "params"}
        return _json(400, {"errors": [item]})

    @app.errorhandler(HTTPException)
    def http_error(error: HTTPException) -> Response:
        attempt = f"{request.method} {request.path[:80]}"
        if isinstance(error, NotFound):
            return _envelope(404, f"{attempt}: no such endpoint; /openapi.json lists all.", None)
        if isinstance(error, MethodNotAllowed):
            methods = [name for name in error.valid_methods or () if name not in ("HEAD", "OPTIONS")]
            answer = _envelope(405, f"{attempt}: use {' or '.join(sorted(methods))}.", None)
            answer.headers["Allow"] = ", ".join(error.valid_methods or ())
            return answer
        return _envelope(error.code or 500, error.description or error.name, None)

    @app.errorhandler(Exception)
    def internal(error: Exception) -> Response:
        app.logger.exception("%s %s failed", request.method, request.path)
        # What happened is in the log: an error's text may show more of this machine than a client should see.
        return _envelope(500, f"Internal error ({type(error).__name__}); the service's log has more.", None)

    return app


def _client() -> str:
    return request.remote_addr or ""


def _body(request: Request) -> dict[str, Any]:
    """Values of the request body: a JSON object, or a form (older clients). BOPTEST ignores any other, so do we."""
    text = request.get_data()
    if text and request.mimetype not in ("application/json", *FORMS):
        kind = request.mimetype or "none"
        _LOG.warning("%s: a body of type %.80r is ignored; send application/json", request.path[:80], kind)
        return {}
    if not text.strip():
        return {}
    if request.mimetype in FORMS:
        return _form(request, text)
    try:
        body = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Refusal(400, f"The body is not JSON: {error}.") from error
    if not isinstance(body, dict):
        raise Refusal(400, f"The body is a JSON {type(body).__name__}; expected an object.")
    if _deeper(body, _MOST_DEPTH):
        raise Refusal(400, f"The body nests deeper than {_MOST_DEPTH} levels; expected values and lists.")
    return body


def _deeper(value: Any, levels: int) -> bool:
    below = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels < 0 or any(_deeper(item, levels - 1) for item in below if isinstance(item, dict | list))


def _form(request: Request, text: bytes) -> dict[str, Any]:
    """Fields of a form. Parsed here since Flask treats a malformed form as an empty one."""
    parser = request.make_form_data_parser()
    parser.silent, parser.stream_factory = False, _no_file
    try:
        _, fields, _files = parser.parse(io.BytesIO(text), request.mimetype, len(text), request.mimetype_params)
    except ValueError as error:
        raise Refusal(400, f"The body is not the form ({request.mimetype}) it says it is: {error}.") from error
    if not fields:
        raise Refusal(400, f"The body is a form ({request.mimetype}) without a field.")
    return {key: values if len(values) > 1 else values[0] for key, values in fields.lists()}


def _no_file(*_: Any, **__: Any) -> IO[bytes]:
    raise ValueError("a file is not allowed as a value")


def _envelope(status: int, message: str, payload: Any) -> Response:
    if status != 200 and len(message) > _MOST_SAID:
        # What was wrong in a request is repeated to its sender, but not all of it.
        message = f"{message[:_MOST_SAID]} …"
    return _json(status, {"status": status, "message": message, "payload": payload})


def _json(status: int, content: Any) -> Response:
    return Response(json.dumps(_whole(content), allow_nan=False), status, mimetype="application/json")


def _whole(content: Any) -> Any:
    """`content` with whole floats as integers: BOPTEST's replies pass through JavaScript (3600, not 3600.0)."""
    if isinstance(content, float):
        return int(content) if content.is_integer() else content
    if isinstance(content, dict):
        return {key: _whole(value) for key, value in content.items()}
    if isinstance(content, list):
        # Long series are lists of numbers: avoid one call per item.
        return [
            (int(item) if item.is_integer() else item) if isinstance(item, float) else _whole(item) for item in content
        ]
    return content
