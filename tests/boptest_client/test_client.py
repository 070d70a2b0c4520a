"""The client over a real socket, with everything that goes wrong on the way."""

from __future__ import annotations

import contextlib
import logging
import socket
import time
from dataclasses import replace

import pytest
from boptest_server import NAME, Bare, Fault, running_service
from waiting import LONG_S

from boptest_client import (
    AdvanceInterrupted,
    BadAddress,
    BoptestClient,
    BoptestError,
    ConnectError,
    ConnectionLost,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceScenario,
    ServiceTimeout,
    TlsError,
    TransportConfig,
    UnknownTest,
)

# Patience is counted in the pauses that are asked for, none is slept; so a busy machine has all the time it needs.
QUICK = TransportConfig(
    connect_timeout_s=30.0, read_timeout_s=LONG_S, patience_s=30.0, backoff_s=0.01, sleep=lambda seconds: None
)
# For answers that are late: long enough for those that are not, on any machine.
HASTY = replace(QUICK, connect_timeout_s=0.5, read_timeout_s=1.25)
LATE_S = 60.0


@pytest.fixture
def service():
    with running_service() as running:
        yield running


@pytest.fixture
def client(service, request):
    with BoptestClient(service.url, NAME, config=getattr(request, "param", QUICK)) as test:
        yield test


hasty = pytest.mark.parametrize("client", [HASTY], indirect=True, ids=["hasty"])


def test_a_test_from_selection_to_stop(service):
    with BoptestClient(service.url, NAME, config=QUICK) as client:
        assert service.count("status") == 2, "waits while queued"
        assert client.version() == "0.9.0-test"
        assert client.name() == NAME
        assert client.inputs()["oveHeaPumY_u"].maximum == 1.0
        assert client.testcases() == ("bestest_air", NAME)
        assert client.measurements()["reaTZon_y"].unit == "K"
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


def test_a_stop_that_fails_with_nothing_else_wrong_is_told(service):
    service.faults.append(Fault("stop/", "500", times=99))
    with pytest.raises(InternalError, match="stop/"), BoptestClient(service.url, NAME, config=QUICK):
        pass


def test_a_service_that_does_not_answer_is_not_waited_for_when_it_is_to_stop(service):
    """What follows a run that is ended, such as writing what it recorded, must not wait for the read time-out."""
    client = BoptestClient(service.url, NAME, config=TransportConfig(read_timeout_s=60.0), stop_timeout_s=0.3)
    service.faults.append(Fault("stop/", "slow", seconds=2 * LATE_S))
    begin = time.monotonic()
    with pytest.raises(ServiceTimeout, match=r"within 0\.3 s"):
        client.stop()
    assert time.monotonic() - begin < LATE_S


def test_stopping_a_test_that_is_gone_is_no_error(client, service):
    service.tests.clear()
    client.stop()
    client.stop()
    assert service.count("stop/") == 1


def test_an_unknown_test_case_is_told_with_what_there_is(service):
    with pytest.raises(UnknownTest, match="no test case 'nonsense'; the service offers bestest_air, bestest_hydronic"):
        BoptestClient(service.url, "nonsense", config=QUICK)


def test_scenarios_go_out_whole_and_come_back_typed(client, service):
    wanted = ServiceScenario("dynamic", "peak_heat_day", temperature_uncertainty="low", seed=3)
    assert client.set_scenario(wanted)["time"] % 86400 == 0
    assert service.bodies[-1][1]["solar_uncertainty"] is None, "the service forgets what is not named: name all"
    assert client.scenario() == wanted
    assert client.set_scenario(ServiceScenario("constant")) == {}
    with pytest.raises(RequestRejected, match="time_period is nonsense"):
        client.set_scenario(ServiceScenario(time_period="nonsense"))


def test_clipping_at_the_service_is_logged(client, caplog):
    client.set_step(900)
    with caplog.at_level(logging.WARNING):
        client.advance({"oveHeaPumY_u": 1.5, "oveHeaPumY_activate": 1})
    assert "out of the limits of oveHeaPumY_u" in caplog.text


