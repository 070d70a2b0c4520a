"""OpenAPI document of the service, made from the endpoints that it serves."""

from __future__ import annotations

from typing import Any

from thermoforce_mpc.service.endpoints import ENDPOINTS, TESTCASE, Endpoint, Schema
from thermoforce_mpc.version import VERSION

# Namespace of BOPTEST's own test cases.
NAMESPACE = "ibpsa"
_FORMS = ("multipart/form-data", "application/x-www-form-urlencoded")
_REASONS = {
    400: "invalid value or test id, see `message` or `errors`",
    401: "the token is missing or wrong",
    403: "asked by a name that the service has not, or by a page of another site",
    404: "no such test case or path",
    413: "the body is too long",
    429: "too many requests a second, requests of one test at a time, or tests",
}


def document(*, token: bool) -> dict[str, Any]:
    """Return the document of a service that needs a token, or none."""
    paths: dict[str, dict[str, Any]] = {
        "/version": {"get": _bare("Version of the service", _envelope(_of_version()), token)},
        "/openapi.json": {"get": _bare("This document", {"type": "object"}, token)},
        "/status/{testid}": {"get": _bare("Status of a test", {"const": "Running"}, token, ("testid",))},
        "/stop/{testid}": {"put": _bare("End a test", {"const": "OK"}, token, ("testid",), kind="text/plain")},
    }
    listed: Schema = {"type": "array", "items": {"type": "object", "required": ["testcaseid"]}}
    chosen: Schema = {"type": "object", "required": ["testid"], "properties": {"testid": {"type": "string"}}}
    for prefix in ("/testcases", f"/testcases/{NAMESPACE}"):
        paths[prefix] = {"get": _bare("Test cases offered", listed, token)}
        for end, more in (("", ()), ("{how}", ("how",))):
            operation = _bare("Start a test", chosen, token, ("name", *more), body={"type": "object"})
            paths[f"{prefix}/{{name}}/select{end}"] = {"post": operation}
    for endpoint in ENDPOINTS:
        for path, names in ((f"/{endpoint.verb}/{{testid}}", ("testid",)), (f"/{endpoint.verb}", ())):
            paths.setdefault(path, {})[endpoint.method.lower()] = _operation(endpoint, token, names)
    specification: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {
            "title": f"{TESTCASE} by thermoforce-mpc",
            "version": VERSION,
            "description": "The embedded plant behind BOPTEST's protocol. Paths without a test id are those of BOPTEST "
            "before 0.7, where a service ran one test.",
        },
        "paths": paths,
    }
    if token:
        specification["components"] = {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}}
        specification["security"] = [{"token": []}]
    return specification


def _operation(endpoint: Endpoint, token: bool, names: tuple[str, ...]) -> dict[str, Any]:
    return _bare(endpoint.summary, _envelope(endpoint.payload), token, names, endpoint.body)


def _bare(
    summary: str,
    answer: Schema,
    token: bool,
    names: tuple[str, ...] = (),
    body: Schema | None = None,
    *,
    kind: str = "application/json",
) -> dict[str, Any]:
    """One operation: `answer` is the schema of its reply, `names` are the parameters in its path."""
    responses: dict[str, Any] = {"200": _response("done", answer, kind)}
    statuses = [403, 429, *([401] if token else []), *([413] if body is not None else [])]
    # Paths without a test id use the one test of such clients; only a body can be wrong there.
    statuses += [400] if "testid" in names or body is not None else []
    statuses += [404] if "name" in names else []
    for status in sorted(statuses):
        refused = _envelope({"type": "null"})
        schema = {"anyOf": [refused, _UNKNOWN]} if status == 400 else refused
        responses[str(status)] = _response(_REASONS[status], schema)
    operation: dict[str, Any] = {"summary": summary, "responses": responses}
    if names:
        operation["parameters"] = [
            {"name": name, "in": "path", "required": True, "schema": {"type": "string"}} for name in names
        ]
    if body is not None:
        operation["requestBody"] = {
            "required": bool(body.get("required")),
            "content": {kind: {"schema": body} for kind in ("application/json", *_FORMS)},
        }
    return operation


def _response(description: str, schema: Schema, kind: str = "application/json") -> dict[str, Any]:
    return {"description": description, "content": {kind: {"schema": schema}}}


def _envelope(payload: Schema) -> Schema:
    return {
        "type": "object",
        "required": ["status", "message", "payload"],
        "properties": {"status": {"type": "integer"}, "message": {"type": "string"}, "payload": payload},
        "additionalProperties": False,
    }


def _of_version() -> Schema:
    return {"type": "object", "required": ["version"], "properties": {"version": {"type": "string"}}}


_UNKNOWN: Schema = {
    "type": "object",
    "required": ["errors"],
    "properties": {"errors": {"type": "array", "items": {"type": "object", "required": ["value", "msg"]}}},
    "additionalProperties": False,
}
