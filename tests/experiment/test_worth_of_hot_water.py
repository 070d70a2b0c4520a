"""Hot water while a record is lived through again, beside a home that did live so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from home_by_setpoint import START, price
from home_with_tank import MAP, HomeWithTank
from simple_house import simple_model

from controllers.mpc.config import MPCConfig
from controllers.optimisation.hot_water import HotWater
from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    Array,
    Block,
    Boundary,
    HotWaterPlan,
    Observation,
    Plan,
    PlanStatus,
)
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.worth import LoggedTank, Raised, Worth, worth
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.live.shadow import ShadowBook
from thermoforce_mpc.measurements.load import Measurements, learned_tank, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.whatif.identified_house import IdentifiedHouse
from thermoforce_mpc.whatif.lived_tank import LivedTank

_DAYS, _BEFORE = 3, 8
_HOURS = 24 * _DAYS


def _target(hour: int) -> float:
    """Charged before it is wanted, when it is cheap."""
    return 54.0 if hour in (4, 5, 14, 15) else 40.0


class _ByClock:
    """Sets the tank by the clock, or leaves it to the device, and leaves the room to its thermostat or sets `level`."""

    name, step_s, horizon_s = "by clock", HOUR_S, 6 * HOUR_S

    def __init__(self, *, sets: bool = True, level: float | None = None) -> None:
        self._sets, self._level, self.seen = sets, level, list[Observation]()

    def plan(self, observation: Observation, state: object = None) -> Plan:
        self.seen.append(observation)
        told = _target(int(observation.time_s % DAY_S // HOUR_S)) if self._sets else None
        one = np.zeros(1)
        tank = HotWaterPlan((told,), one, one, one, one, one, 0.0, 0.0, 0.0, 0.0)
        return Plan((Block((self._level,), HOUR_S),), PlanStatus.SOLVED, "by clock", hot_water=tank)


class _HomeByClock(HomeWithTank):
    def wait_until(self, at: pd.Timestamp) -> None:
        super().wait_until(min(at, START))
        while self.at < at:
            self.tank_told = _target(self.at.hour)
            super().wait_until(min(at, (self.at + pd.Timedelta("1h")).floor("1h")))


def _lived(home: HomeWithTank) -> pd.DataFrame:
    begin = len(home.rows)
    home.wait_until(START + pd.Timedelta(days=_DAYS))
    return pd.DataFrame(home.rows[begin:])


def _by_clock() -> pd.DataFrame:
    return _lived(_HomeByClock(_BEFORE))


@pytest.fixture(scope="module")
def lived() -> tuple[Measurements, LoggedTank, pd.DataFrame]:
    home = HomeWithTank(_BEFORE)
    rows = _lived(home)
    measured = read_measurements(home.measurements(), MAP, step_s=HOUR_S).served()
    return measured, LoggedTank(learned_tank(measured), measured.tank), rows


def _worth(measured: Measurements, tank: LoggedTank, controller: _ByClock) -> Worth:
    start_s = float(measured.record.time_s[-_HOURS - 1])
    asked = {"start_s": start_s, "days": float(_DAYS), "draws": 2, "hot_water": tank}
    return worth(simple_model(0.05), measured.record, measured.conditions, controller, **asked)


def _cost(rows: pd.DataFrame) -> float:
    return sum(price(at) * watts / 12000.0 for at, watts in zip(rows["time"], rows["P"], strict=True))


@pytest.mark.slow
def test_left_alone_all_is_as_it_was(lived: tuple[Measurements, LoggedTank, pd.DataFrame]) -> None:
    measured, tank, rows = lived
    found = _worth(measured, tank, _ByClock(sets=False))
    assert found.saved == pytest.approx(0.0, abs=1e-9)
    hourly_W = rows["P"].to_numpy().reshape(-1, 12).mean(axis=1)
    for record in (found.as_was, found.planned):
        np.testing.assert_allclose(record.power_W[0], hourly_W, atol=1e-6)  # hot water is on the meter
        np.testing.assert_allclose(record.u, measured.record.u[:, -_HOURS:], atol=1e-9)
    np.testing.assert_allclose(found.tank.T_C, found.tank.T_was_C)
    assert found.tank.T_was_C.mean() == pytest.approx(rows["tank"].mean(), abs=1.0), "as it was measured"


@pytest.mark.slow
def test_a_tank_that_is_set_costs_what_it_costs_in_the_home(
    lived: tuple[Measurements, LoggedTank, pd.DataFrame],
) -> None:
    """Charged at night it leaves the machine to the room in the morning, when power is dear."""
    measured, tank, rows = lived
    controller = _ByClock()
    found = _worth(measured, tank, controller)
    truth = _by_clock()
    saved = _cost(rows) - _cost(truth)
    assert saved < -0.5
    assert found.saved == pytest.approx(saved, abs=0.3 * abs(saved))
    T_C = np.append(truth["tank"].to_numpy()[12::12], np.nan)
    assert np.sqrt(np.nanmean((found.tank.T_C - T_C) ** 2)) < 1.5
    assert np.ptp(T_C[:-1]) > 12.0, "hot before it is wanted, and cold after"
    assert found.tank.below_Kh == pytest.approx(0.0, abs=0.5)
    # The controller sees the tank, and the meter of the rooms alone.
    assert [one.tank_C for one in controller.seen[1:_HOURS]] == pytest.approx(found.tank.T_C[: _HOURS - 1])
    seen = controller.seen[_HOURS - 1].history.power_W[0]
    assert np.isnan(seen[-_HOURS:]).sum() >= 2 * _DAYS
    assert "hot water by the model of its tank" in found.rests_on
    assert {"T_tank_C_was", "T_tank_C_planned"} < set(found.to_dataframe())


@pytest.mark.slow
def test_the_room_has_the_machine_while_the_tank_leaves_it(
    lived: tuple[Measurements, LoggedTank, pd.DataFrame],
) -> None:
    measured, tank, _ = lived
    found = _worth(measured, tank, _ByClock(level=1.0))
    charged = found.planned.u[0] < 1.0
    assert 2 * _DAYS <= charged.sum() <= 8 * _DAYS
    tank_W = found.planned.power_W[0] - 4300.0 * found.planned.u[0]
    assert tank_W.mean() == pytest.approx(1500.0 * (1.0 - found.planned.u[0]).mean(), rel=0.25)


def test_a_house_goes_on_with_its_tank_where_another_left_it(
    lived: tuple[Measurements, LoggedTank, pd.DataFrame],
) -> None:
    measured, tank, _ = lived
    record, model = measured.record, simple_model(0.05)
    begin_s = float(record.time_s[-_HOURS - 1])

    def house(before: object = None) -> IdentifiedHouse:
        of = LivedTank(tank.tank, tank.logged, record)
        return IdentifiedHouse(model, record, measured.conditions, before=before, tank=of)

    def go_on(one: IdentifiedHouse, hours: range) -> Array:
        for k in hours:
            one.set_tank(_target(k))
            one.advance(None, 0.25 * HOUR_S)  # parts of a step are one step
            one.advance(None, 0.75 * HOUR_S)
        return one.tank_C[:, -_HOURS - 1 :]

    whole, half = house(), house()
    for one in (whole, half):
        one.reset(begin_s, 0.0)
    expected = go_on(whole, range(24))
    go_on(half, range(10))
    later = house(half.state)
    later.reset(begin_s + 10 * HOUR_S, 0.0)
    found = go_on(later, range(10, 24))
    np.testing.assert_allclose(found[:, 10:25], expected[:, 10:25])
    over = slice(-_HOURS + 10, -_HOURS + 24)
    np.testing.assert_allclose(later.power_W[:, over], whole.power_W[:, over])


def test_what_a_valve_and_a_metered_level_say_while_the_tank_is_charged(
    lived: tuple[Measurements, LoggedTank, pd.DataFrame],
) -> None:
    """A valve stays open; as much heat more comes while the tank is not charged."""
    measured, tank, _ = lived
    record, model = measured.record, simple_model(0.05)
    of = LivedTank(tank.tank, tank.logged, record)
    begin = record.n_steps - _HOURS
    (k,) = np.flatnonzero(of.share[begin:] > 0.3)[:1] + begin
    levels = []
    for u in (np.full_like(record.u, 0.4), 0.4 * (1.0 - of.share)[None]):
        one = IdentifiedHouse(model, replace(record, u=u), measured.conditions, tank=of)
        one.reset(float(record.time_s[k - 1]), 0.0)
        one.set_tank(20.0)
        one.advance(None, 2 * HOUR_S)
        levels.append((one.u[0, k] - u[0, k]) / of.share[k])
    assert levels[0] == pytest.approx(levels[1], rel=1e-6), "so much of the level is the tank's"
    assert 0.1 < levels[0] < 0.5


@pytest.mark.slow
def test_a_tank_that_is_colder_than_it_was_is_planned_warmer(
    lived: tuple[Measurements, LoggedTank, pd.DataFrame],
) -> None:
    measured, tank, _ = lived
    found = _worth(measured, tank, _ByClock(sets=False))
    colder = replace(found.tank, below_Kh=found.tank.below_was_Kh + 4.0)
    of = type("Lived", (), {"outside_Kh": 0.0, "tank": colder})()
    raised = [Raised().further(of, 0.0, 0.0, 3.0)]
    raised += [raised[-1].further(of, 0.0, 0.0, 3.0), raised[-1].further(of, 0.0, 0.0, 20.0)]
    assert raised == [Raised(0.0, 1.0), Raised(0.0, 2.0), Raised(0.0, 1.0)]
    n = 12
    ahead = Boundary.measured(measured.record.slice(0, n))
    ahead = replace(ahead, price_per_kWh=np.full((1, n + 1), 0.3))
    wanted = [
        HotWater(tank.tank, measured.layout, HOUR_S, more)
        .begin(ahead, measured.record.origin, 45.0, False, None)
        .wanted_C
        for more in (0.0, 2.0)
    ]
    np.testing.assert_allclose(wanted[1] - wanted[0], 2.0)


def test_a_tank_that_was_not_measured_then_is_refused(lived: tuple[Measurements, LoggedTank, pd.DataFrame]) -> None:
    measured, tank, _ = lived
    T_C = tank.logged.T_C.copy()
    for known, why in ((0.75, "was measured in 25 % of the time"), (1.0, "was never measured")):
        T_C[T_C.size - round(known * 12 * _HOURS) :] = np.nan
        silent = replace(tank, logged=replace(tank.logged, T_C=np.full_like(T_C, np.nan) if known == 1.0 else T_C))
        with pytest.raises(DataError, match=why):
            _worth(measured, silent, _ByClock())


@pytest.mark.slow
def test_a_shadow_lives_its_tank_through(tmp_path: Path) -> None:
    home, rules, controller = HomeWithTank(_BEFORE), MeasurementMap.model_validate(MAP), _ByClock()
    controller.hot_water = learned_tank(read_measurements(home.measurements(), MAP, step_s=HOUR_S).served())
    building, model, begin = LiveBuilding(home, rules, HOUR_S), simple_model(0.05), len(home.rows)
    model.save(tmp_path / "given")
    run = real_run(tmp_path, tmp_path / "given", tmp_path / "m.yaml", rules, MPCConfig(step_s=HOUR_S), "x")
    book, words = ShadowBook(tmp_path, model, controller, tank_log=building.tank_log), list[str]()
    control(
        building,
        controller,
        clock=home,
        steps=26,
        delay_s=0.0,
        journal=LiveJournal(tmp_path, run),
        told=lambda decision: words.append(book.day_over(decision.instant)),
        acts=False,
    )
    (day,), again = book.days, ShadowBook(tmp_path, model, controller)
    assert again.days == book.days
    assert words[-1].endswith("; hot water 0.0 instead of 0.0 K·h below what is wanted")
    both = pd.DataFrame(home.rows[begin:]), _by_clock()
    alone, other = (rows[rows["time"] < START + pd.Timedelta("1D")] for rows in both)
    assert day.cost_was == pytest.approx(_cost(alone), rel=1e-3)
    # A kelvin of the tank takes 83 Wh, at 0.25 on average.
    less_K = alone["tank"].iloc[-1] - other["tank"].iloc[-1]
    assert less_K > 5.0
    assert day.saved[0] == pytest.approx(_cost(alone) - _cost(other) - 0.083 * 0.25 * less_K, abs=0.3)