def test_a_bad_request_carries_endpoint_and_message(client):
    with pytest.raises(RequestRejected, match=r"PUT http.*/step/.*Invalid value for parameter step.*400") as caught:
        client.set_step(-1)
    assert caught.value.status == 400
    assert isinstance(caught.value, BoptestError)


def test_an_internal_error_is_told_apart(client, service):
    service.faults.append(Fault("kpi/", "500", times=99))
    with pytest.raises(InternalError, match="Internal error in the simulation"):
        client.kpi()


def test_a_reading_past_the_record_is_an_internal_error_with_its_reason(client):
    client.initialize(86400, 0)
    with pytest.raises(InternalError, match=r"Internal BOPTEST error \(IndexError"):
        client.results(["reaPHeaPum_y"], 90000, 99999)


@pytest.mark.parametrize("kind", ["drop", "truncated", "500", "garbage"])
def test_what_is_safe_to_repeat_is_repeated(client, service, kind):
    client.initialize(86400, 0)
    service.faults.append(Fault("kpi/", kind, times=2, after_work=True))
    assert client.kpi()["ener_tot"] is not None
    assert service.count("kpi/") == 3


@pytest.mark.slow
@hasty
def test_what_is_late_and_safe_to_repeat_is_repeated(client, service):
    client.initialize(86400, 0)
    service.faults.append(Fault("kpi/", "slow", after_work=True, seconds=LATE_S))
    assert client.kpi()["ener_tot"] is not None
    assert service.count("kpi/") == 2


def test_patience_is_bounded(client, service):
    service.faults.append(Fault("kpi/", "drop", times=99))
    with pytest.raises(ConnectionLost, match=r"kpi.*no better answer within 30 s"):
        client.kpi()
    assert service.count("kpi/") < 20
    service.faults[:] = [Fault("scenario/", "500", times=99)]
    with pytest.raises(InternalError, match=r"scenario.*no better answer within 30 s") as caught:
        client.set_scenario(ServiceScenario())
    assert caught.value.status == 500


class Clock:
    """Waits at once, and remembers how long it was asked to."""

    def __init__(self, every_s=None, then=lambda: None):
        self.waited_s, self.then, self.every_s = 0.0, then, every_s

    def __call__(self, seconds):
        self.waited_s += seconds
        if self.every_s is not None and self.waited_s >= self.every_s:
            self.then()


@pytest.mark.slow
@pytest.mark.parametrize(("status", "away_s"), [("500", 890.0), ("drop", 890.0)])
def test_a_service_that_is_away_for_a_quarter_of_an_hour_does_not_end_a_run(service, status, away_s):
    """With the default patience; the pauses are asked for and not slept."""
    clock = Clock(away_s, lambda: service.faults.clear())
    config = TransportConfig(connect_timeout_s=1.0, read_timeout_s=LONG_S, sleep=clock)
    with BoptestClient(service.url, NAME, config=config) as client:
        start = client.initialize(86400, 0)
        for call, path in (
            (lambda: client.advance({})["time"], "advance/"),
            (lambda: client.forecast(["TDryBul"], 7200, 3600)["time"][0], "forecast/"),
        ):
            clock.waited_s = 0.0
            service.faults.append(Fault(path, status, times=9999))
            assert call() == start["time"] + 3600
            assert clock.waited_s >= away_s
        service.faults.append(Fault("kpi/", status, times=9999))
        clock.every_s, clock.waited_s = None, 0.0
        with pytest.raises(BoptestError, match="kpi/"):
            client.kpi()
        assert 900 <= clock.waited_s <= 915.1
        service.faults.clear()


@pytest.mark.parametrize("status", [429, 502, 503, 504])
def test_a_service_with_too_much_to_do_is_asked_again(client, service, status):
    client.initialize(86400, 0)
    answers = [(status, {"message": "later", "payload": None})]

    def edit(payload):
        raise Bare(*answers.pop()) if answers else AssertionError

    service.faults.append(Fault("kpi/", "edited", edit=edit))
    assert client.kpi()["ener_tot"] is not None
    assert service.count("kpi/") == 2


