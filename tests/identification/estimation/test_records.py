"""Records of several zones: every zone, actuator and machine is checked, whichever comes first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, random_levels, record

from thermoforce_mpc.data import Layout, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, Pair, identify
from thermoforce_mpc.identification.estimation.records import check_pairs, prepared_runs
from thermoforce_mpc.model.screening import ReadingLimits

NAMES = Names(("living", "bath"), ("floor", "radiator"), ("pump", "boiler"))
LAYOUT = Layout(
    NAMES,
    signs=(1, 1),
    home=(0, 1),
    machine_of=(0, 1),
    u_min=(0.0, 0.0),
    shares=(0.0, 0.0),
    floor_area_m2=(float("nan"),) * 2,
)
LINEAR = IdentificationConfig(order=1, modulation="linear", sun_on_sensor=False)
ROWS = (0, 1)


def two_rooms(days: float = 2.0, seeds: tuple[int, int] = (3, 4)) -> Record:
    """Two rooms that do not affect each other, heat not measured."""
    n = round(96 * days)
    rooms = [record(House(), days, seed=5, u=random_levels(n, s), noise_K=0.01, heat_measured=False) for s in seeds]
    rows = {name: np.concatenate([getattr(room, name) for room in rooms]) for name in ("T_zone_C", "u", "power_W")}
    weather = {name: getattr(rooms[0], name) for name in ("time_s", "T_out_C", "solar_W_m2")}
    return Record(**weather, **rows, heat_W=np.full_like(rows["u"], np.nan), names=NAMES)


def changed(history: Record, signal: str, row: int, at: slice, value: float) -> Record:
    """`history` with another value at some places of a row."""
    values = np.array(getattr(history, signal))
    values[row, at] = value
    return replace(history, **{signal: values})


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize(
    ("signal", "at", "words"),
    [
        ("T_zone_C", slice(None), r"no zone temperature of {zone} is known.*or leave the zone out"),
        ("T_zone_C", slice(20, None), r"only 10 % of the zone temperatures of {zone} were measured"),
        ("u", slice(None), r"never measured together: u\[{actuator}\] has no value"),
    ],
)
def test_what_one_zone_lacks_is_named_in_any_order(row, signal, at, words):
    history = changed(two_rooms(), signal, row, at, np.nan)
    words = words.format(zone=NAMES.zones[row], actuator=NAMES.actuators[row])
    with pytest.raises(DataError, match=words):
        identify([history], config=LINEAR, layout=LAYOUT)


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize(
    ("signal", "places", "words"),
    [
        ("T_zone_C", 30, r"T_zone_C\[{zone}\] at 30 of 193 places"),
        ("power_W", 192, r"power_W\[{machine}\] at \d+ of 192"),
    ],
)
def test_a_wrong_unit_of_any_row_is_named(row, signal, places, words):
    history = changed(two_rooms(), signal, row, slice(0, places), 1e6)
    words = words.format(zone=NAMES.zones[row], machine=NAMES.machines[row])
    layout = replace(LAYOUT, floor_area_m2=(100.0, 90.0))
    with pytest.raises(
        DataError, match=f"^run: {words}.*too many for sensor faults: check the unit and the floor area"
    ):
        identify([history], config=LINEAR, layout=layout)


def test_a_room_in_fahrenheit_is_refused_with_what_to_do():
    history = two_rooms()
    T = np.array(history.T_zone_C)
    T[1] = 32.0 + 1.8 * (T[1] + 5.0 - T[1].mean() + 20.0)
    with pytest.raises(DataError, match=rf"T_zone_C\[{NAMES.zones[1]}\] at .*°F is likely: give \(x − 32\) / 1\.8"):
        identify([replace(history, T_zone_C=T)], config=LINEAR, layout=LAYOUT)


@pytest.mark.parametrize("row", ROWS)
def test_unknown_levels_of_any_actuator_divide_a_run(row):
    runs, notes = prepared_runs([changed(two_rooms(3.0), "u", row, slice(100, 120), np.nan)], ReadingLimits.of(None))
    assert [run.n_steps for run in runs] == [100, 168]
    assert "run: gaps in u or in the weather divide it into 2 pieces" in notes
    assert not any("filled" in note for note in notes)


@pytest.mark.slow
@pytest.mark.parametrize(("row", "level"), [(0, 0.4), (1, 0.0)])
def test_an_actuator_that_never_changed_does_not_refuse_the_rest(row, level):
    history = changed(two_rooms(3.0), "u", row, slice(None), level)
    verdicts = [card.competence for card in identify([history], config=LINEAR, layout=LAYOUT).cards]
    assert verdicts[1 - row].competent, verdicts[1 - row].reasons
    assert not verdicts[row].competent


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "levels", "watts", "words"),
    [
        (0, 0.0, 1.0, "electric power: the actuator was on in 0 measured steps, need at least 5"),
        (1, None, 0.0, "electric power: its mean while the actuator was on is 0 W: check the meter and its sign"),
    ],
    ids=["idle", "dead"],
)
def test_a_meter_that_tells_nothing_costs_the_power_of_its_machine_only(row, levels, watts, words):
    history = changed(two_rooms(3.0), "power_W", row, slice(None), watts)
    if levels is not None:
        history = changed(history, "u", row, slice(None), levels)
    model = identify([history], config=LINEAR, layout=LAYOUT)
    assert model.power[row] is None
    assert model.power[1 - row] is not None
    note = f"{NAMES.machines[row]}: {words}; its power is left out"
    assert [note in card.notes for card in model.cards] == [row == 0, row == 1]
    assert model.cards[1 - row].competence.competent


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS)
def test_a_heat_meter_is_named_where_it_is_dead_and_not_needed_where_nothing_was_on(row):
    history = two_rooms(3.0)
    metered = replace(history, heat_W=2000.0 * history.u)
    dead = changed(metered, "heat_W", row, slice(None), 0.0)
    words = f"^{NAMES.actuators[row]} on {NAMES.zones[row]}: delivered heat: its mean while the actuator was on is 0 W"
    with pytest.raises(DataError, match=words):
        identify([dead], config=LINEAR, layout=LAYOUT)
    model = identify([changed(dead, "u", row, slice(None), 0.0)], config=LINEAR, layout=LAYOUT)
    assert "heat input: identity, the actuator was on in 0 steps with measured heat" in model.cards[row].notes
    assert model.cards[1 - row].competence.competent


def test_actuators_that_all_hardly_acted_are_refused():
    history = two_rooms()
    u = np.zeros_like(history.u)
    u[1, 3] = 1.0
    with pytest.raises(DataError, match=r"too little excitation.*u\[radiator\] 0\.072.*2 changes of u\[radiator\]"):
        identify([replace(history, u=u)], config=LINEAR, layout=LAYOUT)


@pytest.mark.parametrize("row", ROWS)
def test_pairs_are_those_of_all_zones(row):
    history = two_rooms()
    with pytest.raises(DataError, match=rf"zone {NAMES.zones[row]} starts 5\.000 K apart"):
        Pair(history, changed(history, "T_zone_C", row, slice(None), history.T_zone_C[row, 0] + 5.0))
    check_pairs([Pair(history, changed(history, "u", row, slice(20, 40), 0.3))])
    with pytest.raises(DataError, match=rf"u\[{NAMES.actuators[row]}\] is not finite at 1 of 192 places, first at 7"):
        check_pairs([Pair(history, changed(history, "u", row, slice(7, 8), np.nan))])
    with pytest.raises(DataError, match="a pair is of one building"):
        Pair(history, history.part(0, [0], [0]))


@pytest.mark.slow
def test_pairs_in_which_one_actuator_acts_leave_the_other_unknown():
    pair = Pair(two_rooms(seeds=(3, 4)), two_rooms(seeds=(3, 9)))
    first, second = identify(pairs=[pair], config=LINEAR, layout=LAYOUT).cards
    assert not first.competence.competent
    assert "no effect of the actuator" in first.competence.reasons[0]
    assert second.uncertainty["step_response_8h_sd_K"] < 0.1 * second.uncertainty["step_response_8h_K"]
