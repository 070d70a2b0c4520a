#!/usr/bin/env bash
# SciPy's differential_evolution, brute and basinhopping end at the point whose simulation failed, if one gives NaN.
#
# Versions: scipy 1.17.1, numpy 2.4.6
# A good guess: a cost that is NaN in a part of the box counts as the worst, and the optimum (0, at 0.5) is found by all
# Seen: NaN is the smallest of all to these three: differential_evolution and brute give NaN as the least cost, basinhopping stays
# where it started. dual_annealing, direct and shgo find 0.5. None raises; success is False, where there is one
# Why it matters: a parameter search over a building model, in which one run of hundreds fails, gives the parameters of that run;
# infinity in place of NaN is right in all but basinhopping, which starts there
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile scipy==1.17.1 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
from scipy import optimize

BOX = [(0.0, 1.0)]


def searches(failed):
    def cost(point):
        return failed if point[0] < 0.3 else float((point[0] - 0.5) ** 2)

    brute = optimize.brute(cost, BOX, full_output=True, finish=None)
    results = {"brute": (brute[0], brute[1])}
    for name, search in {
        "differential_evolution": lambda: optimize.differential_evolution(cost, BOX, rng=1),
        "basinhopping": lambda: optimize.basinhopping(cost, [0.1], niter=30, rng=1),
        "dual_annealing": lambda: optimize.dual_annealing(cost, BOX, rng=1),
        "direct": lambda: optimize.direct(cost, BOX),
        "shgo": lambda: optimize.shgo(cost, BOX),
    }.items():
        result = search()
        results[name] = (float(np.ravel(result.x)[0]), float(result.fun))
    return results


by_nan, by_infinity = searches(np.nan), searches(np.inf)
for name, (point, value) in by_nan.items():
    print(f"{name}: failed runs NaN: {point:.3f} of cost {value:.3g}; infinity: {by_infinity[name][0]:.3f}")
lost = {name for name, (_, value) in by_nan.items() if np.isnan(value)}
assert lost == {"brute", "differential_evolution", "basinhopping"}, lost
assert all(abs(by_infinity[name][0] - 0.5) < 0.03 for name in by_nan if name != "basinhopping")
PY