def test_a_refused_request_is_repeated_twice_only(client, service):
    client.initialize(86400, 0)

    def edit(payload):
        raise Bare(400, {"message": "mangled", "payload": None})

    service.faults.append(Fault("forecast/", "edited", times=2, edit=edit))
    assert client.forecast(["TDryBul"], 7200, 3600)
    service.faults.append(Fault("forecast/", "edited", times=99, edit=edit))
    with pytest.raises(RequestRejected, match="mangled"):
        client.forecast(["TDryBul"], 7200, 3600)
    assert service.count("forecast/") == 6


def test_a_refused_step_length_is_set_again(client, service):
    start = client.initialize(86400, 0)

    def edit(payload):
        raise Bare(400, {"message": "mangled", "payload": None})

    service.faults.append(Fault("step/", "edited", times=2, edit=edit))
    client.set_step(900)
    assert service.count("step/") == 4, "and read"
    assert client.advance({})["time"] == start["time"] + 900


def test_a_step_length_that_did_not_arrive_is_set_again(client, service):
    start = client.initialize(86400, 0)
    service.faults.append(Fault("step/", "null"))
    client.set_step(900)
    assert client.advance({})["time"] == start["time"] + 900


@pytest.mark.slow
@hasty
def test_before_the_run_a_slow_answer_is_not_waited_for_long(client, service):
    service.faults.append(Fault("kpi/", "slow", times=9, seconds=LATE_S))
    with pytest.raises(ServiceTimeout, match=r"kpi/.*no answer within 1\.25 s"):
        client.kpi()
    assert service.count("kpi/") == 1


@pytest.mark.slow
@hasty
@pytest.mark.parametrize("kind", ["drip", "drip head"])
def test_an_answer_that_drips_is_given_up_in_time(client, service, kind):
    """Ten bytes a second are never silent for half a second, and never done."""
    service.faults.append(Fault("measurements/", kind, times=9))
    began_s = time.monotonic()
    with pytest.raises(ServiceTimeout, match=r"measurements/.*no complete answer within 1\.75 s"):
        client.measurements()
    assert time.monotonic() - began_s < LATE_S
    assert service.count("measurements/") == 1
    assert client.version() == "0.9.0-test", "the client goes on with a connection of its own"


ODD = [None, [], {}, "text", 3, [1, 2], {"time": None}, {"time": "soon"}, {"time": []}, {"reaTZon_y": "text"}]


@pytest.mark.slow
@pytest.mark.parametrize("odd", ODD, ids=repr)
@pytest.mark.parametrize(
    ("path", "call"),
    [
        ("version", lambda c: c.version()),
        ("name/", lambda c: c.name()),
        ("inputs/", lambda c: c.inputs()),
        ("scenario/", lambda c: c.scenario()),
        ("scenario/", lambda c: c.set_scenario(ServiceScenario("constant", "peak_heat_day"))),
        ("initialize/", lambda c: c.initialize(86400, 0)),
        ("step/", lambda c: c.step()),
        ("advance/", lambda c: c.advance({})),
        ("forecast/", lambda c: c.forecast(["TDryBul"], 7200, 3600)),
        ("results/", lambda c: c.results(["reaPHeaPum_y"], 0, 30)),
        ("kpi/", lambda c: c.kpi()),
    ],
)
def test_what_is_no_answer_is_an_error_of_this_client_or_nothing(client, service, path, call, odd):
    service.faults.append(Fault(path, "edited", times=9, edit=lambda payload: odd))
    with contextlib.suppress(BoptestError):
        call(client)


