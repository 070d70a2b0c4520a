"""Circuits of one machine: what an open valve takes, found beside the machine's limit and the emitter's warmth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from thermal_networks import LAYOUT, ROOMS, theta_of

from thermoforce_mpc.data import HOUR_S, Record
from thermoforce_mpc.identification.estimation.regression import run_regression
from thermoforce_mpc.identification.network.circuits import circuit_of
from thermoforce_mpc.identification.network.estimate import RoomRun
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

STEP_H, N = 0.25, 4 * 96
# Heat of full level at the means, W, and its slopes over T_out and the emitter's temperature, W/K.
FULL_W, OUTDOORS_W_K, WARMER_W_K = 1500.0, -70.0, 60.0
LIMIT_W = 2300.0
METERED = HeatInput(MachineLoad((0.0, 0.0, 1400.0, 0.0), (-20.0, 30.0), levels_seen=False))
THETA = theta_of(ROOMS[0], heat_0=70.0, C_emitter_0=20.0, H_emitter_0=3.0)


def probed(
    limit_W: float = np.inf,
    seed: int = 3,
    first_day: np.ndarray | None = None,
    first_C: float = 27.0,
    per_K: float = 0.0,
) -> tuple[Record, RoomRun, np.ndarray]:
    """Days of valves opened at random: what the first takes from water on a heating curve, and its emitter's °C.

    `first_day` (96,): levels of the first valve on the first day, after which it is half as open; `first_C`: of its
    emitter when the record begins; `limit_W` is the machine's at 0 °C, `per_K` its slope as a share of that.
    """
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([0.0, 0.5, 1.0], (3, N // 12)), 12, axis=1)
    u[2] = 0.0
    if first_day is not None:
        u[0, :96], u[0, 96:] = first_day, 0.5 * u[0, 96:]
    hours = np.arange(N + 1) * STEP_H
    T_out_C = 2.0 + 4.0 * np.sin(hours / 24.0 * 2.0 * np.pi) + 0.05 * hours
    T_zone_C = np.stack([20.5 + 0.5 * np.sin(hours / 9.0), 20.0 + 0.0 * hours])
    C, H, per_v = 20.0, 3.0, 70.0 / METERED.reference_W
    heat_W, emitter_C = np.zeros((3, N)), np.full(N + 1, first_C)
    for k in range(N):
        full = FULL_W + OUTDOORS_W_K * T_out_C[k] - WARMER_W_K * (emitter_C[k] - 27.0)
        heat_W[:2, k] = u[0, k] * full, u[1, k] * 1800.0
        heat_W[:2, k] *= min(1.0, limit_W * (1.0 + per_K * T_out_C[k]) / max(heat_W[:2, k].sum(), 1.0))
        target = T_zone_C[0, k : k + 2].mean() + per_v * heat_W[0, k] / H
        emitter_C[k + 1] = target + (emitter_C[k] - target) * np.exp(-H / C * STEP_H)
    record = Record(
        hours * HOUR_S, T_zone_C, T_out_C, np.zeros(N + 1), u, np.full((2, N), np.nan), heat_W, names=LAYOUT.names
    )
    inputs = np.zeros((N + 1, ROOMS[0].n_inputs))
    inputs[:-1, ROOMS[0].drive(0)] = heat_W[0] / METERED.reference_W
    return record, RoomRun(inputs, T_zone_C[0], STEP_H), emitter_C


def found(record: Record, run: RoomRun, heat_input: HeatInput = METERED, layout=LAYOUT):
    return circuit_of(ROOMS[0], THETA, 0, [record], [run], layout, heat_input)


def test_the_heat_of_a_valve_is_found_over_the_weather_and_its_emitter():
    record, run, emitter_C = probed()
    circuit = found(record, run)
    usual = FULL_W - WARMER_W_K * (circuit.emitter_C - 27.0)
    assert circuit.emitter_C == pytest.approx(float(record.u[0] @ emitter_C[:-1] / record.u[0].sum()), abs=0.5)
    for T_out_C in (-5.0, 2.0, 10.0):
        expected_W = usual + OUTDOORS_W_K * T_out_C
        assert float(circuit.load(np.array(1.0), np.array(T_out_C))) == pytest.approx(expected_W, rel=0.05)
    assert circuit.per_K == pytest.approx(0.3 * WARMER_W_K / METERED.reference_W, rel=0.15)
    assert circuit.full * METERED.reference_W == pytest.approx(float(circuit.load(np.array(1.0), np.array(0.0))))


def test_an_emitter_begins_as_warm_as_its_first_day_keeps_it():
    """Neither as in the first step nor as over the record: it takes hours to forget what it was before that."""
    every_other_hour = np.tile(np.repeat([1.0, 0.0], 4), 12)
    record, run, emitter_C = probed(first_day=every_other_hour, first_C=30.0)
    together_W = record.heat_W.sum(axis=0)
    u = np.where(together_W < 0.9 * together_W.max(), record.u[0], 0.0)  # the machine is not at its limit
    usual_C = float(u @ emitter_C[:-1] / u.sum())
    assert found(record, run).emitter_C == pytest.approx(usual_C, abs=0.15)


@pytest.mark.parametrize("per_K", [0.0, 0.025])
def test_steps_at_the_machine_s_limit_say_nothing_of_a_valve(per_K):
    """Also where the limit falls with the weather."""
    free, limited = (found(*probed(limit_W, per_K=per_K)[:2]) for limit_W in (np.inf, LIMIT_W))
    record = probed(LIMIT_W, per_K=per_K)[0]
    limit_W = LIMIT_W * (1.0 + per_K * record.T_out_C[:-1])
    at_limit = record.heat_W[:2].sum(axis=0) > 0.99 * limit_W
    assert at_limit.mean() > 0.1, "the machine is at its limit at times"
    assert limited.full == pytest.approx(free.full, rel=0.02)


def test_where_it_is_milder_than_in_the_record_half_of_the_heat_is_left():
    record, run, _ = probed()
    circuit = found(record, run)
    low, high = circuit.load.T_out_range_C
    assert low < -10.0
    assert high < float(record.T_out_C.max()) + 15.0
    on = record.u[0] > 0.0
    mean_C = float(record.u[0, on] @ record.T_out_C[:-1][on] / record.u[0, on].sum())
    mean_W, mild_W = (float(circuit.load(np.array(1.0), np.array(T))) for T in (mean_C, 40.0))
    assert mild_W == pytest.approx(0.5 * mean_W, rel=0.05)


def test_errors_that_last_for_hours_tell_less():
    """Against the prior slopes of the water: the same errors, which move no straight line, in order and shuffled."""
    record, run, emitter_C = probed()
    u, together_W = record.u[0], record.heat_W.sum(axis=0)
    on = (u > 0.0) & (together_W < 0.7 * together_W.max())  # far from the machine's limit, whatever the errors
    columns = (u * np.stack([np.ones(N), record.T_out_C[:-1], 0.5 * (emitter_C[1:] + emitter_C[:-1])])).T[on]

    def from_prior_per_K(errors_W: np.ndarray) -> float:
        left_W = errors_W[on] - columns @ np.linalg.lstsq(columns, errors_W[on], rcond=None)[0]
        heat_W = record.heat_W.copy()
        heat_W[0, on] += left_W
        circuit = found(replace(record, heat_W=heat_W), run)
        full = float(circuit.load(np.array(1.0), np.array(record.T_out_C[:-1][on].mean()))) / METERED.reference_W
        outdoors = circuit.load.coefficients[3] / METERED.reference_W
        return float(np.hypot(outdoors / full + 0.04, circuit.per_K / full / 0.3 - 0.04))

    lasting_W = 200.0 * np.sin(2.0 * np.pi * np.arange(N) * STEP_H / 7.3)
    shuffled_W = np.random.default_rng(0).permutation(lasting_W)
    assert from_prior_per_K(lasting_W) < 0.9 * from_prior_per_K(shuffled_W)


def test_none_without_a_meter_or_others_on_the_machine_or_enough_steps():
    record, run, _ = probed()
    assert found(record, run, IDENTITY) is None
    assert found(record, run, layout=replace(LAYOUT, machine_of=(0, 1, 1))) is None
    off = replace(record, u=np.where(np.arange(N) < 8, record.u, 0.0))
    assert found(off, run) is None


def test_a_level_that_others_left_little_of_the_machine_counts_as_what_was_metered():
    record = probed()[0]
    served = record.heat_W[0] / METERED.reference_W
    starved = np.arange(N) % 7 == 0
    record = replace(record, heat_W=np.where(starved, 0.3 * record.heat_W, record.heat_W))
    of_two, alone = (run_regression(record.part(0, actuators), METERED).drive for actuators in ([0, 1], [0]))
    level = METERED(record.u[0], record.T_out_C[:-1])
    np.testing.assert_allclose(of_two[starved], 0.3 * served[starved])
    np.testing.assert_allclose(alone, level)
    np.testing.assert_allclose(of_two[~starved], np.where(served < 0.8 * level, served, level)[~starved])
