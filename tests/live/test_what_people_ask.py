"""What people ask of a running controller, and what they set by hand."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from connected_home import HOUR, SENSORS, START, TimedHome, controlled, rules_of
from filelock import FileLock
from simulated_building import RULES as SIMULATED_RULES
from simulated_building import START as SIMULATED
from simulated_building import SimulatedBuilding, mpc

from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import Block, Boundary, Plan, PlanStatus
from thermoforce_mpc.errors import ConfigError, NotAsTold, PlantError
from thermoforce_mpc.files import write_json
from thermoforce_mpc.live import Decision, LiveBuilding, People, control
from thermoforce_mpc.live.shared import shared_with
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.records.people import SHOWN

NOW = pd.Timestamp("2026-01-20 10:00", tz="UTC")
ORIGIN = pd.Timestamp("2026-01-01", tz="UTC")


def bounds(people, now=NOW, hours=48):
    at_s = (NOW - ORIGIN).total_seconds() + 3600.0 * np.arange(hours + 1)
    one, none = np.ones((1, hours + 1)), np.zeros(hours + 1)
    ahead = Boundary(at_s, none, none, none, 20.0 * one, 23.0 * one, 0.25 * one, 0.0 * one)
    changed, notes = people.applied(ahead, ORIGIN, now)
    return changed.lower_C[0], changed.upper_C[0], notes


@pytest.fixture
def people(tmp_path):
    return People(tmp_path / "people.json", "Europe/Berlin")


def test_nothing_asked_changes_nothing(people):
    lower, upper, notes = bounds(people)
    assert (lower == 20.0).all()
    assert (upper == 23.0).all()
    assert notes == ()


def test_bounds_hold_for_half_a_day_and_the_other_one_makes_way(people, tmp_path):
    people.ask("lower", "21.5", NOW)
    people.ask("upper", "21.2", NOW)
    lower, upper, notes = bounds(People(tmp_path / "people.json"))  # also after a restart
    assert lower[:12].tolist() == pytest.approx([20.7] * 12)
    assert upper[:12].tolist() == pytest.approx([21.2] * 12)
    assert (lower[12:] == 20.0).all()
    assert "upper bound 21.2 °C" in notes[0]
    people.ask("comfort", "off", NOW)
    assert bounds(people)[2] == ()


def test_away_ends_in_the_clock_of_the_house_so_that_it_is_warm_then(people):
    people.ask("away", "2026-01-21 18:00", NOW)  # 17:00 UTC
    lower, upper, notes = bounds(people)
    assert (lower[:31] == 16.0).all()
    assert (lower[31:] == 20.0).all()
    assert upper[0] == 28.0
    assert notes == ("away until Wed 21 Jan 18:00 was asked",)
    people.ask("away", "on", NOW)
    assert bounds(people)[2] == ("away until Wed 20 Jan 2027 11:00 was asked",)
    people.ask("away", "OFF", NOW)
    assert bounds(people)[2] == ()
    people.ask("away", "ON", NOW)
    assert people.shown(NOW)["away"]


@pytest.mark.parametrize(
    ("asked", "in_UTC"), [("2026-10-25T02:30", "2026-10-25T00:30"), ("2026-03-29T02:30", "2026-03-29T01:00")]
)
def test_away_ends_in_hours_that_the_clock_has_twice_or_never(people, asked, in_UTC):
    assert people.ask("away", asked, NOW).away_until == f"{in_UTC}:00+00:00"


def test_a_boost_is_warmer_and_ends(people):
    people.ask("boost", "90", NOW)
    lower, upper, _ = bounds(people)
    assert lower[:3].tolist() == [22.0, 22.0, 20.0]
    assert (upper >= lower + 0.5).all()
    assert people.shown(NOW + pd.Timedelta("30min"))["boost_min"] == 60
    assert bounds(people, NOW + 2 * HOUR)[2] == ()


@pytest.mark.parametrize(
    ("key", "word"),
    [("lower", "99"), ("lower", "warm"), ("lower", "nan"), ("upper", "inf"), ("away", "soon"), ("away", "2020-01-01"),
     ("away", "01.03.2026"), ("away", "02/03/2026"),
     ("boost", "-5"), ("boost", "1000"), ("boost", "nan"), ("window", "1"), ("comfort", "21"),
     ("mode", "shadow"), ("mode", "off")],
)  # fmt: skip
def test_what_cannot_be_asked_is_refused_and_changes_nothing(people, key, word):
    with pytest.raises(ConfigError):
        people.ask(key, word, NOW)
    assert bounds(people)[2] == ()


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"x": 1}', '{"lower_C": 99, "comfort_until": "2027-01-01T00:00Z"}', '{"away_until": "soon"}',
     '{"by_hand": {"x": 5}}', '{"by_hand": [1]}', '{"by_hand": {"x": [21, "soon"]}}',
     '{"by_hand": {"x": [21, "2027-01-01"]}}',
     '{"away_until": ""}', '{"boost_until": "NaT"}', '{"by_hand": {"x": [21, ""]}}',
     '{"mode": "shadow"}', '{"mode": 1}',
     '{"by_hand": {"x": ["21", "2027-01-01T00:00Z"]}}', '{"by_hand": {"x": [NaN, "2027-01-01T00:00Z"]}}', "[" * 99_999],
)  # fmt: skip
def test_a_damaged_file_may_hold_that_nothing_is_set_and_nothing_is_until_it_is_mended(people, tmp_path, text, caplog):
    (tmp_path / "people.json").write_text(text)
    assert bounds(people)[2] == ()
    assert people.by_hand(NOW) == {}
    assert "nothing is set until mode control or advise is asked" in people.paused
    assert people.paused in caplog.text
    with pytest.raises(ConfigError, match="nothing is set until"):
        people.ask("boost", "60", NOW)
    people.set_by_hand("x", 21.0, NOW)
    assert (tmp_path / "people.json").read_text() == text
    people.ask("mode", "control", NOW)
    assert not people.paused


def test_what_two_ask_at_once_is_both_kept(tmp_path, monkeypatch):
    """Such as the controller, which notes what is set by hand, and the page."""
    both, whole = threading.Barrier(2), write_json

    def slowly(path, content, **options):
        time.sleep(0.1)
        whole(path, content, **options)

    monkeypatch.setattr("thermoforce_mpc.records.people.write_json", slowly)

    def by_hand():
        both.wait()
        People(tmp_path / "people.json").set_by_hand("x", 21.0, NOW)

    noting = threading.Thread(target=by_hand)
    noting.start()
    both.wait()
    people = People(tmp_path / "people.json")
    people.ask("mode", "advise", NOW)
    noting.join()
    assert people.paused
    assert people.by_hand(NOW)["x"][0] == 21.0


class AtTheWall(TimedHome):
    """Somebody turns the thermostat to 24 °C at some hour."""

    def __init__(self) -> None:
        super().__init__()
        self.turned = False
        self.on_row = self._turn

    def _turn(self, row) -> None:
        if not self.turned and row["time"] - START >= 3.5 * HOUR:
            self.turned, self.told, self.ends = True, 24.0, None


@pytest.mark.slow
def test_a_change_at_the_wall_is_respected_for_four_hours_and_recorded(tmp_path):
    home = AtTheWall()
    people = People(tmp_path / "people.json")
    decisions = controlled(home, home, rules_of({name: name for name in SENSORS}), 11, people=people)
    set_C = {(row["time"] - START) / HOUR: row["set"] for row in home.rows if row["time"] >= START}
    assert {set_C[h] for h in set_C if 3.6 < h < 8.0} == {24.0}
    said = [any("by hand" in note for note in decision.notes) for decision in decisions]
    assert said == [False] * 4 + [True] * 4 + [False] * 3
    written = [(at - START) / HOUR for at, _ in home.written]
    assert not [h for h in written if 4.0 <= h < 8.0]
    assert any(8.0 <= h < 9.0 for h in written)


class Hears:
    """What a watchdog is told."""

    def __init__(self):
        self.heard = []

    def __getattr__(self, kind):
        return lambda *told: self.heard.append((kind, *told))


def test_what_is_set_by_hand_is_given_back_by_nobody(people):
    """Neither by the controller, nor by its watchdog or the connection's, whose time would run out meanwhile."""
    house, hears, left = SimulatedBuilding(), Hears(), []
    house.leave = lambda: left.append(house.at)
    people.set_by_hand("actuator", 0.4, SIMULATED + 2 * HOUR)
    building = LiveBuilding(house, MeasurementMap.model_validate(SIMULATED_RULES), 3600.0, people=people)
    control(building, mpc(), clock=house, steps=8, delay_s=0.0, watchdog=hears)
    written = [(at - SIMULATED) / HOUR for at, _, _ in house.written]
    assert written
    assert min(written) >= 6.0
    assert len(left) == 6
    assert hears.heard[:6] == [("released",)] * 6
    assert {told[1] for told in hears.heard if told[0] == "set"} == {("actuator",)}


