"""The OpenAPI document is what the server does: its routes, its parameters, its answers to anything it may be sent."""

from __future__ import annotations

import json
import re

import pytest
from fuzzing import VALUES, fuzz, mutated, tampered
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.service.app import ServiceLimits, create_app
from thermoforce_mpc.service.server import plants

schemathesis = pytest.importorskip("schemathesis")
jsonschema_rs = pytest.importorskip("jsonschema_rs")

FORMS = ("multipart/form-data; boundary=x", "application/x-www-form-urlencoded")
NAME = "bestest_hydronic_heat_pump"
FUZZ = settings(max_examples=8, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck), database=None)


@pytest.fixture(scope="module")
def app():
    return create_app(plants(synthetic_weather()), ServiceLimits(most_tests=3, per_second=1e9))


@pytest.fixture(scope="module")
def described(app):
    return app.test_client().get("/openapi.json").json


@pytest.mark.slow
def test_every_route_is_described_and_every_description_is_a_route(app, described):
    served = {
        (re.sub(r"<(\w+)>", r"{\1}", rule.rule), method.lower())
        for rule in app.url_map.iter_rules()
        for method in rule.methods - {"HEAD", "OPTIONS"}
    }
    assert served == {(path, method) for path, methods in described["paths"].items() for method in methods}


def test_the_parameters_of_a_path_are_those_in_it(described):
    for path, methods in described["paths"].items():
        for operation in methods.values():
            named = {one["name"] for one in operation.get("parameters", ()) if one["in"] == "path"}
            assert named == set(re.findall(r"{(\w+)}", path)), path


def test_a_body_that_lacks_a_required_value_or_has_an_unknown_input_is_refused(app, described):
    client = app.test_client()
    tried = 0
    for path, methods in described["paths"].items():
        for method, operation in methods.items():
            schema = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
            if "{" in path or not schema:
                continue
            for required in schema.get("required", ()):
                answer = client.open(
                    path, method=method.upper(), json=dict.fromkeys(set(schema["required"]) - {required}, 0)
                )
                assert answer.status_code == 400, (path, required)
                tried += 1
            if schema.get("additionalProperties") is False:
                assert client.open(path, method=method.upper(), json={"unknown": 1}).status_code == 400
                tried += 1
    assert tried >= 9


def test_answers_are_as_described(app, described):
    """A whole run by the test client; every answer fits the schema of its operation and status."""
    client, seen = app.test_client(), set()

    def ask(method, template, status=200, body=None, **names):
        answer = client.open(template.format(**names), method=method.upper(), json=body)
        assert answer.status_code == status, answer.text
        content = described["paths"][template][method]["responses"][str(status)]["content"]
        assert answer.mimetype in content
        value = answer.json if answer.is_json else answer.text
        jsonschema_rs.validate(content[answer.mimetype]["schema"], value)
        seen.add((template, method))
        return value

    testid = ask("post", "/testcases/{name}/select", name=NAME)["testid"]
    ask("post", "/testcases/{name}/select", 404, name="bestest_air")
    for template, methods in described["paths"].items():
        if "get" in methods:
            ask("get", template, testid=testid)
        if template.endswith("{testid}") and template != "/stop/{testid}":
            ask(next(iter(methods)), template, 400, {}, testid="nonsense")
    of = {"testid": testid}
    ask("put", "/initialize/{testid}", body={"start_time": 0, "warmup_period": 0, "final_time": 1800}, **of)
    ask("put", "/step/{testid}", body={"step": 1800}, **of)
    ask("put", "/scenario/{testid}", body={"electricity_price": "dynamic", "temperature_uncertainty": "low"}, **of)
    assert ask("post", "/advance/{testid}", body={"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1}, **of)["payload"]
    assert not ask("post", "/advance/{testid}", body={}, **of)["payload"], "the end of the test"
    points = {"point_names": ["reaTZon_y", "oveHeaPumY_u"], "start_time": 0, "final_time": 1800}
    ask("put", "/results/{testid}", body=points, **of)
    ask("put", "/results/{testid}", 400, body=points | {"start_time": 9e6, "final_time": 9e6}, **of)
    ask("put", "/forecast/{testid}", body={"point_names": ["TDryBul"], "horizon": 3600, "interval": 900}, **of)
    ask("get", "/kpi/{testid}", **of)
    ask("put", "/stop/{testid}", **of)
    unseen = {(t, m) for t, methods in described["paths"].items() for m in methods} - seen
    assert all("{testid}" not in template for template, _ in unseen), unseen


@pytest.mark.slow
def test_whatever_fits_the_document_gets_an_answer_that_does(app):
    """Schema-based fuzzing of every operation: no 5xx, no status, type or content that is not described."""
    schema = schemathesis.openapi.from_wsgi("/openapi.json", app)
    described = pytest.importorskip("schemathesis.specs.openapi.checks")
    checks = [
        schemathesis.checks.not_a_server_error,
        described.status_code_conformance,
        described.content_type_conformance,
        described.response_schema_conformance,
    ]
    tried = 0
    for found in schema.get_all_operations():
        operation = found.ok()

        @FUZZ
        @given(case=operation.as_strategy())
        def fuzz(case):
            nonlocal tried
            tried += 1
            case.call_and_validate(checks=checks)

        fuzz()
    assert tried > 100


BODIES = {
    "step": {"step": 900},
    "scenario": {"electricity_price": "dynamic", "time_period": None, "temperature_uncertainty": "low", "seed": 3},
    "initialize": {"start_time": 0, "warmup_period": 0, "final_time": 3600},
    "advance": {"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1, "oveTSet_u": 295.0, "ovePum_activate": 0},
    "forecast": {"point_names": ["TDryBul", "Occupancy[1]"], "horizon": 3600, "interval": 900},
    "results": {"point_names": ["reaTZon_y", "oveHeaPumY_u"], "start_time": 0, "final_time": 3600},
}


@pytest.mark.slow
@pytest.mark.parametrize("verb", BODIES)
def test_whatever_does_not_fit_it_is_refused_or_understood(app, verb):
    client, method = app.test_client(), "POST" if verb == "advance" else "PUT"

    @fuzz(60)
    @given(body=tampered(BODIES[verb]) | VALUES)
    def check(body):
        answer = client.open(f"/{verb}", method=method, data=json.dumps(body), content_type="application/json")
        assert answer.status_code in (200, 400), answer.text
        assert len(answer.text) < 10_000 or answer.status_code == 200

    check()


@pytest.mark.parametrize("verb", BODIES)
def test_bytes_of_any_kind_are_refused_or_understood(app, verb):
    client, method = app.test_client(), "POST" if verb == "advance" else "PUT"

    @fuzz(30)
    @given(
        data=mutated(json.dumps(BODIES[verb]).encode()),
        kind=st.sampled_from(["application/json", "text/plain", *FORMS]),
    )
    def check(data, kind):
        answer = client.open(f"/{verb}", method=method, data=data, content_type=kind)
        assert answer.status_code in {200, 400, 413}, answer.text

    check()