@pytest.mark.parametrize("odd", [None, [], {}, {"time": None}])
def test_measurements_without_a_time_are_a_protocol_error(client, service, odd):
    service.faults.append(Fault("initialize/", "edited", times=99, edit=lambda payload: odd))
    with pytest.raises(ProtocolError, match=r"initialize/.*(time|names and values)"):
        client.initialize(86400, 0)
    service.faults.clear()
    start = client.initialize(86400, 0)
    service.faults.append(Fault("advance/", "edited", edit=lambda payload: payload | {"time": None}))
    assert client.advance({})["time"] == start["time"] + 3600, "read from the record"
    assert service.count("advance/") == 1


FOREIGN = [{}, {"detail": None}, {"detail": {}}, {"detail": {"loc": ["body"]}}, {"time": "noon"}, {"x": 7}]


@pytest.mark.slow
@pytest.mark.parametrize("what", ["inputs", "measurements", "forecast_points"])
@pytest.mark.parametrize("odd", FOREIGN, ids=repr)
def test_json_of_another_kind_is_no_list_of_points(client, service, what, odd):
    service.faults.append(Fault(f"{what}/", "edited", times=99, edit=lambda payload: odd))
    with pytest.raises(ProtocolError, match=f"{what}/"):
        getattr(client, what)()


def test_after_json_of_another_kind_a_lost_step_is_read_with_the_points_of_the_test(client, service):
    client.initialize(86400, 0)
    client.set_step(900)
    service.faults.append(Fault("advance/", "drop", after_work=True))
    service.faults.append(Fault("measurements/", "edited", edit=lambda payload: {"detail": None}))
    assert "reaTZon_y" in client.advance({})
    assert service.count("measurements/") == 2


@pytest.mark.parametrize(
    ("path", "call", "odd"),
    [
        ("status", BoptestClient.status, ["Running"]),
        ("status", BoptestClient.status, {"status": "Running"}),
        ("status", BoptestClient.status, "Please log in"),
        ("version", BoptestClient.version, {"version": None}),
        ("version", BoptestClient.version, {"version": {"major": 1}}),
        ("name", BoptestClient.name, {"name": 7}),
        ("testcases", BoptestClient.testcases, {"testcaseid": NAME}),
        ("testcases", BoptestClient.testcases, [{"testcaseid": None}]),
        ("scenario", BoptestClient.scenario, {"time_period": 3}),
        ("scenario", BoptestClient.scenario, {"seed": "one"}),
        ("step", BoptestClient.step, -900),
        ("step", BoptestClient.step, True),
        ("step", BoptestClient.step, None),
        ("kpi", BoptestClient.kpi, {"tdis_tot": True}),
    ],
)
def test_an_answer_of_another_type_is_a_protocol_error_that_names_the_endpoint(client, service, path, call, odd):
    service.answer = lambda *request: odd
    with pytest.raises(ProtocolError, match=path):
        call(client)


@pytest.mark.parametrize("odd", [None, [], {}, {"detail": None}])
def test_kpis_that_are_none_are_a_protocol_error(client, service, odd):
    service.faults.append(Fault("kpi/", "edited", times=99, edit=lambda payload: odd))
    with pytest.raises(ProtocolError, match="kpi/"):
        client.kpi()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda payload: {name: [] for name in payload}, "does not rise"),
        (lambda payload: payload | {"time": [0.0] * 3}, "does not rise"),
        (lambda payload: payload | {"time": payload["time"][::-1]}, "runs back"),
        (lambda payload: payload | {"time": [None] * 3}, "has gaps"),
        (lambda payload: payload | {"TDryBul": [280.0]}, "differ in length"),
    ],
)
def test_a_forecast_without_a_clock_is_a_protocol_error(client, service, edit, words):
    service.faults.append(Fault("forecast/", "edited", times=99, edit=edit))
    with pytest.raises(ProtocolError, match=f"forecast/.*{words}"):
        client.forecast(["TDryBul"], 7200, 3600)