@pytest.mark.parametrize(
    ("by_hand_at", "said"),
    [(2, "left as people set it by hand: actuator"), (0, "nothing had to be given back: nothing is set")],
)
def test_an_interrupt_says_what_is_left_to_people(people, by_hand_at, said):
    house, decisions = SimulatedBuilding(), []

    def told(decision):
        decisions.append(decision)
        if len(decisions) == by_hand_at:
            people.set_by_hand("actuator", 0.4, decision.instant)
        if len(decisions) > by_hand_at:
            raise KeyboardInterrupt

    building = LiveBuilding(house, MeasurementMap.model_validate(SIMULATED_RULES), 3600.0, people=people)
    with pytest.raises(KeyboardInterrupt) as ended:
        control(building, mpc(), clock=house, steps=8, delay_s=0.0, told=told)
    assert ended.value.__notes__ == [said]


def test_a_mode_that_is_asked_gives_the_building_back_once_and_sets_it_again(people):
    """Meanwhile it is planned, what would be set is nowhere believed to have acted, and nothing is written."""
    house, decisions = SimulatedBuilding(), []
    building = LiveBuilding(house, MeasurementMap.model_validate(SIMULATED_RULES), 3600.0, people=people)

    def told(decision):
        decisions.append(decision)
        if len(decisions) in (3, 6):
            people.ask("mode", "advise" if len(decisions) == 3 else "control", decision.instant)

    control(building, mpc(), clock=house, steps=8, delay_s=0.0, told=told)
    values = [(round((at - SIMULATED) / HOUR), *levels.values()) for at, levels, _ in house.written]
    given_back = [hour for hour, level in values if level is None]
    assert given_back == [2, 8]
    assert {hour for hour, _ in values} == {0, 1, 2, 5, 6, 7, 8}
    said = ["mode advise was asked: nothing is set" in decision.notes for decision in decisions]
    assert said == [False] * 3 + [True] * 3 + [False] * 2
    assert {decision.plan.status for decision in decisions} == {"solved"}


