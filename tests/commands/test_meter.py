"""What a command does on its machine's meter beside levels: machines that are off, tanks that are charged earlier."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.mpc.commands.costs import spread_of_savings
from thermoforce_mpc.commands.contacts import SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset
from thermoforce_mpc.commands.meter import MeterEffect, MeterRecord, beyond_sd, chance_sd, learn_meter

CONTACT = SGReady(kind="sg_ready", column="contact")
HOURS, STORED_WH = np.arange(24.0), 700.0
# Hot water by hour of the day, W.
HABIT_W = np.where(np.isin(HOURS, [7, 21]), 400.0, 30.0)


def lived(states, seed=1):
    """A heat pump that heats rooms and a tank, hour by hour: state 3 stores more in it, 1 puts all off."""
    rng, missing_Wh = np.random.default_rng(seed), 0.0
    law_W, power_W = 350.0 + 40.0 * rng.standard_normal(states.size), np.empty(states.size)
    for k, state in enumerate(states):
        missing_Wh += HABIT_W[k % 24]
        wanted_Wh = missing_Wh + (STORED_WH if state == 3 else 0.0)
        charged_Wh = 0.0 if state == 1 else min(max(wanted_Wh, 0.0), 900.0)
        missing_Wh -= charged_Wh
        power_W[k] = 12.0 if state == 1 else law_W[k] + charged_Wh + 15.0 * rng.standard_normal()
    n = states.size
    return MeterRecord(states, np.full(n, 2.0), law_W, power_W, np.zeros(n), 3600.0 * np.arange(n), 3600.0)


def month(seed=1, ordinary=27, trials=3):
    rng = np.random.default_rng([seed, 2])
    return np.concatenate([np.full(24 * ordinary, 2.0), np.repeat(rng.choice([1.0, 2.0, 3.0], 12 * trials), 2)])


def day(values, meter, effects=None):
    """Power of a day with `values` by hour (24,), W, and what follows it, Wh."""
    law_W = np.full((1, 24), 350.0)
    now = meter.begin(2.0, 2.0, 86400.0, 0.0)
    course = meter.course(np.asarray(values)[None], np.full(24, 2.0), 3600.0, 1, law_W, 3600.0 * HOURS, now)
    effects = meter.mean[None] if effects is None else effects
    return (law_W + meter.power_W(course, effects, law_W, 3600.0 * HOURS))[0], float(effects[0] @ course.after_h[:, 0])


def test_a_machine_that_is_blocked_takes_nothing_and_what_was_put_off_comes_later():
    meter = learn_meter(CONTACT, lived(month()))
    assert meter.off_states == (1.0,)
    usual_W, _ = day(np.full(24, 2.0), meter)
    blocked = np.full(24, 2.0)
    blocked[7:9] = 1.0
    power_W, _ = day(blocked, meter)
    assert power_W[7:9] == pytest.approx(12.0, abs=1.0)
    assert usual_W[7] > 600.0
    assert (power_W - usual_W)[9:12].sum() > 100.0


def test_what_waits_is_that_of_the_hours_in_which_the_machine_was_off():
    """A contact that is off for a night has put off the morning's hot water, as one that is followed hour by hour."""
    meter = learn_meter(CONTACT, lived(month()))
    begins = meter.begin(2.0, 2.0, 86400.0, 3.0 * 3600.0)
    told, at_s = np.full((1, 5), 1.0), 3600.0 * np.arange(3.0, 8.0)
    followed = meter.course(told, np.full(5, 2.0), 3600.0, 1, np.full((1, 5), 350.0), at_s, begins).after
    now = meter.begin(1.0, 2.0, 5.0 * 3600.0, 8.0 * 3600.0)
    assert now.waits_Wh[:, 0] == pytest.approx(followed.waits_Wh[:, 0])
    assert now.waits_Wh[0, 0] > 400.0
    np.testing.assert_allclose(now.lagged, followed.lagged)


def test_a_state_that_charges_a_tank_takes_its_energy_first_and_saves_it_later():
    meter = learn_meter(CONTACT, lived(month()))
    usual_W, _ = day(np.full(24, 2.0), meter)
    told = np.full(24, 2.0)
    told[12:15] = 3.0
    power_W, after_Wh = day(told, meter)
    more_W = power_W - usual_W
    assert 250.0 < more_W[12:15].sum() < 1000.0, "of 700 Wh"
    assert more_W[16:].sum() + after_Wh == pytest.approx(-more_W[:16].sum(), abs=250.0)


