"""The calendar of the suite: what is shifted when, and what must never overlap."""

from collections import Counter

import numpy as np
import pytest

from benchmarks.interventions.dataset import check_identical
from benchmarks.interventions.protocol import (
    QUICK,
    SHIFTS_K,
    WARMUP_DAYS,
    WINDOW_START_H,
    Protocol,
    days_of,
    probing_shift,
    shift_of,
)
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.energyplus.zone import CLIMATES, base_setpoint, gains

HEATED, COOLED = CLIMATES["heating_chicago"], CLIMATES["cooling_phoenix"]


def test_six_cells_of_44_pairs_with_every_shift_about_as_often():
    protocol = Protocol()
    assert len(CLIMATES) * len(WINDOW_START_H) == 6
    assert set(SHIFTS_K) == {-3.0, -2.0, -1.0, 1.0, 2.0, 3.0}
    assert protocol.probe_days == (1, 3, 7, 30)
    for position in range(3):
        shifts = [shift_of(i, position) for i in range(len(days_of(protocol, HEATED, "test")))]
        assert len(shifts) == 44
        assert set(Counter(shifts).values()) <= {7, 8}


@pytest.mark.parametrize("climate", [HEATED, COOLED])
def test_probe_validation_and_test_follow_each_other_and_quick_is_a_part_of_the_whole(climate):
    full = Protocol()
    validation, test = (days_of(full, climate, part) for part in ("validation", "test"))
    probe = range(climate.first_day, climate.first_day + full.probe_part_days)
    assert probe[-1] < validation[0]
    assert validation[-1] < test[0]
    assert set(days_of(QUICK, climate, "validation")) < set(validation)
    assert set(days_of(QUICK, climate, "test")) < set(test)
    assert WARMUP_DAYS == 25


def test_no_window_meets_an_edge_of_the_set_back():
    protocol = Protocol()
    setpoint = base_setpoint(HEATED, 1)
    edges = {0.25 * (i + 1) for i in np.flatnonzero(np.diff(setpoint))}
    assert edges == {5.0, 23.0}
    for hour in WINDOW_START_H.values():
        assert not any(hour <= edge < hour + protocol.horizon_h for edge in edges)
    shift = probing_shift(HEATED, 7, seed=1).reshape(7, 96)
    at_night = (np.arange(96) * 0.25 < 6.0) | (np.arange(96) * 0.25 >= 22.0)
    assert (shift[:, at_night] == 0.0).all()
    assert set(np.unique(shift)) <= {0.0, *SHIFTS_K}
    assert np.ptp(shift) >= 4.0


def test_a_day_has_the_same_gains_whenever_a_run_begins():
    long, short = gains(COOLED, 150, 5, seed=1), gains(COOLED, 153, 2, seed=1)
    assert (long[3 * 96 :] == short).all()
    assert (gains(COOLED, 150, 5, seed=2) != long).any()
    assert long.min() >= 0.0


def test_two_runs_that_differ_in_one_bit_before_the_intervention_are_refused():
    from paired_windows import run

    u = np.full(96, 0.3)
    later, earlier = u.copy(), u.copy()
    later[40] += 0.1
    earlier[39] = np.nextafter(0.3, 1.0)
    check_identical(run(10, u), run(10, later), 40, "pair")
    with pytest.raises(DataError, match=r"pair: .* differs at step 39, before the intervention at step 40"):
        check_identical(run(10, u), run(10, earlier), 40, "pair")


def test_steps_are_cut_with_the_samples_at_both_their_ends():
    from paired_windows import run

    record = run(10, np.linspace(0.0, 1.0, 96))
    part = record.slice(8, 12)
    assert part.n_steps == 4
    assert part.time_s[0] == record.time_s[8]
    assert (part.u[0] == record.u[0, 8:12]).all()
    assert part.T_zone_C[0, -1] == record.T_zone_C[0, 12]
