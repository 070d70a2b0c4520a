"""What the temperature says of heat over the level where heat is not measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, record

from controllers.actuation.actuator import ActuationConfig, choose_actuation
from thermoforce_mpc.data import Layout
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.effects.level_laws import laws_of, part_load_costs
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import LevelCost, PowerModel, level_costs
from thermoforce_mpc.model.operator.heat_input import IDENTITY
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario

# A room heated at once, in which an hour shows what a level gives.
ROOM = House(tau_h=(0.05, 0.6, 40.0), gain_K=(6.0, 24.0), outdoor=(0.1, 0.85), solar_K=(0.2, 1.0))
CONFIG = IdentificationConfig(
    order=3, modulation="linear", part_load=True, lowest_level=0.25, sun_on_sensor=False, late_sensor=False
)


def levels(shares, seed: int = 2, n: int = 288) -> np.ndarray:
    """Off or on for an hour or two, a quarter of the runs at one of `shares`."""
    rng, u = np.random.default_rng(seed), np.empty(0)
    while u.size < n:
        level = rng.choice([1.0, rng.choice(shares)], p=[0.6, 0.4]) if rng.random() < 0.5 else 0.0
        u = np.append(u, np.full(rng.integers(2, 9), level))
    return u[:n]


class Machine(House):
    """A house whose heat is `law` of the level, of 10 kW."""

    law = staticmethod(lambda u: u)

    def heat_W(self, u, T_out):
        return 10000.0 * self.law(u)


def recorded(law, u, power):
    house = type("Lawful", (Machine,), {"law": staticmethod(law)})(ROOM.tau_h, ROOM.gain_K, ROOM.outdoor, ROOM.solar_K)
    return replace(record(house, 3.0, u=u, noise_K=0.02, heat_measured=False), power_W=power(u))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "power", "modulates"),
    [
        # At the limit of its water temperature: full level gives little more than 0.6, and power follows the heat.
        (lambda u: np.minimum(u / 0.6, 1.0), lambda u: 3000.0 * np.minimum(u / 0.6, 1.0), True),
        (lambda u: u, lambda u: (u > 0) * 900.0 + 2100.0 * u, False),
        (lambda u: u, lambda u: 3000.0 * u, True),
    ],
    ids=["saturating", "fixed loss", "boiler"],
)
def test_the_temperature_tells_the_cost_of_heat_at_part_load(law, power, modulates):
    given = recorded(law, levels((0.5, 0.25)), power)
    model = identify(given, config=CONFIG).only
    low, middle = level_costs(model.card.uncertainty)
    for found, level in ((low, 0.25), (middle, 0.5)):
        assert found.level == pytest.approx(level)
        true_heat = float(law(np.array(level))) / level
        true_cost = float(power(np.array(level))) / 3000.0 / float(law(np.array(level)))
        assert abs(found.heat - true_heat) < 2.5 * found.heat_sd, found
        assert abs(found.cost - true_cost) < 2.5 * found.cost_sd, found
    choice = choose_actuation(ActuationConfig(), model.power, model.operator.heat_input, (low, middle))
    assert choice.actuation.modulates is modulates, choice.why
    assert "heat costs" in choice.why


def of_part_load(run):
    return [one for one in laws_of([run], Layout.single(), 0, IDENTITY, CONFIG) if one.name.endswith("level")]


@pytest.mark.parametrize(
    ("power", "heat"),
    [
        (lambda u: 3000.0 * u, (1.0, 1.0)),
        (lambda u: (u > 0) * 900.0 + 2100.0 * u, (1.0, 1.0)),
        (lambda u: 3000.0 * np.minimum(u / 0.6, 1.0), (1.67, 1.67)),
        (lambda u: 3000.0 * np.minimum(u / 0.4, 1.0), (2.5, 2.0)),
        (lambda u: 1500.0 * u + 1500.0 * u**2, (1.0, 1.0)),
    ],
    ids=["boiler", "fixed loss", "limit", "low limit", "inverter"],
)
def test_power_at_two_levels_tells_a_limit_from_a_fixed_loss(power, heat):
    given = recorded(lambda u: u, levels((0.5, 0.25)), power)
    priors = of_part_load(given)
    assert [1.0 + one.mean for one in priors] == pytest.approx([1.04 * value for value in heat], rel=0.01)
    assert [one.sd for one in priors] == pytest.approx([0.1 * value for value in heat], rel=0.01)
    for unknown in (recorded(lambda u: u, levels((0.5,)), power), replace(given, power_W=np.nan * given.power_W)):
        for one in of_part_load(unknown):
            assert (one.mean, one.sd) == (pytest.approx(0.1), 0.25), "one level tells neither"


def test_part_load_is_compared_with_the_first_half_hour_of_a_machine_that_weakens():
    """At full level the water reaches its limit: from then on less heat comes, for less power. A fan takes 500 W."""
    u = levels((0.5, 0.25))
    since = np.zeros(u.size)
    for k in range(1, u.size):
        since[k] = since[k - 1] + 1 if u[k] == 1.0 == u[k - 1] else 0
    heat = np.where((u == 1.0) & (since >= 2), 0.6, u)
    given = replace(recorded(lambda u: u, u, lambda u: 0.0 * u), power_W=(u > 0) * 500.0 + 2500.0 * heat)
    priors = of_part_load(given)
    full = u == 1.0
    weakens = 3000.0 / given.power_W[0][full].mean()
    assert [1.0 + one.mean for one in priors] == pytest.approx([1.04 * 1.07 * weakens] * 2, rel=0.01)
    power = PowerModel(MachineLoad((500.0, 0.0, 2500.0, 0.0), (-10.0, 20.0), 0.25))
    found = {one.name: (weakens * 1.07 - 1.0, 0.1) for one in priors}
    low, middle = part_load_costs(found, [given], power, IDENTITY)
    assert low.cost == pytest.approx((500.0 + 625.0) / 3000.0 / 0.25, rel=0.03)
    assert low.heat == pytest.approx(1.0, abs=0.01)
    assert not choose_actuation(ActuationConfig(), power, IDENTITY, (low, middle)).actuation.modulates


def test_power_that_is_flat_from_a_quarter_on_is_no_fixed_part_unless_temperatures_say_so():
    def power(u):
        return 3000.0 * (1.0 - (1.0 - u) ** 8)

    given = recorded(lambda u: u, levels((0.5, 0.25)), power)
    for one, level in zip(of_part_load(given), (0.25, 0.5), strict=True):
        assert 1.0 + one.mean == pytest.approx(1.04 * power(level) / 3000.0 / level, rel=0.01)
        assert one.sd > 0.3, "the temperatures decide"
    law = PowerModel(MachineLoad((2580.0, 0.0, 420.0, 0.0), (-10.0, 20.0), 0.25))
    valve = [LevelCost(0.25, 1.0, 0.1, 3.6, 0.3), LevelCost(0.5, 1.0, 0.1, 2.0, 0.2)]
    assert choose_actuation(ActuationConfig(), law, IDENTITY, valve).actuation.modulates
    pump = [LevelCost(0.25, 3.4, 0.4, 1.05, 0.1), LevelCost(0.5, 1.9, 0.2, 1.02, 0.1)]
    assert not choose_actuation(ActuationConfig(), law, IDENTITY, pump).actuation.modulates


@pytest.mark.slow
def test_an_electric_heater_is_not_switched_for_an_estimate_below_what_it_can_be():
    # Errors of the record that look like 0.75 of the heat per level at part load.
    given = recorded(lambda u: np.where((u > 0) & (u < 1), 0.75 * u, u), levels((0.5, 0.25)), lambda u: 3000.0 * u)
    model = identify(given, config=CONFIG).only
    costs = level_costs(model.card.uncertainty)
    assert [found.heat for found in costs] == [1.0, 1.0]
    assert choose_actuation(ActuationConfig(), model.power, model.operator.heat_input, costs).actuation.modulates


@pytest.mark.slow
def test_where_heat_is_metered_the_meter_says_what_it_costs():
    """The house gives 1600 W while it is on and 8400 W per level, which costs 3 kW in proportion to the level."""
    given = record(ROOM, 3.0, u=levels((0.5, 0.25)), noise_K=0.02)
    given = replace(given, power_W=3000.0 * given.u[0])
    model = identify(given, config=CONFIG, floor_area_m2=190.0).only
    for found, level in zip(level_costs(model.card.uncertainty), (0.25, 0.5), strict=True):
        heat = (1600.0 + 8400.0 * level) / 10000.0 / level
        assert (found.level, found.heat) == (pytest.approx(level), pytest.approx(heat, rel=0.03))
        assert found.cost == pytest.approx(1.0 / heat, rel=0.05)
        assert found.heat_sd < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seen", [(1.0,), (0.5,)], ids=["full level only", "no full level"])
def test_nothing_is_said_of_part_load_that_was_not_seen(seen):
    u = levels(seen)
    given = recorded(lambda u: u, np.minimum(u, max(seen)), lambda u: 3000.0 * u)
    assert level_costs(identify(given, config=CONFIG).only.card.uncertainty) == ()


def test_not_knowing_the_heat_makes_part_load_dearer_and_ends_in_blocks():
    power = PowerModel(MachineLoad((0.0, 0.0, 3000.0, 0.0), (-10.0, 20.0), 0.25))
    dear = LevelCost(0.25, 1.14, 0.3, 1.0, 0.3)
    for found, modulates in ((dear, False), (replace(dear, cost=1.01), True)):
        assert choose_actuation(ActuationConfig(), power, IDENTITY, (found,)).actuation.modulates is modulates
    assert choose_actuation(ActuationConfig(mode="modulating"), power, IDENTITY, (dear,)).actuation.modulates


def test_laws_leave_off_and_full_level_as_they_are():
    u = np.array([0.0, 0.1, 0.4, 0.8, 1.0])
    given = recorded(lambda u: u, levels((0.5, 0.25)), lambda u: 3000.0 * u)
    _, low, middle = laws_of([given], Layout.single(), 0, IDENTITY, CONFIG)
    np.testing.assert_array_equal(low.phi(u, 0.0 * u), [0.0, 0.1, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(middle.phi(u, 0.0 * u), [0.0, 0.0, 0.4, 0.8, 0.0])


def test_a_run_asks_for_what_its_test_case_does_not_meter():
    metered = load_testcase("bestest_hydronic_heat_pump")
    scenario = Scenario(testcase=metered.name)
    probing, config = identification_settings(scenario, chosen_of(scenario, metered))
    assert (probing.trial_levels, probing.trial_steps, config.part_load) == ((0.5, 0.25), 4, False)
    measured = metered.measurements.model_copy(update={"heat": ()})
    blind = metered.model_copy(update={"measurements": measured})
    probing, config = identification_settings(scenario, chosen_of(scenario, blind))
    assert (probing.trial_levels, probing.trial_steps, config.part_load) == ((0.5, 0.25), 8, True)
    water = load_testcase("bestest_hydronic")
    heated = Scenario(testcase=water.name)
    assert identification_settings(heated, chosen_of(heated, water))[1].heat_input == "identity"