@pytest.mark.parametrize(
    ("client", "kind"),
    [(HASTY, "slow"), *((QUICK, kind) for kind in ("drop", "truncated", "500", "garbage"))],
    indirect=["client"],
    ids=["slow", "drop", "truncated", "500", "garbage"],
)
def test_a_step_whose_answer_was_lost_is_read_from_the_record_not_repeated(client, service, kind):
    start = client.initialize(86400, 0)
    client.set_step(900)
    service.faults.append(Fault("advance/", kind, after_work=True, seconds=LATE_S))
    lost = client.advance({"oveHeaPumY_u": 1.0, "oveHeaPumY_activate": 1})
    assert service.count("advance/") == 1
    assert lost["time"] == start["time"] + 900
    assert lost["oveHeaPumY_u"] == 1.0
    # The same step, answered: same state.
    client.initialize(86400, 0)
    answered = client.advance({"oveHeaPumY_u": 1.0, "oveHeaPumY_activate": 1})
    assert {k: lost[k] for k in answered if k.startswith("rea")} == pytest.approx(
        {k: v for k, v in answered.items() if k.startswith("rea")}, nan_ok=True
    )


@pytest.mark.parametrize("kind", ["drop", "500"])
def test_a_step_that_never_arrived_is_sent_again(client, service, caplog, kind):
    start = client.initialize(86400, 0)
    client.set_step(900)
    service.faults.append(Fault("advance/", kind))
    assert client.advance({})["time"] == start["time"] + 900
    assert service.count("advance/") == 2
    assert "was not simulated" in caplog.text


def test_a_step_and_its_record_each_have_their_own_patience(client, service):
    """Both fail for less than patience, and for more than it together."""
    start = client.initialize(86400, 0)
    service.faults += [Fault("advance/", "drop", times=9), Fault("results/", "500", times=9)]
    assert client.advance({})["time"] == start["time"] + 3600
    assert service.count("advance/") == 10
    assert service.count("results/") == 9 + 9


def test_a_record_that_is_given_up_gives_up_its_step(service):
    clock = Clock()
    with BoptestClient(service.url, NAME, config=replace(QUICK, sleep=clock)) as client:
        client.initialize(86400, 0)
        service.faults += [Fault("advance/", "drop", times=99), Fault("results/", "500", times=99)]
        with pytest.raises(AdvanceInterrupted, match=r"results/.*no better answer within 30 s$"):
            client.advance({})
        assert 30.0 <= clock.waited_s <= 30.0 + 15.0, "one patience"
        service.faults.clear()


def test_steps_that_never_arrive_are_given_up(client, service):
    client.initialize(86400, 0)
    service.faults.append(Fault("advance/", "drop", times=99))
    with pytest.raises(AdvanceInterrupted, match=r"the connection broke .*no better answer within 30 s"):
        client.advance({})
    assert service.count("advance/") > 1


def test_a_step_of_unknown_fate_says_so(client, service):
    client.initialize(86400, 0)
    service.faults += [Fault("advance/", "drop", after_work=True), Fault("results/", "500", times=99)]
    with pytest.raises(AdvanceInterrupted, match=r"results/.*Internal error in the simulation.*no better answer"):
        client.advance({})
    assert service.count("advance/") == 1


def test_a_step_from_an_unknown_time_is_of_unknown_fate(client, service):
    service.faults.append(Fault("advance/", "drop", after_work=True))
    with pytest.raises(AdvanceInterrupted, match="unknown"):
        client.advance({})
    assert service.count("advance/") == 1


def test_a_test_that_timed_out_at_the_service_is_named(client, service):
    service.faults.append(Fault("advance/", "gone"))
    with pytest.raises(UnknownTest, match="Invalid testid") as caught:
        client.advance({})
    assert caught.value.status == 400


