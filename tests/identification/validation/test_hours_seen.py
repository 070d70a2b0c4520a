"""Hours of the day in which acting does less are told from hours in which a window is opened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Record
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import run_regression
from thermoforce_mpc.identification.validation.errors_ahead import Fold, hours_seen
from thermoforce_mpc.identification.zones.data import ZoneData
from thermoforce_mpc.identification.zones.network_estimate import network_estimates
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters
from thermoforce_mpc.model.machine.blocked_hours import HourEffects
from thermoforce_mpc.model.operator.heat_input import IDENTITY

CONFIG = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
DAYS, STEP_S, POLE, KEEPS = 4, 900.0, np.exp(-1.0 / 6.0 / 4.0), 0.99
HOUR = np.arange(round(DAYS * DAY_S / STEP_S)) * STEP_S % DAY_S / HOUR_S


def told(came, jumps_K, air_K, sign=1):
    """Hours that are believed to differ in a room that is heated (cooled) from 6:00 to 9:00: by its levels 7 K after
    hours and 1.1 K in an hour. Of these `came`, the room jumps by `jumps_K`, and `air_K` are taken for air, in each
    step (n,).
    """
    rng, u = np.random.default_rng(1), 1.0 * ((HOUR >= 6.0) & (HOUR < 9.0))
    forced, free, T_C = 0.0, 0.0, [20.0]
    for k in range(u.size):
        forced = POLE * forced + (1.0 - POLE) * sign * 7.0 * came[k] * u[k]
        free = KEEPS * free + 0.03 * rng.normal() + jumps_K[k]
        T_C.append(20.0 + free + forced)
    time_s, nothing = STEP_S * np.arange(u.size + 1), np.full(u.size, np.nan)
    run = Record(time_s, np.array(T_C), np.zeros(time_s.size), np.zeros(time_s.size), u, nothing, nothing)
    weights = np.zeros((1, len(INPUTS)))
    weights[0, INPUTS.index("constant")] = 20.0 * (1.0 - KEEPS)
    parameters = RcParameters(np.array([KEEPS]), weights, STEP_S, np.array([[0.03**2]]), np.array([[0.1]]))
    regression = replace(run_regression(run, IDENTITY), air_K=air_K)
    log_tau = np.array([np.log(6.0)])
    fold = Fold([regression], log_tau, np.array([7.0 / 6.0]), sign, IDENTITY, parameters, parameters)
    effects = HourEffects(sign)
    for seen in hours_seen(fold, fold.operator(CONFIG), 0.05):
        effects = effects.after(seen)
    return set(effects.laws)


@pytest.mark.parametrize(("sign", "steps"), [(1, (7.25,)), (-1, (7.25,)), (1, (7.0, 7.25)), (1, (7.0, 7.25, 7.5))])
def test_an_hour_in_which_a_window_is_opened_is_no_schedule(sign, steps):
    opened = np.isin(HOUR, steps)
    comes, jumps_K = np.ones(HOUR.size), -sign * opened / len(steps)
    assert told(comes, jumps_K, None, sign) == {7}, "what is not known to be air"
    assert told(comes, jumps_K, jumps_K, sign) == set()


@pytest.mark.parametrize("steps", [(), (7.25,), (7.0, 7.5), (7.0, 7.25, 7.5, 7.75)])
def test_an_hour_in_which_nothing_comes_is_found_whatever_is_taken_for_air(steps):
    stands = (HOUR >= 7.0) & (HOUR < 8.0)
    assert told(1.0 - stands, np.zeros(HOUR.size), -0.28 * np.isin(HOUR, steps)) == {7}


def test_an_hour_in_which_cold_air_is_blown_is_found_by_what_comes_after_its_first_step():
    blows = (HOUR >= 7.0) & (HOUR < 8.0)
    assert told(np.ones(HOUR.size), -0.4 * blows, -0.4 * (HOUR == 7.0)) == {7}


@pytest.mark.slow
def test_what_the_network_takes_for_air_is_known_where_hours_are_compared():
    """Of two records, of which the first says too little to be fitted, the second has a fall."""
    run = record(House(), 1.0, 1800.0, noise_K=0.01)
    T_zone_C = np.array(run.T_zone_C)
    T_zone_C[:, 31:] -= 2.0 * np.exp(-0.3 * np.arange(run.n_steps - 30))
    short = replace(run.slice(0, 8), T_zone_C=np.where(np.arange(9) < 5, run.T_zone_C[:, :9], np.nan))
    runs = [short, replace(run, T_zone_C=T_zone_C)]
    data = ZoneData(CONFIG, runs, [], IDENTITY, 1)
    (estimate,) = network_estimates(runs, [], Layout.single(floor_area_m2=190.0), [data], CONFIG)
    none, found = (e.air_K for e in estimate.everything.regressions)
    assert none is None
    assert np.flatnonzero(found).tolist() == [30]
    assert found[30] == pytest.approx(-2.0, abs=0.5)