class SaysWhatItHolds(TimedHome):
    """Somebody turns its thermostat to 24 °C just after a reading, and nobody reads it again."""

    def present(self, names):
        return dict.fromkeys(names, self.rows[-1]["set"] if self.told is None else self.told)


@pytest.mark.slow
def test_a_change_by_hand_after_the_last_reading_is_not_given_back(tmp_path, caplog):
    home = SaysWhatItHolds()

    def turn(row):
        if row["time"] - START >= 2.5 * HOUR:
            home.told, home.ends, home.on_row = 24.0, None, lambda row: None

    home.on_row = turn
    people = People(tmp_path / "people.json")
    controlled(home, home, rules_of({name: name for name in SENSORS}), 3, people=people)
    assert home.told == 24.0
    assert people.by_hand(home.at)["actuator"][0] == 24.0


TWO_ROOMS = {
    "time": {"zone": "UTC"}, "step": "1h", "outdoor": "out",
    "zones": {z: {"temperature": z, "lower": 20.0, "upper": 23.0} for z in ("hall", "bath")},
    "actuators": {f"{z}_valve": {"zone": z, "level": f"u_{z}", "machine": "pump"} for z in ("hall", "bath")},
    "machines": {"pump": {"power": "P", "price": 0.25, "command": {"kind": "setpoint", "column": "set",
    "reference": "hall"}}},
}  # fmt: skip


def test_a_command_for_several_rooms_has_the_machines_name_and_is_left_alone_where_one_room_is(people):
    building = LiveBuilding(SimulatedBuilding(), MeasurementMap.model_validate(TWO_ROOMS), 3600.0, people=people)
    assert building.to_set({"hall_valve": 21.0, "bath_valve": 21.0}) == {"pump": 21.0}
    assert building.to_set({"hall_valve": 21.0, "bath_valve": None}) == {"pump": None}
    people.set_by_hand("bath_valve", 22.0, NOW)
    building.now = NOW
    assert building.to_set({"hall_valve": 21.0, "bath_valve": 21.0}) == {}


