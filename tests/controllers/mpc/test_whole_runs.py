"""Plans of on/off machines in runs that keep their minimum times, also towards what ran before."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.actuation.actuator import Actuation, ActuationConfig, ActuationState
from controllers.actuation.actuators import Actuators
from controllers.actuation.runs import in_runs, limits_not_planned
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import HOUR_S, Layout, Names, Observation

HOURS = 4


def planned(*, last=(), whole=True, price=None, least_h=HOURS):
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    record, ahead = house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S)
    if last:
        u = record.u.copy()
        u[0, -len(last) :] = last
        record = replace(record, u=u)
    if price is not None:
        ahead = replace(ahead, price_per_kWh=price[None], heating_price_per_kWh=price[None])
    actuation = {"mode": "duty", "min_on_s": least_h * HOUR_S, "min_off_s": least_h * HOUR_S}
    config = MPCConfig(step_s=None, horizon_h=24.0, whole_runs=whole, actuation=actuation)
    mpc = ThermoForceMPC(simple_model(), config, free_response=OutdoorResponse())
    return mpc.plan(Observation(record, ahead))


def runs_min(plan, before=None):
    """Minutes of each run, on or off: what runs stops within a step, what stands starts in it."""
    blocks, running = [], bool(before)
    for level in plan.u[0]:
        on = round(level * 12)
        blocks += [1] * on + [0] * (12 - on) if running else [0] * (12 - on) + [1] * on
        running = bool(blocks[-1])
    return [(on, 5 * len(list(same))) for on, same in groupby(blocks)]


def test_runs_keep_minimum_on_and_off_times():
    plan = planned()
    assert len(np.unique(planned(whole=False).u.round(2))) > 6, "without, shares of steps"
    runs = runs_min(plan)
    assert len(runs) > 3
    assert min(minutes for _, minutes in runs[1:-1]) >= 60 * HOURS
    # What is said of the plan is of these levels.
    np.testing.assert_allclose(plan.power_W[0], 1600.0 * plan.u[0] + 2700.0 * plan.u[0], rtol=1e-6)
    assert plan.slack_K.max() < 0.6


@pytest.mark.parametrize("last", [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]])
def test_what_ran_before_counts(last):
    """Of a run that has lasted an hour, three are left."""
    plan = planned(last=last)
    assert (plan.u[0, :3] == last[-1]).all()
    on, minutes = runs_min(plan, before=last[-1])[0]
    assert on == last[-1]
    assert minutes >= 180


def test_runs_lie_in_cheap_hours():
    price = np.where((np.arange(25) >= 8) & (np.arange(25) < 14), 0.1, 0.5)
    plan, flat = planned(price=price), planned()
    cheap = slice(8, 14)
    assert plan.u[0, cheap].sum() > flat.u[0, cheap].sum() + 0.5
    assert min(minutes for _, minutes in runs_min(plan)[1:-1]) >= 60 * HOURS


def test_steps_that_hold_both_times_stay_shares():
    np.testing.assert_array_equal(planned(least_h=0.5).u, planned(whole=False, least_h=0.5).u)


@pytest.mark.parametrize("ago_s", [1800.0, 3300.0])
def test_starts_an_hour_are_kept_over_the_plan_and_towards_those_before(ago_s):
    """One an hour, where five minutes on and five off would be six."""
    ask = np.full((1, 18), 0.5)

    def starts_s(**limits):
        config = ActuationConfig(block_s=300.0, min_on_s=300.0, min_off_s=300.0, **limits)
        actuators = Actuators(Layout.single("heating"), [Actuation(config)])
        state = ActuationState(held_s=1200.0, starts_s=(ago_s,) if limits else ())
        # Heat is wanted evenly: no long run, and no long pause.
        levels = in_runs(actuators, ask, 600.0, [state], [], lambda u: float(np.abs(np.cumsum(u - ask)).max()))
        on, blocks = False, []
        for level in levels[0]:
            share = round(level * 2)
            blocks += [True] * share + [False] * (2 - share) if on else [False] * (2 - share) + [True] * share
            on = blocks[-1]
        return [300.0 * k for k, now in enumerate(blocks) if now and not (k and blocks[k - 1])]

    assert np.diff(starts_s()).min() < 3600.0
    kept = starts_s(starts_per_hour=1)
    assert len(kept) > 1
    assert np.diff([-ago_s, *kept]).min() >= 3600.0


LONG = {"block_s": 300.0, "min_on_s": 7200.0, "min_off_s": 7200.0}
STANDING = ActuationState(held_s=7200.0)


def lacking_Kh(ask):
    """A cost of levels (A, N): how far the heat of each room is from what is asked (A, N), and how long."""
    return lambda u: float((np.cumsum(u - ask, axis=1) ** 2).sum())


def whole(actuators, ask, cost, left=()):
    """Levels (A, N) in quarter hours, before the search and after it."""
    states = [STANDING] * len(ask)
    return [in_runs(actuators, ask, 900.0, states, left, of) for of in (lambda u: 0.0, cost)]


def test_runs_of_a_machine_with_several_valves_are_those_of_any_valve():
    names = Names(("bath", "hall"), ("radiator", "floor"), ("heat pump",))
    layout = Layout(names, (1, 1), (0, 1), (0, 0), (0.0,) * 2, (0.5,) * 2, (60.0, 40.0))
    actuators = Actuators(layout, [Actuation(ActuationConfig(mode="duty", **LONG))] * 2)
    ask = np.repeat([[0.6], [0.25]], 64, axis=1)
    cost = lacking_Kh(ask)
    begun, found = whole(actuators, ask, cost)
    assert cost(found) < 0.8 * cost(begun)
    # The valve that is open longest is so for all of the run, and each for whole blocks.
    np.testing.assert_allclose(found * 3, np.rint(found * 3), atol=1e-9)
    running, blocks = False, []
    for level in found.max(axis=0):
        on = round(3 * level)
        blocks += [True] * on + [False] * (3 - on) if running else [False] * (3 - on) + [True] * on
        running = blocks[-1]
    runs = [5 * len(list(same)) for _, same in groupby(blocks)]
    assert len(runs) > 3
    assert min(runs[1:-1]) >= 120
    assert found.mean(axis=1) == pytest.approx(ask[:, 0], abs=0.05)
    acted = actuators.realise([float(level) for level in found[:, 0]], 900.0, [STANDING] * 2)
    np.testing.assert_allclose(
        [sum(block.u[0] * block.duration_s for block in one) / 900.0 for one in acted.blocks], found[:, 0], atol=1e-9
    )
    assert limits_not_planned(actuators, 900.0) == []
    # One that is left to its own control has no level to change, and the runs are those of the other.
    _, alone = whole(actuators, ask, cost, left=[1])
    np.testing.assert_array_equal(alone[1], ask[1])
    assert set(np.unique(np.round(3 * alone[0]))) <= {0.0, 1.0, 2.0, 3.0}


def test_a_modulating_machine_runs_at_its_lowest_level_or_above():
    actuators = Actuators(
        Layout.single("heating"), [Actuation(ActuationConfig(mode="modulating", lowest_level=0.4, **LONG))]
    )
    ask = np.tile([[1.0] * 2 + [0.0] * 22], (1, 3))  # half an hour of heat, where a run has two
    cost = lacking_Kh(ask)
    begun, found = whole(actuators, ask, cost)
    assert cost(found) < 0.8 * cost(begun)
    on = found[0] > 0.0
    ends = np.flatnonzero(np.diff(on)) + 1
    assert ends.size > 2
    # Of a run's first and last step a part may be on: at the lowest level.
    inside = on & np.roll(on, 1) & np.roll(on, -1)
    assert found[0, inside].min() >= 0.4 - 1e-9
    assert (np.diff(ends) >= 8).all()


@pytest.mark.parametrize(
    ("options", "exclusive", "said"),
    [
        ({"mode": "modulating", "lowest_level": 0.0}, (), r"kept by the machine's own control, and not planned"),
        ({"mode": "supply"}, (), r"kept by the machine's own control, and not planned"),
        ({"mode": "duty"}, ((0, 1),), r"kept from step to step, and not planned ahead"),
    ],
)
def test_what_is_not_planned_of_minimum_times_is_said(options, exclusive, said):
    names = Names(("room",), ("heat", "other"), ("heat pump", "stove"))
    layout = Layout(names, (1, 1), (0, 0), (0, 1), (0.0,) * 2, (0.0,) * 2, (60.0,), exclusive)
    actuators = Actuators(layout, [Actuation(ActuationConfig(**options, **LONG))] * 2)
    (told,) = limits_not_planned(actuators, 900.0)
    assert re.fullmatch(f"heat, other: minimum on and off times and starts an hour are {said}", told)
    assert limits_not_planned(actuators, 900.0, left=[0, 1]) == []
    assert limits_not_planned(actuators, 4 * HOUR_S) == [], "a step holds both"
