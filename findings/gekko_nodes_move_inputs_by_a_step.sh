#!/usr/bin/env bash
# gekko's NODES, how finely a step is solved, moves every input by a whole step: by default heat of 10:00 warms the hour before.
#
# Versions: gekko 1.3.3 (its own solvers, remote=False)
# A good guess: NODES is a matter of accuracy; the value of an input at a point of `m.time` holds from there to the next point, and
# with another NODES the answer differs by what a coarser method is off
# Seen: for x' = u with u = [0, 1, 0, 0, 0] at 0, 1, …, 4 h all of the heat of hour 1 acts in the hour before it with NODES = 2, the
# default, none with 3 and 5, a sixth with 4 and a fifteenth with 6; where u is an MV that is optimised, too. With 2 the first value,
# that of now, never acts at all
# Why it matters: sun and outdoor temperature of a forecast, and the plan, are shifted by a step against the model that was fitted at
# the other setting; a plan's first entry is sent to a machine though only the second one was optimised
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile gekko==1.3.3 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
from gekko import GEKKO

HOURS, HEAT = [0, 1, 2, 3, 4], [0, 1, 0, 0, 0]
SHARE = {None: 1, 2: 1, 3: 0, 4: 1 / 6, 5: 0, 6: 1 / 15}  # of the heat of hour 1, before it


def warmed(nodes, optimised):
    m = GEKKO(remote=False)
    m.time = HOURS
    x = m.Var(0)
    if optimised:
        u = m.MV(HEAT)
        u.STATUS, u.DCOST = 1, 0
        m.Minimize((u - m.Param(HEAT)) ** 2)
    else:
        u = m.Param(HEAT)
    m.Equation(x.dt() == u)
    m.options.IMODE = 6 if optimised else 4
    if nodes:
        m.options.NODES = nodes
    m.solve(disp=False)
    assert [round(value, 6) for value in u.value] == HEAT
    return [abs(round(value, 6)) for value in x.value]


for optimised in (False, True):
    for nodes, early in SHARE.items():
        x = warmed(nodes, optimised)
        print(f"{'MV' if optimised else 'Param'}, NODES {nodes or 'by default'}: x = {x}")
        assert max(abs(seen - value) for seen, value in zip(x, [0, early, 1, 1, 1])) < 1e-5
EOF
