#!/usr/bin/env bash
# In do-mpc the scaling of an input changes the controller: penalties on its moves count in scaled units.
#
# Versions: do-mpc 5.1.2, casadi 3.8.2
# A good guess: scaling is for the solver's numbers; the optimum stays
# Seen: with `set_rterm(u=0.1)` the first move of a heated room is 0.685; with scaling['_u', 'u'] = 0.1 it is 0.188, with 10 it
# is 1.0. Scaling of a state changes nothing
# Why it matters: who scales 5,000 W to one for a better conditioned problem makes moves cheaper by 25 million and gets
# another controller; comparisons between packages have to set scaling alike
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile do-mpc==5.1.2 casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - > "$work/out" <<'EOF'
import do_mpc
import numpy as np


def first_move(**scaling):
    model = do_mpc.model.Model("discrete")
    T, u = model.set_variable("_x", "T"), model.set_variable("_u", "u")
    model.set_rhs("T", T + 0.1 * (5 - T) + 4 * u)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step = 10, 1
    mpc.settings.supress_ipopt_output()
    mpc.set_objective(lterm=0.01 * (T - 21) ** 2, mterm=0.01 * (T - 21) ** 2)
    mpc.set_rterm(u=0.1)
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = 0, 1
    for name, scale in scaling.items():
        mpc.scaling["_x" if name == "T" else "_u", name] = scale
    mpc.setup()
    mpc.x0 = np.array([18.0])
    mpc.set_initial_guess()
    return float(mpc.make_step(np.array([18.0])).item())


plain, state, small, large = first_move(), first_move(T=100), first_move(u=0.1), first_move(u=10)
print(f"SEEN first move: {plain:.3f}; state scaled {state:.3f}; input scaled by 0.1 {small:.3f}, by 10 {large:.3f}")
assert abs(state - plain) < 1e-3 and small < 0.3 and large > 0.95
EOF
grep SEEN "$work/out"
