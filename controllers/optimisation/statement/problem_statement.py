"""The optimisation problem of one control step, stated once.

For zones z, actuators a and machines m, over steps k of the plan,

    minimise    Σ_k [ Σ_m fixed_cost_mk · on_mk  +  Σ_a ( cost_ak u_ak + bend_cost_ak c_ak )  +  Σ_z w_z · s_zk · Δt
                      +  Σ_a ε u_ak²  +  c · o_k · Δt ]  +  π · p
    subject to  F_za,k+1 = A_za F_za,k + g_za m(x_ak) v(u_ak)     forced response of each pair (paper eq:operator)
                lower_zk − s_zk ≤ T_free,zk + Σ_a F_za,k ≤ upper_zk + s_zk,   s_zk ≥ 0,   least_ak ≤ u_ak ≤ most_ak
                P_mk = fixed_mk · on_mk + Σ_{a of m} (per_u_ak u_ak + bend_ak c_ak)
                on_mk = max( min_{θ ≥ 0} θ + Σ_{a of m} w_a max(on_ak − θ, 0),  Σ_{a of m} share_a u_ak )
                Σ_{a of m} share_a u_ak ≤ capacity_mk
                Σ_m P_mk + n_k ≤ p_0 + p,   p ≥ 0                p: peak power above the highest so far, p_0
                Σ_m P_mk ≤ max(−n_k, 0) + b_k,   b_k ≥ 0         b_k: bought, beyond what others (n_k) leave over
                Σ_m P_mk ≤ cap_k + o_k,   o_k ≥ 0                soft power cap

Where there is a surplus, energy costs what it would earn if it were fed in, and what is bought d_k more.

Levels below 0 cool, at a price and power of their own. Below its lowest level l_a an actuator switches, on at that
level for the share on_ak ≥ 0 of the step; above it, by e_ak ≥ max(0, u_ak − l_a), it holds the level and is on:

                on_ak = (u_ak − e_ak) / l_a,   c_ak = l_a e_ak + e_ak²,   v_ak = drive_ak u_ak − sag_ak e_ak.

Power P(u) per heat v(u) is least at l_a, so both are the convex envelope of what the machine does at all of its levels,
and heat costs the same whenever it is given. One that always switches, or whose heat and power are proportional to u,
has e = 0 and c = u². The first steps decide which of actuators that exclude one another acts; later they share a step.
The free response T_free is fixed. The slack makes every instance feasible. What is
stored at the end has no price: a term of the user can give it one.

A machine's actuators begin together; w_a is the share of the time that it runs while only actuator a is on
(`model.machine.load`), and it runs at least as long as its capacity asks.

All numbers, of the instance and of the operator, are parameters q, so one statement serves all buildings of one
structure. The gain m(x) is the exported function with weights and features as parameters (`gain_sizes`): its values are
known before a plan, and so quadratic programmes take them as numbers, unless x holds the predicted temperature
(`feedback`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from controllers.optimisation.problem import POWER_UNIT_W
from controllers.optimisation.statement.algebra import MOST_RUNNING, Algebra, Structure
from controllers.optimisation.statement.terms import PlanExpressions
from thermoforce_mpc.model.operator.casadi_export import network_size
from thermoforce_mpc.model.operator.parameters import N_FEATURES

Parameters = Mapping[str, ca.SX]
# What the cost is made of, currency: `other` is the curvature and the user's terms.
PARTS = ("energy", "discomfort", "peak", "cap", "other")


@dataclass(frozen=True)
class Stated:
    """Expressions of a plan: the `parts` of its cost by name; over the steps `energy` cost (1, N), `power` and
    `running` (M, N), `forced` response and `slack` (Z, N).
    """

    parts: Mapping[str, ca.SX]
    energy: ca.SX
    power: ca.SX
    forced: ca.SX
    slack: ca.SX
    running: ca.SX

    @property
    def cost(self) -> ca.SX:
        """What is minimised: all parts together."""
        return sum(self.parts.values(), ca.SX(0))


def parameter_sizes(s: Structure) -> dict[str, tuple[int, int]]:
    """Rows and columns of every parameter of the statement, in their order."""
    G, P, E = len(s.groups), len(s.pairs), sum(len(actuators) for _, actuators in s.groups)
    heat = ("drive", "sag", "per_u", "heat_cost", "bend", "bend_cost")
    sizes = {
        **{"denominator": (G, s.r * len(s.kinds)), "numerator": (s.r * len(s.kinds), E), "begin": (G, s.r)},
        **{"poles": (P, s.r * len(set(s.lengths))), "gains": (P, s.r * len(set(s.lengths))), "forced": (P, s.r)},
        **dict.fromkeys((*heat, "cold_power", "cold_cost", "least", "most"), (s.A, s.N)),
        **dict.fromkeys(("T_free", "lower", "upper"), (s.Z, s.N)),
        **dict.fromkeys(("fixed", "fixed_cost", "capacity"), (s.M, s.N)),
        **dict.fromkeys(("share", "runs_for", "u_max", "u_min", "lowest_level", "on_per_v", "last_u"), (s.A, 1)),
        **{"comfort": (s.Z, 1), "weights": (3, 1)},
        **dict.fromkeys(("reached", "limit", "surplus", "dearer"), (1, s.N)),
    }
    # The last ones: a nonlinear programme has the gain's own in its place.
    return sizes | (gain_sizes(s, s.hidden) if s.hidden else {"gain": (s.A, s.N)})


def gain_sizes(s: Structure, hidden: int) -> dict[str, tuple[int, int]]:
    """Rows and columns of the parameters of gains of `hidden` units: x of each actuator, and its network."""
    return {"features": (N_FEATURES * s.A, s.N), "network": (network_size(hidden), s.A)}


def state(alg: Algebra, q: Parameters, s: Structure) -> Stated:
    """State the plan of a structure `s` with parameters `q` in an algebra."""
    heat, cool = alg.levels(q, s)
    over, curve = _over(alg, q, s, heat)
    on = ca.repmat(q["on_per_v"], 1, s.N) * (heat - over)
    runs = _running(alg, q, s, heat, on)
    _exclude(alg, q, s, heat, cool, alg.acting(q, s, heat, cool))
    u, lengths = heat - cool, ca.DM(s.lengths).T
    forced, slack = alg.response(q, s, q["drive"] * u - q["sag"] * over)

    energy = ca.sum1(q["fixed_cost"] * runs) + ca.sum1(q["heat_cost"] * heat + q["bend_cost"] * curve)
    power = q["fixed"] * runs + _of_machines(s, q["per_u"] * heat)
    if s.signed:
        energy += ca.sum1(q["cold_cost"] * cool)
        power += _of_machines(s, q["cold_power"] * cool)
    parts = dict.fromkeys(PARTS, ca.SX(0))
    parts["discomfort"] = ca.dot(lengths, ca.mtimes(q["comfort"].T, slack))
    parts["other"] = q["weights"][0] * ca.dot(lengths, ca.sum1(u**2))
    whole = power + _of_machines(s, q["bend"] * curve)
    power = whole if s.curved else power  # rows of power are linear otherwise
    total = ca.sum1(power) / POWER_UNIT_W
    if s.exchange:
        energy += q["dearer"] * POWER_UNIT_W * alg.at_least("bought", total - q["surplus"] / POWER_UNIT_W)
    parts["energy"] = ca.sum2(energy)
    if s.peak:
        parts["peak"] = q["weights"][1] * POWER_UNIT_W * alg.highest("peak", total - q["reached"] / POWER_UNIT_W)
    if s.capped:
        over_cap = alg.at_least("over_cap", total - q["limit"] / POWER_UNIT_W)
        parts["cap"] = q["weights"][2] * POWER_UNIT_W * ca.dot(lengths, over_cap)
    for term in s.terms:
        plan = PlanExpressions(alg, u, q["T_free"] + forced, power, slack, q["last_u"], s.step_s)
        term(plan)
        parts["other"] += plan.cost
    return Stated(parts, energy, whole, forced, slack, runs)


def _over(alg: Algebra, q: Parameters, s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX]:
    """How far levels are above those below which their actuators switch, and what power bends with, (A, N) each."""
    over, curve, rows = ca.SX(s.A, s.N), heat**2, list(s.stepped)
    if rows:
        lowest_level = ca.repmat(q["lowest_level"][rows], 1, s.N)
        most = ca.repmat(q["u_max"][rows], 1, s.N) - lowest_level
        over[rows, :] = alg.at_least("over", heat[rows, :] - lowest_level, high=most)
        alg.require("", heat[rows, :] - over[rows, :])  # else what sags would cool while the level is 0
        curve[rows, :] = lowest_level * over[rows, :] + over[rows, :] ** 2
    return over, curve


def _running(alg: Algebra, q: Parameters, s: Structure, v: ca.SX, on: ca.SX) -> ca.SX:
    """Share of each step that each machine runs, (M, N), within its capacity."""
    rows, part_load = [], {m: (part, split) for m, part, split in s.part_load}
    for m in range(s.M):
        fed, loads = s.fed_by(m), []
        if m in s.limited:
            loads = [ca.mtimes(q["share"][fed].T, v[fed, :])]
            alg.require(f"capacity {m}", q["capacity"][m, :] - loads[0])
        if len(fed) == 1:
            rows.append(on[fed[0], :])
            continue
        asked = [on[a, :] for a in fed]
        if m in part_load:
            part, split = part_load[m]
            together = ca.mtimes(q["runs_for"][fed].T, on[fed, :])
            asked = [_above_part_load(alg, q, fed, part, on) if split else together]
        rows.append(alg.at_least("runs", *loads, *asked, high=MOST_RUNNING))
    return ca.vertcat(*rows)


def _above_part_load(alg: Algebra, q: Parameters, fed: list[int], part: tuple[int, ...], on: ca.SX) -> ca.SX:
    """Time that a machine runs for on-times, which it shares among the actuators `part` where they take less."""
    floor = ca.SX.zeros(1, on.shape[1])
    for a in set(fed) - set(part):
        floor = ca.fmax(floor, on[a, :])

    def runs(theta: ca.SX) -> ca.SX:
        return theta + sum(q["runs_for"][a] * ca.fmax(on[a, :] - theta, 0.0) for a in part)

    theta = alg.least("theta", [floor, *(ca.fmax(floor, on[a, :]) for a in part)], runs)
    for a in set(fed) - set(part):
        alg.require("", theta - on[a, :])
    excess = {a: alg.at_least("excess", on[a, :] - theta, high=MOST_RUNNING) for a in part}
    return theta + sum(q["runs_for"][a] * excess[a] for a in part)


def _exclude(alg: Algebra, q: Parameters, s: Structure, v: ca.SX, cold: ca.SX, acts: ca.SX) -> None:
    """Of actuators that exclude one another one acts in a first step; later they share the time."""
    for group in s.exclusive:
        what = f"exclusive {' '.join(str(a) for a in group)}"
        if s.n_chosen:
            together = ca.sum1(acts[[s.chosen.index(a) for a in group], :])
            alg.require(what, 1.0 - together)
        later = slice(s.n_chosen, v.shape[1])
        if s.n_chosen < v.shape[1]:
            shares = [v[a, later] / q["u_max"][a] for a in group]
            shares += [cold[a, later] / -q["u_min"][a] for a in group if a in s.signed]
            alg.require(what, 1.0 - ca.sum1(ca.vertcat(*shares)))


def _of_machines(s: Structure, rows: ca.SX) -> ca.SX:
    """Sums over the actuators of each machine: (A, N) → (M, N)."""
    return ca.vertcat(*(ca.sum1(rows[s.fed_by(m), :]) for m in range(s.M)))
