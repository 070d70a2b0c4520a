"""What a model believes beyond the plain laws of a building, and changes plans, is said before it acts."""

from __future__ import annotations

from dataclasses import replace
from html import unescape
from types import SimpleNamespace

from report_page import body_of
from report_runs import planned, report_of
from two_houses import two_model

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.experiment.identifying import SavedModel
from thermoforce_mpc.experiment.run_models import identify_all
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.other_load import OtherLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.report.display import RunDisplay

OTHER = OtherLoad((500.0,) * 24, 0.0, 5.0, (-20.0, 30.0), 10.0)
SUN = SunOnSensor(2.0, 0.3, 0.99, 180.0, 120.0, 50.0, 43_200.0)


def even_model() -> ThermalModel:
    """Two houses whose machines have no fixed part worth switching for."""
    plain = two_model()
    return replace(plain, power=tuple(power_of(50.0) for _ in plain.power))


def power_of(fixed_W: float) -> PowerModel:
    """Of a machine that takes so much while it runs, and 1500 W more at full level."""
    return PowerModel(MachineLoad((fixed_W, 0.0, 1500.0, 0.0), (-5.0, 10.0)))


def believing() -> ThermalModel:
    """Two houses: blocked hours, sun, foreign heat, another load on its boiler; air in the other, an unsure effect."""
    plain = even_model()
    (own, _), (_, other) = plain.operator.pairs
    across = replace(own, gains=0.3 * own.gains)
    operator = replace(plain.operator, pairs=((own, None), (across, other)))
    unsure = {"step_response_24h_K[radiator]": 2.0, "step_response_24h_sd_K[radiator]": 1.5}
    bath, hall = plain.cards
    cards = (
        replace(bath, sun_on_sensor=SUN, foreign_heat=OTHER, blocked_hours=(2, 3)),
        replace(hall, uncertainty=unsure, scores={"aired_steps": 6.0, "aired_K": 0.84}),
    )
    boiler, pump = plain.power
    return replace(plain, operator=operator, cards=cards, power=(replace(boiler, foreign=OTHER), pump))


def test_each_claim_is_said_with_what_it_changes():
    sun, air, power, heat, hours, neighbour = believing().claims
    assert sun == f"bath: {SUN.in_words()}"
    assert air.startswith("hall: in 6 steps air came in, as through a window, and moved the room by 0.8 K in the mean")
    assert power.startswith("power of boiler: the meter holds another load: 500 W on average")
    assert heat.startswith("heat of radiator: the meter holds another load")
    assert hours.startswith("radiator: nothing comes from 2:00 to 4:00, whatever is asked for")
    assert neighbour == "hall: what radiator does to it is known to ± 75 % only: plans count on 50 % of it"
    assert even_model().claims == ()
    once = replace(even_model().cards[0], scores={"aired_steps": 1.0, "aired_K": 0.4})
    assert once.air_in_words.startswith("in 1 step air came in, as through a window, and moved the room by 0.4 K")


def test_a_fixed_part_is_a_claim_where_a_machine_is_switched_for_it() -> None:
    plain, lossy = even_model(), power_of(500.0)
    _, machine = plain.names.machines
    (claim,) = replace(plain, power=(plain.power[0], lossy)).claims
    assert claim.startswith(f"power of {machine}: 25 % of full power and 0 % of full heat are a fixed part while on")
    assert "controller.options.actuation.mode" in claim


def test_a_run_says_them_of_the_model_that_it_begins_with(monkeypatch, capsys):
    model = believing()
    monkeypatch.setattr(SavedModel, "load", lambda self: model)
    asks = SimpleNamespace(name="mpc", chosen=None, model_from=SavedModel("model", HOUR_S))
    identify_all([asks], plant=None, display=RunDisplay())  # type: ignore[list-item, arg-type]
    said = capsys.readouterr().out
    for claim in model.claims:
        assert f"Found: {claim}\n" in said


def test_what_a_plan_said_of_an_actuator_is_not_said_again() -> None:
    model, said = believing(), list[str]()
    hours = model.claims[4].partition(": ")[2]
    model.say_claims(said.append, f"radiator: watch: {hours}, found while probing")
    assert said == [f"Found: {claim}" for k, claim in enumerate(model.claims) if k != 4]


def test_the_report_says_them_of_the_model_of_the_run(tmp_path) -> None:
    page = unescape(body_of(report_of(planned(), {}, tmp_path, model=believing())))
    for claim in believing().claims:
        assert f"Found before the run: {claim}" in page
    assert "Found before the run" not in body_of(report_of(planned(), {}, tmp_path, model=even_model()))