@pytest.mark.slow
def test_a_thermostat_that_does_not_take_its_set_point_is_nobody_at_the_wall(tmp_path):
    home = TimedHome()
    home.write = lambda levels, seconds: home.written.append((home.at, *levels.values()))
    people = People(tmp_path / "people.json")
    decisions = controlled(home, home, rules_of({name: name for name in SENSORS}), 4, people=people)
    assert not any("by hand" in note for decision in decisions for note in decision.notes)


@pytest.mark.parametrize("holds_min", [0, 5, 60])
def test_a_thermostat_that_gives_its_command_back_is_said_after_three_steps(people, holds_min):
    """Nobody else tells: each plan counts on a command that did not act."""
    home, said = TimedHome(3), []
    building = LiveBuilding(
        home, MeasurementMap.model_validate(rules_of({name: name for name in SENSORS})), 3600.0, people=people
    )
    for hour in range(5):
        home.wait_until(START + hour * HOUR)
        building.record(home.at)
        said.append([note for note in building.left_out if "does not take its command, or gives it back" in note])
        building.write({"actuator": 22.0 + hour % 2}, 7200.0)
        home.ends = home.at + pd.Timedelta(minutes=holds_min)
    assert [len(notes) for notes in said] == ([0, 0, 0, 1, 1] if holds_min < 60 else [0] * 5)
    assert len({note for notes in said for note in notes}) <= 1, "said anew by nobody who says each note once a day"
    assert not people.by_hand(home.at)


class MakesItsOwn(TimedHome):
    """A thermostat of whole degrees up to 23 °C, that may say what it holds."""

    def write(self, levels, seconds) -> None:
        (value,) = levels.values()
        super().write({"actuator": None if value is None else min(float(round(value)), 23.0)}, seconds)


class SaysIt(MakesItsOwn):
    def present(self, names):
        return dict.fromkeys(names, self.rows[-1]["set"] if self.told is None else self.told)


@pytest.mark.parametrize(
    ("made", "told", "took"), [(MakesItsOwn, 20.5, 20.0), (SaysIt, 20.5, 20.0), (SaysIt, 26.0, 23.0)]
)
def test_what_a_thermostat_makes_of_a_command_is_nobody_at_the_wall(people, made, told, took):
    """It is given back like the command itself, by the watchdog too; what is turned after that is a person's."""
    home = made(3)
    rules = MeasurementMap.model_validate(rules_of({name: name for name in SENSORS}))
    building = LiveBuilding(home, rules, 3600.0, people=people)
    building.record(START)
    building.write({"actuator": told}, 7200.0)
    home.wait_until(START + HOUR)
    building.record(START + HOUR)
    building.notice(START + HOUR)
    assert not people.by_hand(START)
    assert building.ours({"actuator": told}) == {"actuator": [(told, 0.26), (took, 0.26)]}
    assert building.to_set({"actuator": None}) == {"actuator": None}
    home.told = 21.5
    home.wait_until(START + 2 * HOUR)
    building.record(START + 2 * HOUR)
    assert people.by_hand(START)["actuator"][0] == 21.5
    assert building.to_set({"actuator": None}) == {}


@pytest.mark.parametrize(
    ("told", "error", "holds"), [(20.5, NotAsTold, True), (26.0, NotAsTold, False), (20.5, PlantError, False)]
)
def test_a_command_that_is_rounded_is_taken(people, caplog, told, error, holds):
    """Else its hold runs out, and the watchdog gives the building back within the step; said once, as of a resolution.

    One of other limits did not take it, and of one that did not answer nobody knows it.
    """
    home = SaysIt(3)
    write = home.write

    def answers(levels, seconds):
        write(levels, seconds)
        if levels["actuator"] is not None:
            words = ("not taken: see resolution", levels)
            raise error(*words) if error is NotAsTold else error(words[0])

    home.write = answers
    present, asked = home.present, list[list[str]]()
    home.present = lambda names: asked.append(names) or present(names)
    rules = MeasurementMap.model_validate(rules_of({name: name for name in SENSORS}))
    building = LiveBuilding(home, rules, 3600.0, people=people)
    for hour in range(2):
        building.record(START + hour * HOUR)
        if holds:
            asked.clear()
            building.write({"actuator": told + 0.1 * hour}, 7200.0)
            assert asked == [["actuator"]], "once"
            assert building.ours({"actuator": told}) == {"actuator": [(told, 0.26), (20.0 + hour, 0.26)]}
        else:
            with pytest.raises(error):
                building.write({"actuator": told}, 7200.0)
        home.wait_until(START + (hour + 1) * HOUR)
    assert sum("rounds its command" in line.message for line in caplog.records) == holds