@pytest.mark.slow
def test_its_bands_hold_what_days_take():
    inside, widths = 0, []
    for seed in range(12):
        meter = learn_meter(CONTACT, lived(month(seed), seed))
        told = np.full(24, 2.0)
        told[12:15], told[18:20] = 3.0, 1.0
        truth = [
            lived(np.concatenate([np.full(240, 2.0), values]), 99).power_W[-24:] for values in (told, told * 0 + 2)
        ]
        price = np.where((HOURS > 16) & (HOURS < 21), 0.4, 0.1) / 1000.0
        z = np.random.default_rng(seed).standard_normal((200, meter.mean.size))
        cost = np.array([day(told, meter, meter.drawn(one[None]))[0] @ price for one in z])
        cost -= day(np.full(24, 2.0), meter)[0] @ price
        by_chance = chance_sd(meter.scatter_W, price * 1000.0, 3600.0 * HOURS, 3600.0)
        beyond = beyond_sd(float(np.median(cost)), 0.0, 0.0, by_chance)
        scatter = beyond * np.random.default_rng(9).standard_normal(200)
        low, high = np.quantile(cost + scatter, [0.05, 0.95])
        inside += low <= (truth[0] - truth[1]) @ price <= high
        widths.append(high - low)
    assert inside >= 10
    assert np.median(widths) < 1.5 * abs((truth[0] - truth[1]) @ price)


def test_warmer_water_takes_a_share_of_the_power():
    rng, offset = np.random.default_rng(3), np.concatenate([np.zeros(24 * 20), np.repeat([3.0, 0.0, -3.0] * 12, 4)])
    law_W = 800.0 + 50.0 * rng.standard_normal(offset.size)
    power_W = law_W * (1.0 + 0.03 * offset) + 10.0 * rng.standard_normal(offset.size)
    n = offset.size
    seen = MeterRecord(offset, np.zeros(n), law_W, power_W, np.zeros(n), 3600.0 * np.arange(n), 3600.0)
    meter = learn_meter(CurveOffset(kind="curve_offset", column="offset"), seen)
    law_W = np.full((2, 24), 800.0)
    told = np.stack([np.zeros(24), np.full(24, 3.0)])
    now = meter.begin(0.0, 0.0, 86400.0, 0.0)
    course = meter.course(told, np.zeros(24), 3600.0, 1, law_W, 3600.0 * HOURS, now)
    more_W = np.diff(meter.power_W(course, meter.mean[None], law_W, 3600.0 * HOURS), axis=0)[0]
    assert more_W.mean() == pytest.approx(72.0, rel=0.2)


def test_a_plan_that_moves_little_is_not_wrong_by_a_share_of_all():
    of_all, of_a_tenth, of_nothing = (beyond_sd(0.0, moved, 4.0, 0.0) for moved in (4.0, 0.4, 0.0))
    assert of_nothing == 0.0, "both cost the same"
    assert of_a_tenth == pytest.approx(of_all * np.sqrt(0.1)), "errors of hours are each its own"
    assert beyond_sd(0.0, 0.4, 4.0, 0.3) == pytest.approx(np.hypot(of_a_tenth, 0.3)), "and chance"


@pytest.mark.parametrize("what", ["never tried", "no meter"])
def test_what_the_record_does_not_tell_is_not_said(what):
    states = np.full(24 * 30, 2.0) if what == "never tried" else month()
    seen = lived(states)
    if what == "no meter":
        seen.power_W[:] = np.nan
    assert learn_meter(CONTACT, seen) is None


def test_plans_may_save_what_their_commands_move_beside_levels_and_of_peaks():
    of_rooms = spread_of_savings(0.4, 0.0, 0.0)
    assert spread_of_savings(0.8, 0.0, 0.0) == pytest.approx(2.0 * of_rooms)
    assert spread_of_savings(0.4, -0.3, 0.0) == pytest.approx(np.hypot(of_rooms, 0.3)), "hot water, at other hours"
    assert spread_of_savings(0.0, 0.0, 0.2) == 0.2


def test_a_charge_shows_where_a_state_beyond_the_usual_one_clearly_takes_more_at_first():
    def effect(blocked_W: float, recommended_W: float) -> MeterEffect:
        mean, sd = np.zeros(8), np.full(8, 50.0)
        mean[0], mean[4] = blocked_W, recommended_W
        unknown = np.full(2, np.nan)
        return MeterEffect(
            np.array([1.0, 3.0]), 2.0, 1.0, unknown, mean, np.diag(sd), 100.0, np.zeros(24), np.empty((0, 24))
        )

    assert effect(0.0, 60.0).shows_a_charge
    assert not effect(0.0, 40.0).shows_a_charge
    assert not effect(200.0, 0.0).shows_a_charge, "what a blocked machine takes is no charge"
