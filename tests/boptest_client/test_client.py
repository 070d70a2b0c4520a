"""The client over a real socket, with everything that goes wrong on the way."""

from __future__ import annotations

import socket

import pytest
from boptest_server import NAME, Fault, running_service

from boptest_client import (
    BoptestClient,
    BoptestError,
    ConnectError,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceTimeout,
    TransportConfig,
    UnknownTest,
)

QUICK = TransportConfig(connect_timeout_s=1.0, read_timeout_s=0.5, retries=2, backoff_s=0.01)


@pytest.fixture
def service():
    with running_service() as running:
        yield running


@pytest.fixture
def client(service):
    with BoptestClient(service.url, NAME, config=QUICK) as test:
        yield test


def test_a_test_from_selection_to_stop(service):
    with BoptestClient(service.url, NAME, config=QUICK) as client:
        assert service.count("status") == 2, "waits while queued"
        assert client.version() == "0.9.0-test"
        assert client.name() == NAME
        assert client.inputs()["oveHeaPumY_u"].maximum == 1.0
        assert "reaTZon_y" in client.measurements()
        assert "TDryBul" in client.forecast_points()
        start = client.initialize(86400, 3600)
        client.set_step(900)
        assert client.step() == 900
        after = client.advance({"oveHeaPumY_u": 1.0, "oveHeaPumY_activate": 1})
        assert after["time"] == start["time"] + 900
        forecast = client.forecast(["TDryBul"], 7200, 3600)
        assert [len(forecast[key]) for key in ("time", "TDryBul")] == [3, 3]
        results = client.results(["reaPHeaPum_y"], start["time"], after["time"])
        assert len(results["time"]) == 31
        assert client.kpi()["pgas_tot"] is None
        testid = client.testid
    assert service.stopped == [testid]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_the_test_is_stopped_however_the_block_ends(service, error):
    with pytest.raises(error), BoptestClient(service.url, NAME, config=QUICK):
        raise error
    assert len(service.stopped) == 1


def test_a_stop_that_fails_does_not_hide_the_first_error(service):
    service.faults.append(Fault("stop/", "500"))
    with pytest.raises(RuntimeError, match="first"), BoptestClient(service.url, NAME, config=QUICK):
        raise RuntimeError("first")


def test_an_unknown_test_case_is_rejected_in_the_services_words(service):
    with pytest.raises(RequestRejected, match="Invalid testcase name: nonsense"):
        BoptestClient(service.url, "nonsense", config=QUICK)


def test_a_bad_request_carries_endpoint_and_message(client):
    with pytest.raises(RequestRejected, match=r"PUT http.*/step/.*Invalid value for parameter step.*400") as caught:
        client.set_step(-1)
    assert caught.value.status == 400
    assert isinstance(caught.value, BoptestError)


def test_an_internal_error_is_told_apart(client, service):
    service.faults.append(Fault("kpi/", "500"))
    with pytest.raises(InternalError, match="Internal error in the simulation"):
        client.kpi()


@pytest.mark.parametrize("kind", ["drop", "slow"])
def test_what_is_safe_to_repeat_is_repeated(client, service, kind):
    service.faults.append(Fault("kpi/", kind, times=2))
    assert client.kpi()["ener_tot"] is not None
    assert service.count("kpi/") == 3


def test_patience_is_bounded(client, service):
    service.faults.append(Fault("kpi/", "drop", times=99))
    with pytest.raises(ConnectError, match="kpi"):
        client.kpi()
    assert service.count("kpi/") == 3


@pytest.mark.parametrize(("kind", "error"), [("drop", ConnectError), ("slow", ServiceTimeout)])
def test_an_advance_is_never_repeated(client, service, kind, error):
    client.set_step(900)
    service.faults.append(Fault("advance/", kind, after_work=True))
    with pytest.raises(error, match="may or may not have been simulated"):
        client.advance({})
    assert service.count("advance/") == 1


def test_a_test_that_timed_out_at_the_service_is_named(client, service):
    service.faults.append(Fault("advance/", "gone"))
    with pytest.raises(UnknownTest, match="timed out at the service"):
        client.advance({})


def test_an_answer_that_is_not_json_is_a_protocol_error(client, service):
    service.faults.append(Fault("measurements/", "garbage"))
    with pytest.raises(ProtocolError, match="not JSON"):
        client.measurements()


def test_nobody_listening_is_a_connect_error():
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    with pytest.raises(ConnectError, match=f"127.0.0.1:{port}"):
        BoptestClient(f"http://127.0.0.1:{port}", NAME, config=QUICK)


def test_a_test_that_stays_queued_is_given_up_and_stopped(service):
    service.queued_polls = 10_000
    with pytest.raises(ServiceTimeout, match="Queued"):
        BoptestClient(service.url, NAME, config=QUICK, start_timeout_s=0.1)
    assert len(service.stopped) == 1