@pytest.mark.parametrize(
    "body",
    [
        {"message": "no Route matched with those values"},
        {"status": 404, "message": "Not Found", "payload": None},
        {"errors": [{"msg": "not found"}]},
        {"detail": "Not Found"},
    ],
    ids=str,
)
def test_a_404_of_a_gateway_passes(client, service, body):
    start = client.initialize(86400, 0)

    def edit(payload):
        raise Bare(404, body)

    for path, call in (("kpi/", client.kpi), ("advance/", lambda: client.advance({}))):
        service.faults.append(Fault(path, "edited", times=3, edit=edit))
        assert call()
    assert client.time_s == start["time"] + 3600
    service.faults.append(Fault("kpi/", "edited", times=99, edit=edit))
    with pytest.raises(ProtocolError, match=r"HTTP 404.*no better answer within 30 s"):
        client.kpi()


def test_a_404_that_names_the_test_ends_it(client, service):
    client.initialize(86400, 0)

    def edit(payload):
        raise Bare(404, {"message": f"no test {client.testid}", "payload": None})

    service.faults.append(Fault("kpi/", "edited", edit=edit))
    with pytest.raises(UnknownTest, match="no test"):
        client.kpi()
    assert service.count("kpi/") == 1


def test_a_service_that_moved_is_not_followed(client, service):
    client.initialize(86400, 0)
    service.faults.append(Fault("(advance|results)/", "moved", times=99))
    with pytest.raises(
        AdvanceInterrupted, match=r"HTTP 302, a redirect to https://elsewhere\.example/, which is not fol"
    ):
        client.advance({})


def test_a_page_of_somebody_else_is_told_as_text_and_cut(client, service):
    service.page = "<html>No such page.\x1b[31m" + "x" * 1000 + "</html>"
    service.faults.append(Fault("kpi/", "page", times=99))
    with pytest.raises(
        ProtocolError, match=r"HTTP 404, text/html: <html>No such page\.\[31mx+ … \(\d+ more char"
    ) as caught:
        client.kpi()
    assert len(str(caught.value)) < 700


def test_messages_of_the_service_are_text(client, service, caplog):
    service.faults.append(Fault("kpi/", "edited", times=99, edit=lambda payload: raises(Bare(400, ODD_MESSAGE))))
    with pytest.raises(RequestRejected, match=r"told: \[2Jno") as caught:
        client.kpi()
    for text in (str(caught.value), caplog.text):
        assert "\x1b" not in text
        assert "\x9b" not in text


ODD_MESSAGE = {"message": "told: \x1b[2J\x9b\ud800no", "payload": None}


def raises(error):
    raise error


@pytest.mark.parametrize("listens", [True, False], ids=["plain http", "says nothing"])
def test_https_at_a_plain_port_is_told_as_that(listens):
    with running_service() as service, socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen(5)
        port = service.url.rpartition(":")[2] if listens else silent.getsockname()[1]
        with pytest.raises(TlsError, match=r"no TLS .*write http://"):
            BoptestClient(f"https://127.0.0.1:{port}", NAME, config=replace(HASTY, sleep=never))


def never(seconds):
    raise AssertionError("it is not asked again")


@pytest.mark.slow
def test_silence_is_said_and_ends_before_a_run(service, caplog, monkeypatch):
    monkeypatch.setattr("boptest_client.transport.SAID_AFTER_S", 0.2)
    monkeypatch.setattr("boptest_client.client.LOOKUP_S", 1.0)
    with BoptestClient(service.url, NAME, config=TransportConfig(connect_timeout_s=0.5)) as client:
        service.faults.append(Fault("inputs/", "slow", times=9, seconds=LATE_S))
        with pytest.raises(ServiceTimeout, match=r"inputs/.*within 1 s"):
            client.inputs()
        assert "no answer for 0.2 s already" in caplog.text
        assert "no answer for 0.4 s already" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize(("read_timeout_s", "last_s"), [(1.0, r"0\.\d+"), (300.0, r"1\.\d+")])
