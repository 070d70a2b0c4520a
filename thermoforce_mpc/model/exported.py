"""The trained operator of a model as CasADi functions, at the step that is asked for: for programmes of your own.

All take features x = (T − F of the zone in °C, outdoor °C, global horizontal W/m², cos(2π(hour − 15)/24)), shape (4,),
of the start of a step and of the actuator's home zone. Where heat was measured and has a fixed part while on,
`part_load` says what a level is (what enters below is v, the heat as a share of that of full level):

- `blocks`: the share of the step at full level, as the controllers switch a machine; linear in u.
- `held`: the level that is held for the step, with the identified law: on(u) = min(u / lowest level, 1) has a kink, in
  which Ipopt can stay for thousands of iterations. To predict with, not to optimise over.
- `smooth`: the same with the kink rounded off; v differs by at most 2.5 % of its fixed part, most at the lowest level.
- `split`: u with a further input `on`, the share of the step in which the machine runs, after u; linear in both. Your
  programme keeps 0 ≤ u ≤ on ≤ 1 and lowest level · on ≤ u: while on, the level is u / on.

Where it was not measured, v is proportional to u and all are the same.
"""

from __future__ import annotations

from typing import Literal, get_args

import casadi as ca
import numpy as np

from thermoforce_mpc.data.clock import PLAN_STEP_S
from thermoforce_mpc.errors import DataError, check_kind, suggestion
from thermoforce_mpc.model.operator import casadi_export
from thermoforce_mpc.model.operator.casadi_export import heat_input_expression
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OUTDOOR, OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel

PartLoad = Literal["blocks", "held", "smooth", "split"]
# Width of the rounding, as a share of the lowest level. By judgement: solvers see no kink, levels no difference.
_ROUNDING = 0.05
_GIVE = "identify or load_model gives one"


def modulation_function(model: ThermalModel, *, actuator: str | None = None) -> ca.Function:
    """Return the gain m(x) of an actuator (paper eq:mod): `x` (4,) → `m`, dimensionless, in [1 − γ, 1 + γ].

    `actuator` may be left out where there is one; raises `DataError` for an unknown or missing name.
    """
    check_kind(model, ThermalModel, "model", _GIVE)
    pair = model.operator.of_actuator(_number(actuator, model.operator.actuators, "actuator"))
    return casadi_export.modulation_function(pair)


def step_function(
    model: ThermalModel,
    step_s: float = PLAN_STEP_S,
    *,
    zone: str | None = None,
    actuator: str | None = None,
    part_load: PartLoad = "blocks",
) -> ca.Function:
    """Return one step of the forced response (paper eq:operator): `F` (r,) K, `u`, `x` (4,) → `F_next` (r,) K.

    The sum over F is what the actuator adds to the zone's temperature. With `part_load` split the inputs are F, u, on
    and x.

    Args:
        model: identified model.
        step_s: length of the step, s; the model's own does not matter.
        zone: zone that responds, by default the actuator's home; several actuators of a zone add up.
        actuator: its name; may be left out where there is one.
        part_load: what a level is, see `thermoforce_mpc.model.exported`.

    Raises:
        DataError: a name is not known or missing, the actuator has no effect there, or `step_s` or `part_load` is none.
    """
    if part_load not in get_args(PartLoad):
        raise DataError(f"part_load is {part_load!r}, expected {', '.join(get_args(PartLoad))}")
    pair = _pair(model, step_s, zone, actuator)
    F, u, on, x = ca.SX.sym("F", pair.order), ca.SX.sym("u"), ca.SX.sym("on"), ca.SX.sym("x", N_FEATURES)
    F_next = casadi_export.advanced(pair, F, x, _heat(pair, u, on, x[OUTDOOR], part_load))
    inputs = {"F": F, "u": u, "on": on, "x": x}
    if part_load != "split":
        del inputs["on"]
    return ca.Function("forced_step", list(inputs.values()), [F_next], list(inputs), ["F_next"])


def rollout_function(
    model: ThermalModel,
    n_steps: int,
    step_s: float = PLAN_STEP_S,
    *,
    zone: str | None = None,
    actuator: str | None = None,
    part_load: PartLoad = "blocks",
) -> ca.Function:
    """Return the forced response over a horizon of N = `n_steps` steps as one function; others as of `step_function`.

    Inputs `F0` (r,) K now, `u` (N,) and `X` (4, N) with x of each step in its column; outputs `modes` (r, N) and
    `forced` (1, N), their sum, K, at the end of each step. With `part_load` split the inputs are F0, u, on (N,) and X.
    Call it with numbers, or with CasADi's SX or MX of an optimisation. Raises `DataError`.
    """
    if not (isinstance(n_steps, int | np.integer) and n_steps >= 1):
        raise DataError(f"rollout_function: n_steps is {n_steps!r}, expected a whole number of at least 1")
    step = step_function(model, step_s, zone=zone, actuator=actuator, part_load=part_load)
    return casadi_export.rolled_out(step, n_steps)


def _heat(pair: OperatorParameters, u: ca.SX, on: ca.SX, T_out_C: ca.SX, part_load: PartLoad) -> ca.SX:
    heat_input = pair.heat_input.at_lowest_level(1.0) if part_load == "blocks" else pair.heat_input
    if heat_input.heat is None or part_load in ("blocks", "held"):
        return heat_input_expression(heat_input, u, T_out_C)
    if part_load == "smooth":
        on = _rounded(u / heat_input.heat.lowest_level)
    return heat_input_expression(heat_input, u, T_out_C, on)


def _rounded(z: ca.SX) -> ca.SX:
    """min(z, 1) without its kink; 0 at 0, rising."""
    return 0.5 * (z - ca.sqrt((z - 1.0) ** 2 + _ROUNDING**2) + np.sqrt(1.0 + _ROUNDING**2))


def _pair(model: ThermalModel, step_s: float, zone: str | None, actuator: str | None) -> OperatorParameters:
    check_kind(model, ThermalModel, "model", _GIVE)
    if not (isinstance(step_s, int | float | np.number) and np.isfinite(step_s) and step_s > 0):
        raise DataError(f"step_s is {step_s!r}, expected seconds above 0")
    operator = model.operator.resampled(float(step_s))
    a = _number(actuator, operator.actuators, "actuator")
    z = operator.home[a] if zone is None else _number(zone, operator.zones, "zone")
    pair = operator.pairs[z][a]
    if pair is None:
        raise DataError(f"{operator.actuators[a]} has no effect on {operator.zones[z]} in this model")
    return pair


def _number(name: str | None, names: tuple[str, ...], what: str) -> int:
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        problem = f"name the {what}" if name is None else f"no {what} '{name}'{suggestion(name, names)}"
        raise DataError(f"{problem}; the model has {', '.join(names)}")
    return names.index(name)
