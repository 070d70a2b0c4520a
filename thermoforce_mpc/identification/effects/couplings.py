"""Assembly of a building's operator from the fits of its zones, and which actuators act on a zone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H, Effect, in_steps
from thermoforce_mpc.model.card import TOGETHER_SD, UNTOLD_SD
from thermoforce_mpc.model.machine.load import LEVEL_EDGE, RESIDUAL_SCALE, error_of_a_step
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel, ZoneModel

# A neighbour's effect below this after a day at full level, K, is none. By judgement.
_LEAST_EFFECT_K = 0.02
# Share of the most from which a step is one of those with the most; share of what levels stand for that is all of it,
# which is 0.89 in the cold week of `house:5rooms`, whose machine is at its limit, and 1.09 in mild weather; and the
# weather in which a machine that was never at a limit feeds all circuits, °C (of 12 kW, the one of
# `office:3rooms:771300` has 12.6 by this rule and 7 by what three days of probing at 6 to 14 °C took).
_NEAR_MOST, _GIVEN, _ALL_FED_C = 0.85, 0.97, 0.0
# What full level of one of several actuators takes by the meter of their machine: prior standard deviation as a share
# of equal shares (radiators of a home differ by a factor of two to three), measured time from which the meter is asked,
# s, and the least share beside the largest. By judgement, when `bench commands` was given the meter's shares
# (2026-11-28).
_SHARES_SD, _LEAST_S, _LEAST_SHARE = 0.7, 2.0 * DAY_S, 0.1


def others_of(layout: Layout, a: int, config: IdentificationConfig) -> list[int]:
    """The actuators whose effect on the home zone of `a` is estimated beside its own."""
    home = layout.home
    return [b for b in range(len(home)) if b != a and (config.cross_effects or home[b] == home[a])]


def assembled(
    layout: Layout,
    zones: Sequence[ZoneModel],
    effects: Sequence[Sequence[Effect]],
    power: Sequence[PowerModel | None],
    config: IdentificationConfig,
    heat_sd: Sequence[float],
    together_sd: Sequence[float],
) -> ThermalModel:
    """The building from each actuator's model on its home zone (A,), the power of machines (M,), and `effects` (A,): of
    `others_of` each actuator on its home zone, none where these are not known.

    `heat_sd` (A,): relative standard deviation of what each actuator's level says of its heat; `together_sd` (A,): that
    of what all of them do together to its home zone.
    """
    Z, A = len(layout.names.zones), len(layout.names.actuators)
    pairs: list[list[OperatorParameters | None]] = [[None] * A for _ in range(Z)]
    free = [zones[(layout.actuators_of(z) or [0])[0]].free for z in range(Z)]
    cards = [zone.card for zone in zones]
    for a, home in enumerate(layout.home):
        pairs[home][a] = zones[a].operator
        if not effects[a] or layout.actuators_of(home)[0] != a:
            continue  # effects of the others on a zone are those beside its first actuator
        uncertainty, unknown = dict(cards[a].uncertainty), list[str]()
        if np.isfinite(together_sd[a]):
            uncertainty[TOGETHER_SD] = together_sd[a]
        notes = list(cards[a].notes)
        for b, effect in zip(others_of(layout, a, config), effects[a], strict=True):
            if layout.home[b] == home:
                continue
            name, of_day = layout.names.actuators[b], STEP_RESPONSE_H.index(24)
            means_K, certainty = effect.step_K, effect.uncertainty(heat_sd[b], of_logarithm=heat_sd[b] > 0.0)
            for key, value in certainty.items():
                uncertainty[f"{key}[{name}]"] = value if "_sd_" in key else layout.signs[b] * value
            if certainty["step_response_24h_sd_K"] > UNTOLD_SD * means_K[of_day]:
                unknown.append(name)
            if means_K[of_day] >= _LEAST_EFFECT_K:
                pairs[home][b] = _pair(effect, zones[b].operator, layout.signs[b])
        if unknown:
            notes.append(_not_apart(unknown, layout.names.zones[home], together_sd[a]))
        cards[a] = replace(cards[a], uncertainty=uncertainty, notes=tuple(notes))
    operator = BuildingOperator(
        layout.names.zones, layout.names.actuators, tuple(tuple(row) for row in pairs), layout.home
    )
    return ThermalModel(
        operator,
        tuple(power),
        tuple(free),
        tuple(cards),
        layout.names.machines,
        layout.machine_of,
        layout.shares,
        layout.exclusive,
        layout.floor_area_m2,
    )


def _not_apart(names: Sequence[str], zone: str, together_sd: float) -> str:
    """A note on actuators whose effect on a zone the record does not tell."""
    told = f"the record does not tell what {' and '.join(names)} {'do' if len(names) > 1 else 'does'} to {zone}"
    if not together_sd < UNTOLD_SD:
        return told
    return f"{told}: with all others together known to ± {100 * together_sd:.0f} %, apart not"


def _pair(effect: Effect, head: OperatorParameters, sign: int) -> OperatorParameters:
    """The operator of another actuator, that delivers as `head`, on a zone."""
    a, gains = in_steps(effect.log_tau, effect.gains, head.step_s)
    return replace(head, poles=a, gains=sign * gains)


def with_metered_shares(layout: Layout, heat_inputs: Sequence[HeatInput], histories: Sequence[Record]) -> Layout:
    """`layout` with the shares of machines whose actuators are all metered.

    The capacity is the largest heat that all took together over an hour: more was not seen. Where they took all that
    their levels stand for even then, that is no limit, as in mild weather: a machine that heats is taken to feed all
    circuits at full level at 0 °C. A share is the heat of full level over the capacity. Circuits that are cold take
    more than they were sized for, so the shares may sum to more than 1.
    """
    shares = list(layout.shares)
    for fed in layout.actuators_of_machines:
        if len(fed) < 2 or any(heat_inputs[a].heat is None or layout.signs[a] != layout.signs[fed[0]] for a in fed):
            continue
        most_W = max(largest_W(np.abs(h.heat_W[fed].sum(axis=0)), h.step_s) for h in histories)
        if not most_W > 0.0:
            continue
        T_out_C = float(np.nanmean(np.concatenate([h.T_out_C for h in histories])))
        if layout.signs[fed[0]] > 0 and _all_given(fed, heat_inputs, histories):
            most_W = max(most_W, sum(_full_W(heat_inputs[a], _ALL_FED_C) for a in fed))
        for a in fed:
            shares[a] = min(_full_W(heat_inputs[a], T_out_C) / most_W, 1.0)
    return replace(layout, shares=tuple(shares))


def with_shares_by_power(layout: Layout, histories: Sequence[Record]) -> Layout:
    """`layout` with the shares of actuators on one machine of which nothing is known, by what its power says of them.

    Power is taken as linear in the levels, with a part while one is open; equal shares are the prior, so that valves
    which move together keep them. The shares sum to 1: all open is the level 1 of the machine.
    """
    shares = list(layout.shares)
    for m, fed in enumerate(layout.actuators_of_machines):
        if len(fed) < 2 or any(shares[a] for a in fed):
            continue
        of_each = _power_of_each(fed, m, histories)
        for a, share in zip(fed, of_each / of_each.sum(), strict=True):
            shares[a] = float(share)
    return replace(layout, shares=tuple(shares))


def sizes_by_power(layout: Layout, histories: Sequence[Record]) -> Array:
    """Sizes of the zones (Z,) as multiples of their mean, by what a machine takes for the emitters of each: they are
    sized for their rooms. 1 where no meter of a machine that feeds several zones tells.

    Rooms whose floor area is not known would all be as large as one another: what a small one gives to others was then
    as many times too large (a bath's valve on the bedroom of `../shared/home_truth` 5.8 K, true 0.4).
    """
    sizes = np.ones(len(layout.floor_area_m2))
    for m, fed in enumerate(layout.actuators_of_machines):
        zones = sorted({layout.home[a] for a in fed})
        if len(zones) < 2:
            continue
        of_each = _power_of_each(fed, m, histories)
        of_zone = np.array([sum(W for a, W in zip(fed, of_each, strict=True) if layout.home[a] == z) for z in zones])
        sizes[zones] = of_zone / of_zone.mean()
    return sizes


def _power_of_each(fed: Sequence[int], machine: int, histories: Sequence[Record]) -> Array:
    """What full level of each of the actuators `fed` (A,) by a machine takes of its power, W, above 0; alike where its
    meter does not tell.
    """
    u = np.abs(np.concatenate([h.u[fed] for h in histories], axis=1))
    power_W, step_s = np.concatenate([h.power_W[machine] for h in histories]), histories[0].step_s
    equal = np.ones(len(u))
    known = np.isfinite(power_W) & np.isfinite(u).all(axis=0)
    if known.sum() * step_s < _LEAST_S or not u[:, known].sum() > 0.0:
        return equal
    levels, W = u[:, known].T, power_W[known]
    is_on = (levels > LEVEL_EDGE).any(axis=1).astype(np.float64)
    together = np.column_stack([np.ones(len(W)), is_on, levels.sum(axis=1)])
    alike = np.linalg.lstsq(together, W, rcond=None)[0]
    if not (each_W := float(alike[2])) > 0.0:
        return equal
    columns = np.column_stack([np.ones(len(W)), is_on, levels])
    prior = np.hstack([np.zeros((len(u), 2)), np.eye(len(u)) / (_SHARES_SD * each_W)])

    def fitted(residual_W: Array) -> Array:
        from scipy.optimize import lsq_linear

        error_W = error_of_a_step(residual_W, RESIDUAL_SCALE * float(np.max(W)))
        rows = np.vstack([columns / error_W, prior])
        return np.asarray(lsq_linear(rows, np.append(W / error_W, np.full(len(u), 1.0 / _SHARES_SD)), (0.0, np.inf)).x)

    # What valves that are alike leave has what makes them differ in it: the errors are those of a first fit.
    found = fitted(W - columns @ fitted(W - together @ alike))[2:]
    return np.asarray(np.maximum(found, _LEAST_SHARE * found.max()))


def _full_W(heat_input: HeatInput, T_out_C: float) -> float:
    """Heat of full level, W."""
    return float(heat_input(np.asarray(1.0), np.asarray(T_out_C))) * heat_input.reference_W


def _all_given(fed: Sequence[int], heat_inputs: Sequence[HeatInput], histories: Sequence[Record]) -> bool:
    """Whether a machine gave what the levels stand for also in the steps in which they stood for most."""
    asked, given = np.zeros(0), np.zeros(0)
    for h in histories:
        by_law = [heat_inputs[a](h.u[a], h.T_out_C[:-1]) * heat_inputs[a].reference_W for a in fed]
        asked = np.append(asked, np.sum(by_law, axis=0))
        given = np.append(given, np.abs(h.heat_W[list(fed)].sum(axis=0)))
    known = np.isfinite(asked) & np.isfinite(given)
    most = known & (asked >= _NEAR_MOST * np.max(asked[known], initial=0.0))
    return bool(given[most].sum() >= _GIVEN * asked[most].sum() > 0.0)


def largest_W(heat_W: Array, step_s: float) -> float:
    """Largest mean of an hour, W; steps that were not metered do not count."""
    mean = hourly(heat_W, step_s)
    return float(np.nanmax(mean)) if np.isfinite(mean).any() else float("nan")


def hourly(of_steps: Array, step_s: float) -> Array:
    """Mean of every hour of a record, one from each step on (m,), of values of its steps (n,)."""
    n = max(1, min(of_steps.size, round(HOUR_S / step_s)))
    return np.convolve(of_steps, np.ones(n) / n, "valid")