def test_silence_in_a_run_ends_with_its_patience(service, read_timeout_s, last_s):
    config = TransportConfig(connect_timeout_s=0.3, read_timeout_s=read_timeout_s, patience_s=1.5, backoff_s=0.1)
    with BoptestClient(service.url, NAME, config=config) as client:
        client.initialize(86400, 0)
        service.faults.append(Fault("kpi/", "slow", times=99, seconds=LATE_S))
        began_s = time.monotonic()
        with pytest.raises(ServiceTimeout, match=rf"kpi/.*answer within {last_s} s"):
            client.kpi()
        assert time.monotonic() - began_s < 1.5 + 2.0, "no attempt outlasts what is left"
        service.faults.clear()


@pytest.mark.slow
def test_a_selection_that_hangs_is_waited_for_no_longer_than_patience(service):
    service.faults.append(Fault("testcases/", "slow", times=9, seconds=LATE_S))
    began_s = time.monotonic()
    with pytest.raises(ServiceTimeout, match=r"select.*within 1 s"):
        BoptestClient(service.url, NAME, config=TransportConfig(patience_s=1.0))
    assert time.monotonic() - began_s < LATE_S


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:8000", "ftp://127.0.0.1", "", "http://", "http://[::1", "http://127.0.0.1:99999", "http://host:port",
        "http://my host:8000", "http://name@:8000", "http://host:0",
    ],
)  # fmt: skip
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(BadAddress, match=r"http://127\.0\.0\.1:8000"):
        BoptestClient(url, NAME, config=QUICK)


@pytest.mark.parametrize("wrong", [{"patience_s": -1.0}, {"read_timeout_s": 0.0}, {"backoff_s": float("nan")}])
def test_patience_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TransportConfig(**wrong)


def test_an_answer_that_is_not_json_is_a_protocol_error(client, service):
    service.faults.append(Fault("measurements/", "garbage", times=99))
    with pytest.raises(ProtocolError, match="HTTP 200, application/json: <html>not json"):
        client.measurements()


def test_nobody_listening_is_a_connect_error():
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]  # bound, so that nobody else gets it, and not listening
        with pytest.raises(ConnectError, match=f"127.0.0.1:{port}"):
            BoptestClient(f"http://127.0.0.1:{port}", NAME, config=QUICK)


def test_an_address_that_swallows_connections_is_given_up_after_one_wait():
    pauses: list[float] = []
    config = TransportConfig(connect_timeout_s=0.4, read_timeout_s=5.0, sleep=pauses.append)
    with socket.socket() as deaf, contextlib.ExitStack() as filling:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen(0)
        for _ in range(8):  # with its queue full, the system leaves further connections unanswered
            waiting = filling.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(deaf.getsockname())
        with pytest.raises(ConnectError, match="no connection within"):
            BoptestClient(f"http://127.0.0.1:{deaf.getsockname()[1]}", NAME, config=config)
        assert pauses == [], "no second attempt"


@pytest.mark.slow
def test_an_address_that_takes_connections_and_never_answers_is_given_up_soon(caplog, monkeypatch):
    """Though a request of a run may take minutes; of ten seconds the test waits one."""
    monkeypatch.setattr("boptest_client.client.FIRST_ANSWER_S", 1.0)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        began = time.monotonic()
        with pytest.raises(ServiceTimeout, match=f"GET {url}/version: no .*answer within 1 s; is a BOPTEST"):
            BoptestClient(url, NAME, config=TransportConfig(connect_timeout_s=0.5))
        assert time.monotonic() - began < 10.0
    assert f"GET {url}/version: no answer for 0.5 s already; it is waited for 1 s" in caplog.text


def test_a_service_that_tells_no_version_is_one(service):
    service.faults.append(Fault("version", "500", times=9))
    with BoptestClient(service.url, NAME, config=QUICK) as client:
        assert client.status() == "Running"


def test_a_test_that_stays_queued_is_given_up_and_stopped(service):
    service.queued_polls, pauses = 10_000, []
    with pytest.raises(ServiceTimeout, match="Queued"):
        BoptestClient(service.url, NAME, config=replace(QUICK, sleep=pauses.append), start_timeout_s=0.1)
    assert len(service.stopped) == 1
    assert set(pauses) == {0.1}, "as the transport pauses, for no longer than the limit"
