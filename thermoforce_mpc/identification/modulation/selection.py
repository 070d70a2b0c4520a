"""Modulation m(x) of an operator: whether held-out data keep it, what of it is judged, and the certificate check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.modulation.candidate import Candidate
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.load_regression import LEVEL_EDGE
from thermoforce_mpc.model.machine.part_load import SWITCH_FROM, part_load
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Fixed share of heat up to which it counts as in proportion to the level.
_PROPORTIONAL = 0.1
# Levels from which full level counts as held, and share of the steps on from which lower ones are not mere trials.
_NEARLY_FULL, _OFTEN = 0.9, 0.25
# Step, s, and horizon, h, of plans by default.
_PLAN_STEP_S, _PLAN_H = 900.0, 48.0


def modulate(
    everything: Fold,
    last: Fold,
    before: Fold | None,
    config: IdentificationConfig,
    power: PowerModel | None = None,
) -> tuple[OperatorParameters, tuple[Fold, Fold | None], dict[str, float], list[str]]:
    """Train m(x) on the training rows, compare it with m = 1 on the held-out ones, and train it on `everything`.

    Where heat was measured, v = u unless levels are held. The operator is that with m = 1 where the network is
    significantly worse than that and is not kept `always`. Whether what is judged on the rows that `last` holds out has
    a network is chosen on those of `before`: rows may not judge what they chose.

    Returns:
        The operator; `last` and `before` (None where there is none) as they are judged; held-out scores; notes.
    """
    by_level, notes = False, []
    heat = everything.heat_input.heat
    if heat is not None:
        held_levels = _held_levels(heat, everything, power)
        by_level = not held_levels
        notes.append("heat input: the level, v = u" if by_level else f"heat input: measured heat, since {held_levels}")
    of_all, of_last = (Candidate(fold, config, by_level) for fold in (everything, last))
    of_before = None if before is None else Candidate(before, config, by_level)
    if of_last.kept:
        # With feedback, training uses measured temperatures, so there is no recursion; prediction uses predicted ones.
        operator = of_all.trained
    else:
        notes.append(f"network not kept: m = 1 instead, since {of_last.worse}")
        dropped = of_last.trained
        operator = replace(of_all.untrained, hidden_weight=dropped.hidden_weight, hidden_bias=dropped.hidden_bias)
    last = of_last.modulated if of_before is None or of_before.kept else last
    before = None if of_before is None else of_before.modulated
    return replace(operator, feedback=config.feedback), (last, before), of_last.scores, notes


def _held_levels(heat: MachineLoad, everything: Fold, power: PowerModel | None) -> str:
    """Why plans need the heat of levels between off and full, in words; empty where v = u will do.

    Where heat is in proportion to the level, or the machine is switched at full level, it will.
    """
    fixed, per_u = (float(part) for part in heat.parts(0.5 * sum(heat.T_out_range_C)))
    if not heat.levels_seen or fixed <= _PROPORTIONAL * (fixed + per_u):
        return ""
    u = np.concatenate([h.u[0] for e in everything.regressions for h in e.histories])
    on = u > LEVEL_EDGE
    held = np.count_nonzero(on & (u < _NEARLY_FULL)) > _OFTEN * np.count_nonzero(on)
    at_part_load = None if power is None else part_load(power, heat)
    if not held and (at_part_load is None or at_part_load.at_half > 1.0 + SWITCH_FROM):
        return ""
    return "levels between off and full are held, whose heat is not in proportion to the level"


def prove(operator: OperatorParameters) -> None:
    """Raise `DataError` if the sign of the effect is not certified for plans, possible only with `feedback: true`.

    It must be at the operator's own step and at the controllers', over their horizon (the file states 48 steps).
    """
    for step_s in dict.fromkeys((operator.step_s, _PLAN_STEP_S)):
        proof = certificate(operator.resampled(step_s), max(48, round(_PLAN_H * HOUR_S / step_s)))
        if not proof.certified:
            raise DataError(f"the identified operator at {step_s:g} s is not certified: {'; '.join(proof.reasons)}")
