"""A plan's rollout needs no compiler, and is that of the compiled function to the last digit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from operators import random_operator

from thermoforce_mpc.model.operator.building import driven_rollout

_PLAN = """
import sys
import numpy as np
from thermoforce_mpc.model.operator.building import driven_rollout
from thermoforce_mpc.model.operator.parameters import linear_operator
operator = linear_operator([0.9, 0.99], [0.1, 0.2], step_s=3600.0)
assert driven_rollout(operator, np.zeros(2), np.ones((2, 48))).shape == (2, 48, 2)
print("numba" in sys.modules)
"""


def test_a_plan_is_rolled_out_without_the_compiler():
    done = subprocess.run([sys.executable, "-c", _PLAN], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_many_candidates_give_what_each_gives_alone():
    rng = np.random.default_rng(7)
    operator = random_operator(7, 3)
    drives, F0 = rng.uniform(0.0, 1.0, (60, 96)), rng.normal(0.0, 2.0, 3)
    together = driven_rollout(operator, F0, drives)
    assert np.array_equal(together[17], driven_rollout(operator, F0, drives[17]))