def test_a_command_that_was_set_long_after_its_reading_is_compared_as_long_as_it_holds(people):
    """A plan took ten minutes, and at the next reading it is not over."""
    home = SaysIt(3)
    rules = MeasurementMap.model_validate(rules_of({name: name for name in SENSORS}))
    building = LiveBuilding(home, rules, 3600.0, people=people)
    building.record(START)
    building.write({"actuator": 22.0}, 3120.0, now=START + HOUR / 6)
    building.notice(START + HOUR / 6)
    home.told = 24.0
    building.notice(START + HOUR)
    assert people.by_hand(START)["actuator"][0] == 24.0


def set_to_22(people) -> tuple[SaysIt, LiveBuilding]:
    """A home that was read and set once, and says that it is."""
    home = SaysIt(3)
    rules = MeasurementMap.model_validate(rules_of({name: name for name in SENSORS}))
    building = LiveBuilding(home, rules, 3600.0, people=people)
    building.record(START)
    building.write({"actuator": 22.0}, 3720.0)
    building.notice(START)
    return home, building


def test_who_sets_it_by_hand_again_is_respected_from_then_on(people):
    """It was over four hours after the first time, with the first value in the note."""
    home, building = set_to_22(people)
    ends = {}
    for hour, says in ((1, 24.0), (2, 24.0), (3, 25.0), (4, 25.0), (7, 25.0)):
        home.told, home.ends = says, None
        home.wait_until(START + hour * HOUR)
        building.record(home.at)
        value, until = people.by_hand(home.at).get("actuator", (None, home.at))
        ends[hour] = value, round((until - START) / HOUR)
    assert ends == {1: (24.0, 5), 2: (24.0, 5), 3: (25.0, 7), 4: (25.0, 7), 7: (None, 7)}
    assert not [note for note in building.left_out if "by hand" in note]


def test_a_map_that_was_changed_since_the_start_is_said(tmp_path):
    """It was read once, and nobody said that an edit has no effect."""
    home, file, said = SaysIt(3), tmp_path / "map.yaml", []
    rules = rules_of({name: name for name in SENSORS})
    file.write_text(yaml.safe_dump(rules))
    building = LiveBuilding(home, MeasurementMap.model_validate(rules), 3600.0, map_file=file)
    for change in ("", "", "# summer\n", None):
        if change is None:
            file.unlink()
        else:
            file.write_text(file.read_text() + change)
        building.record(START)
        said.append([note for note in building.left_out if "restart" in note])
    assert said == [[], [], [f"{file}: changed since control began: it takes effect at a restart"], []]


def test_who_sets_the_same_by_hand_the_next_day_is_respected_before_it_is_read(people):
    """The set-point of the controller, which was read yet, was kept as that of a person."""
    home = SaysIt(3)
    rules = MeasurementMap.model_validate(rules_of({name: name for name in SENSORS}))
    building = LiveBuilding(home, rules, 3600.0, people=people)
    for hour in (0, 8):
        home.told = home.ends = None
        home.wait_until(START + hour * HOUR)
        building.record(home.at)
        building.write({"actuator": 22.0}, 7200.0)
        home.wait_until(START + (hour + 1) * HOUR)
        building.record(home.at)
        building.write({"actuator": 22.0}, 7200.0)
        home.told = 24.0
        building.notice(home.at)
        building.record(home.at)
        assert people.by_hand(home.at)["actuator"][0] == 24.0
        home.wait_until(START + (hour + 2) * HOUR)
        building.record(home.at)
        assert people.by_hand(home.at)["actuator"][0] == 24.0


