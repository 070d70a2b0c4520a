"""Contacts keep their holds, and how long a device may be blocked, also where the controller is killed in between."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import groupby, pairwise

import pandas as pd
import pytest
from home_by_curve import SG_RULES, START, HomeByCurve, curve_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.data import Block, Plan, PlanStatus
from thermoforce_mpc.live import KeptState, LiveBuilding, control
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

RULES = MeasurementMap.model_validate(SG_RULES)


class KilledError(BaseException):
    """The process is killed: nothing more is done."""


def controlled(home, folder, kill_at_h=None, steps=None):
    """Control it, with what its readings tell of its commands then, until it is killed."""
    measured = read_measurements(home.measurements(), RULES, step_s=3600.0).served()
    off = {"enabled": False}
    options = {"step_s": 3600.0, "horizon_h": 12.0, "free_response": {"name": "persistence"}, "gate": off, "watch": off}
    controller = ThermoForceMPC(
        curve_model(home), MPCConfig.model_validate(options), commands=learned_commands(measured)
    )
    building = LiveBuilding(home, RULES, 3600.0)
    with killed(home, kill_at_h):
        control(building, controller, clock=home, steps=steps, delay_s=0.0, kept=KeptState(folder / "s.npz", "k"))


@contextmanager
def killed(home, at_h):
    """The process that controls the home is killed so many hours after START; None: it is not."""
    wait, write = home.wait_until, home.write

    def until_killed(until):
        if at_h is not None and until > START + pd.Timedelta(hours=at_h):
            wait(START + pd.Timedelta(hours=at_h))
            home.write = home.wait_until = nothing
            raise KilledError
        wait(until)

    def nothing(*_):
        raise KilledError

    home.wait_until = until_killed
    try:
        yield
    except BaseException as error:
        if at_h is None or KilledError not in (type(error), type(error.__cause__)):
            raise
    finally:
        home.wait_until, home.write = wait, write


@pytest.mark.slow
def test_what_is_blocked_is_so_for_two_hours_at_most_also_across_restarts(tmp_path, monkeypatch):
    monkeypatch.setattr("home_by_curve.price", lambda at: 3.0 if 14 <= at.hour < 20 else 0.1)
    home = HomeByCurve(days=14, set_by="sg_ready")
    for hours in (14.6, 15.7, 17.2):  # in dear hours, when the device is blocked
        controlled(home, tmp_path, kill_at_h=hours)
    controlled(home, tmp_path, steps=4)
    rows = [row for row in home.rows if row["time"] >= START]
    runs = [(value, list(same)) for value, same in groupby(rows, key=lambda row: row["contact"])]
    begins = [of[0]["time"] for _, of in runs]
    held_s = [(end - begin).total_seconds() for begin, end in pairwise(begins)]
    assert {value for value, _ in runs} <= {1.0, 2.0, 3.0}
    blocked_s = [seconds for (value, _), seconds in zip(runs[:-1], held_s, strict=True) if value == 1.0]
    assert blocked_s
    assert max(blocked_s) <= 7200.0
    assert min(held_s) >= 600.0


class AlwaysSets:
    """A controller that sets one state of the contacts."""

    name, step_s, horizon_s = "always", 3600.0, 3600.0

    def __init__(self, value: float) -> None:
        self.value = value

    def plan(self, observation, state=None):
        block = Block((0.5, 0.5), self.step_s, command=(self.value, self.value))
        return Plan((block,), PlanStatus.RULE, "as ever", names=observation.history.names)


def test_a_command_is_held_for_the_rest_of_its_time_and_no_longer_and_that_is_what_is_said(tmp_path):
    """Killed 3 min after it was set and started again at once: it stays for 7 min, and not for the whole step."""
    home, said = HomeByCurve(days=1, set_by="sg_ready"), []
    for value, kill_at_h in ((3.0, 0.05), (1.0, None)):
        with killed(home, kill_at_h):
            control(
                LiveBuilding(home, RULES, 3600.0), AlwaysSets(value), clock=home, steps=1, delay_s=0.0,
                kept=KeptState(tmp_path / "s.npz", "k"), told=said.append,
            )  # fmt: skip
    assert [(block.told, block.duration_s) for block in said[1].blocks] == [((3.0, 3.0), 600.0), ((1.0, 1.0), 3000.0)]
    rows = [row for row in home.rows if row["time"] >= START]
    held = {contact: [row["time"] for row in same] for contact, same in groupby(rows, key=lambda row: row["contact"])}
    assert list(held) == [3.0, 1.0]
    assert held[1.0][0] == START + pd.Timedelta("10min")
    (note,) = [one for one in said[1].notes if "was set at" in one]
    assert "3 (recommended) was set at 00:00 and stays for 10 min (hold_min)" in note


class Blocks:
    """A journal that keeps what was set."""

    def __init__(self) -> None:
        self.blocks = []

    def origin(self):
        return None

    def decided(self, *told, **more) -> None:
        """What was decided is of no use here."""

    def ended(self, why) -> None:
        """Nor is the end."""

    def applied(self, block, begin_s) -> None:
        self.blocks.append(block)


def test_a_command_that_is_held_when_the_clock_is_set_back_is_so_for_no_longer_than_its_block():
    home, journal, always = HomeByCurve(days=1, set_by="sg_ready"), Blocks(), AlwaysSets(3.0)
    now, wait, off = home.now, home.wait_until, [pd.Timedelta(0)]
    home.now, home.wait_until = lambda: now() + off[0], lambda at: wait(at - off[0])

    def told(decision):
        if decision.instant > START:
            off[0] = pd.Timedelta("-2h")
        always.value = 1.0

    control(LiveBuilding(home, RULES, 3600.0), always, clock=home, steps=2, delay_s=0.0, journal=journal, told=told)
    assert [block.duration_s for block in journal.blocks] == [3600.0, 600.0, 3000.0]
