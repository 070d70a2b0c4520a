"""Functions of the statement, built once for each structure: kept in the process, and on disk for the next one.

A file in the user's cache folder is text with its hash, and built anew where anything differs.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.optimisation.statement.algebra import Algebra, Structure
from controllers.optimisation.statement.problem_statement import Stated, parameter_sizes, state
from thermoforce_mpc.data.compiled import sources_of
from thermoforce_mpc.dependencies import cache_folder
from thermoforce_mpc.model.operator.casadi_export import Buffered, gain_function, network_size
from thermoforce_mpc.model.operator.parameters import N_FEATURES

# Files kept: 120 of mixed use held 172 MB (2026-11-29).
_MOST_FILES = 120
# What CasADi would add to an answer, and nobody reads: how it depends on parameters.
_NO_SENSITIVITIES = {"no_nlp_grad": True, "calc_lam_p": False}


@cache
def _sources() -> str:
    """What decides how a structure is built: the text of all modules that it takes in, and the version of CasADi."""
    return "".join(file.read_text() for file in sources_of(Path(__file__))) + version("casadi")


def stored(
    s: Structure, name: str, build: Callable[[], tuple[dict[str, Any], list[ca.Function]]]
) -> tuple[dict[str, Any], list[ca.Function]]:
    """Facts and functions of a structure as they were saved, or else built and saved.

    Functions of the user (`terms`) may have changed: with them nothing is saved.
    """
    if s.terms:
        return build()
    key = hashlib.sha256(f"{_sources()}{s}".encode()).hexdigest()
    try:
        file = cache_folder() / "plans" / f"{key[:32]}.{name}"
    except RuntimeError:  # who runs this has no home
        return build()
    found = _load(file)
    if found is None:
        found = build()
        _save(file, *found)
    return found


def _load(file: Path) -> tuple[dict[str, Any], list[ca.Function]] | None:
    try:
        sha256, text = file.read_text().split("\n", 1)
        if hashlib.sha256(text.encode()).hexdigest() != sha256:
            return None
        facts, texts = json.loads(text)
        facts = {name: tuple(value) if isinstance(value, list) else value for name, value in facts.items()}
        return facts, [ca.Function.deserialize(function) for function in texts]
    except (OSError, ValueError, RuntimeError):
        return None


def _save(file: Path, facts: Mapping[str, Any], functions: Sequence[ca.Function]) -> None:
    """Save them; without a word where the folder cannot be written."""
    text = json.dumps([dict(facts), [function.serialize() for function in functions]])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, delete=False) as temporary:
            temporary.write(f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")
        Path(temporary.name).replace(file)
        for path in sorted(file.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_MOST_FILES]:
            path.unlink(missing_ok=True)
    except OSError:
        pass


# Structures kept in the process: one has about a megabyte, and buildings of one shape share it.
_MOST_STRUCTURES = 64


@dataclass(frozen=True)
class Check:
    """`function`: (u, own, p) → cost, energy cost (1, N), power (M, N), forced response (Z, N), slack (Z, N), running
    (M, N), least of each of what is `required`, the parts of the cost (`PARTS`), and all variables of the programme.
    `own`: how many the user's own are, by name.
    """

    function: ca.Function
    required: tuple[str, ...]
    own: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Functions:
    """The programme of a structure.

    `bounds`: p → least and largest values of the variables. `local`: (x, p, multipliers) → objective, gradient, second
    derivatives of the Lagrangian, equations and their Jacobian, inequalities and theirs. `rows`: (x, p) → objective and
    rows; an Ipopt is used by one at a time (`busy`). `names` of the variables in their order; `n_equal`: number of
    equations. `convex`: no derivative depends on variables or multipliers. `n_gain`: how many of the last parameters
    are gains m(x) of `A` actuators; 0 where these depend on variables.
    """

    bounds: ca.Function
    local: ca.Function
    rows: ca.Function
    names: tuple[str, ...]
    n_equal: int
    convex: bool
    A: int
    n_gain: int
    solvers: dict[str, Buffered] = field(default_factory=dict)
    busy: threading.Lock = field(default_factory=threading.Lock)

    @cached_property
    def places(self) -> dict[str, NDArray[np.intp]]:
        """Numbers of the variables of each name."""
        names = np.array(self.names)
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(self.names)}

    def ipopt(self, options: Mapping[str, Any], hidden: int) -> Buffered:
        """Ipopt on the statement with gains of `hidden` units in it, with constant derivatives where they are.

        Its parameters are those of `rows`, but for gains those of `gain_sizes`; 0 units: the gains.
        """
        constant = ("jac_c_constant", "jac_d_constant", "hessian_constant") if self.convex else ()
        options = {**options, **dict.fromkeys(constant, "yes")}
        key = json.dumps([options, hidden], sort_keys=True)
        if key not in self.solvers:
            programme, derivatives = self._programme(hidden if self.n_gain else 0)
            given: dict[str, Any] = {"print_time": False, "ipopt": options, **_NO_SENSITIVITIES, **derivatives}
            # Into arrays of its own: numbers that become CasADi's and back take 0.4 ms of a solve of 6.
            self.solvers[key] = Buffered(ca.nlpsol("plan", "ipopt", programme, given))
        return self.solvers[key]

    def _programme(self, hidden: int) -> tuple[dict[str, Any], dict[str, ca.Function]]:
        """Variables, parameters, objective and rows, with the derivatives where these are constant."""
        n_x, n_own = (self.rows.size1_in(i) for i in range(2))
        n_others, x, own = n_own - self.n_gain, ca.SX.sym("x", n_x), ca.SX.sym("p", n_own)
        p, of_cost = own, own
        if hidden:
            given, gain = _exported_gain(self.A, self.n_gain, hidden)
            others, costs = own[:n_others], ca.depends_on(self.rows(x, own)[0], own[n_others:])
            p, own = ca.vertcat(others, given), ca.vertcat(others, gain)
            # The networks stand in the rows alone where the objective does not depend on them.
            of_cost = own if costs else ca.vertcat(others, ca.SX.ones(self.n_gain))
        programme = {"x": x, "p": p, "f": self.rows(x, of_cost)[0], "g": self.rows(x, own)[1]}
        return programme, self._derivatives(x, p, own, of_cost) if self.convex else {}

    def _derivatives(self, x: ca.SX, p: ca.SX, own: ca.SX, of_cost: ca.SX) -> dict[str, ca.Function]:
        """Those of `local`, which CasADi would work out anew in every process.

        `own` parameters, and those `of_cost`, which the objective depends on, as expressions of `p`.
        """
        n_rows = self.local.size1_in(2)
        multipliers, scale, none = ca.SX.sym("lam_g", n_rows), ca.SX.sym("lam_f"), ca.DM.zeros(n_rows)
        f, gradient, *_ = self.local(x, of_cost, none)
        _, _, _, equal, A, above, G = self.local(x, own, none)
        H = self.local(x, own, multipliers)[2]
        return {
            "grad_f": ca.Function("nlp_grad_f", [x, p], [f, gradient], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": ca.Function(
                "nlp_jac_g", [x, p], [ca.vertcat(equal, above), ca.vertcat(A, G)], ["x", "p"], ["g", "jac_g_x"]
            ),
            "hess_lag": ca.Function(
                "nlp_hess_l",
                [x, p, scale, multipliers],
                [scale * ca.triu(H)],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        }


@lru_cache(_MOST_STRUCTURES)
def check_of(s: Structure) -> Check:
    """The check of a structure: from disk, or built."""
    facts, (function,) = stored(s, "check", lambda: _build_check(s))
    return Check(function, **facts)


@lru_cache(_MOST_STRUCTURES)
def functions_of(s: Structure) -> Functions:
    """The programme of a structure: from disk, or built."""
    facts, (bounds, local, rows) = stored(s, "programme", lambda: _build_programme(s))
    return Functions(bounds, local, rows, **facts)


def _build_check(s: Structure) -> tuple[dict[str, Any], list[ca.Function]]:
    plan, alg, p = _stated(s)
    required, parts = ca.vertcat(*(least for _, least in alg.required)), ca.vertcat(*plan.parts.values())
    over_steps = (plan.energy, plan.power, plan.forced, plan.slack, plan.running)
    x, *values = alg.at_given(plan.cost, *over_steps, required, parts)
    facts = {"required": tuple(what for what, _ in alg.required), "own": alg.own}
    return facts, [ca.Function("check", [alg.u, ca.veccat(*alg.given), p], [*values, x])]


def _build_programme(s: Structure) -> tuple[dict[str, Any], list[ca.Function]]:
    plan, alg, p = _stated(s)
    f, x, equal, above = plan.cost, ca.veccat(*alg.x), ca.veccat(*alg.equal), ca.veccat(*alg.above)
    rows = ca.vertcat(equal, above)
    m = ca.SX.sym("m", rows.numel())
    A, G = ca.jacobian(equal, x), ca.jacobian(above, x)
    linear = not ca.depends_on(ca.veccat(A, G), x)
    H, gradient = ca.hessian(f if linear else f + ca.dot(m, rows), x)
    facts = {"names": tuple(alg.names), "n_equal": equal.numel(), "convex": linear and not ca.depends_on(ca.vec(H), x)}
    facts |= {"A": s.A, "n_gain": 0 if s.hidden else s.A * s.N}
    outputs = [f, gradient if linear else ca.gradient(f, x), H, equal, A, above, G]
    bounds = ca.Function("bounds", [p], [ca.densify(ca.veccat(*each)) for each in (alg.low, alg.high)])
    return facts, [bounds, ca.Function("local", [x, p, m], outputs), ca.Function("rows", [x, p], [f, rows])]


def _exported_gain(A: int, n_gain: int, hidden: int) -> tuple[ca.SX, ca.SX]:
    """The parameters of the gains of all actuators and steps, and these, as `gain_sizes` orders them."""
    n, function = n_gain // A, gain_function(hidden)
    features, network = ca.SX.sym("features", N_FEATURES * A, n), ca.SX.sym("network", network_size(hidden), A)
    rows = [ca.horzsplit(features[N_FEATURES * a : N_FEATURES * (a + 1), :]) for a in range(A)]
    gain = [ca.horzcat(*(function(x, network[:, a]) for x in row)) for a, row in enumerate(rows)]
    return ca.veccat(features, network), ca.vec(ca.vertcat(*gain))


def _stated(s: Structure) -> tuple[Stated, Algebra, ca.SX]:
    q = {name: ca.SX.sym(name, *size) for name, size in parameter_sizes(s).items()}
    alg = Algebra(ca.SX.sym("u", s.A, s.N))
    return state(alg, q, s), alg, ca.veccat(*q.values())