@pytest.mark.parametrize(("later_h", "by_hand"), [(1.0, True), (1.3, False), (-2.0, False)])
def test_what_was_given_back_in_between_is_nobody_at_the_wall(people, later_h, by_hand):
    """By the watchdog, where a plan or a sleep took longer than its command was to hold, or the clock was set back."""
    home, building = set_to_22(people)
    home.told = None
    building.notice(START + later_h * HOUR)
    assert bool(people.by_hand(START)) is by_hand


def test_a_device_of_halves_that_first_repeats_what_it_was_told_is_nobody_at_the_wall(people):
    """findings/zigbee_setpoints_in_halves.sh"""
    home, rules = SaysIt(3), rules_of({name: name for name in SENSORS})
    rules["actuators"]["actuator"]["command"]["resolution"] = 0.1
    building = LiveBuilding(home, MeasurementMap.model_validate(rules), 3600.0, people=people)
    building.record(START)
    building.write({"actuator": 21.3}, 3720.0)
    for says in (21.3, 21.5):
        home.told = says
        building.notice(START)
        assert not people.by_hand(START)


def test_it_is_asked_on_the_command_line(tmp_path):
    def told(*words):
        return CliRunner().invoke(cli, ["ask", *words, "--out", str(tmp_path)])

    assert "no controller writes or wrote to it" in str(told("boost", "60").exception)
    assert "'warmer' cannot be asked; there are lower, upper" in str(told("warmer", "21").exception)
    (tmp_path / "journal.jsonl").touch()
    later = "; no process here controls by that folder: it counts once one does\n"
    assert told("boost", "60").output == f"Asked: boost_min 60{later}"
    with FileLock(tmp_path / ".lock"):
        assert told("lower", "21").output == "Asked: lower_C 21.0, boost_min 60\n"
    assert told("boost", "off").output == f"Asked: lower_C 21.0{later}"
    assert isinstance(told("away", "yesterday").exception, ConfigError)
    assert "Europe/Berlin" in str(told("away", "2026-12-27", "--zone", "Mars").exception)


class Shows:
    """A connection that shows what is decided and hears what people ask."""

    def listen(self, asks):
        self.asks = asks

    def tell(self, said):
        self.said = getattr(self, "said", {}) | said


def test_what_is_decided_is_shown_and_what_is_heard_is_asked(people, tmp_path):
    shows, lines = Shows(), []
    decided = shared_with(
        shows, people, lines.append, lambda decision: "Tue 10:00  hall 21 °C for 60 min: cheap hours", tmp_path
    )
    plan = Plan(
        (Block(0.5, 3600.0),), PlanStatus.SOLVED, "cheap hours", lower_C=np.array([20.0]), upper_C=np.array([23.0])
    )
    decided(Decision(NOW, plan, plan.blocks, notes=("a note",)))
    assert len(lines) == 1
    assert shows.said["status"] == "solved"
    assert shows.said["level"] == "hall 21 °C for 60 min"
    assert shows.said["people"]["planned_lower_C"] == 20.0
    assert shows.said["saving"]["said"].startswith("not known yet")
    shows.asks["mode"]("advise")
    assert people.paused
    assert shows.said["people"]["mode"] == "advise"
    shows.asks["boost"]("45")
    assert shows.said["people"]["boost_min"] == 45
    with pytest.raises(ConfigError):
        shows.asks["lower"]("hot")
    assert json.loads(json.dumps(shows.said))["notes"] == ["a note"]
    decided(Decision(NOW, plan, plan.blocks))
    assert shows.said["level"] == "nothing is set; it would be hall 21 °C for 60 min"
    shows.asks["mode"]("control")
    people.set_by_hand("hall", 23.0, pd.Timestamp.now("UTC"))
    decided(Decision(NOW, plan, plan.blocks))
    assert shows.said["level"] == "hall 21 °C for 60 min; left as set by hand: hall"


def test_what_cannot_be_shown_ends_no_control(people, tmp_path):
    def fails(said):
        raise RuntimeError("broker")

    shows = Shows()
    shows.tell = fails
    plan = Plan((Block(0.5, 3600.0),), PlanStatus.SOLVED, "cheap hours")
    decided = shared_with(shows, people, lambda decision: None, lambda decision: "", tmp_path, "shadow")
    decided(Decision(NOW, plan, plan.blocks))
    assert json.loads((tmp_path / SHOWN).read_text())["level"].startswith("nothing is set")
    assert "mode" not in shows.asks, "a controller that sets nothing is not asked for another mode"
