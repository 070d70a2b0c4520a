"""What a plant is told, checked actuator by actuator."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from thermoforce_mpc.data import Block, Names
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.shell import check_levels

NAMES = Names(("bath", "hall"), ("radiator", "floor"), ("boiler",))
BAND = (20.0, 24.0)


@pytest.mark.parametrize(
    ("u", "band", "expected"),
    [
        (None, None, Block((None, None), 900.0)),
        ((0.5, None), None, Block((0.5, None), 900.0)),
        ([0, np.float64(1.0)], None, Block((0.0, 1.0), 900.0)),
        (np.array([0.25, 0.75]), (BAND, None), Block((0.25, 0.75), 900.0, (BAND, None))),
    ],
)
def test_levels_and_bands_come_out_one_per_actuator(u, band, expected):
    assert check_levels(u, 900, band, names=NAMES) == expected


@pytest.mark.parametrize(("u", "band"), [(0.5, BAND), ((0.5,), (BAND,)), (np.float32(0.5), list(BAND))])
def test_one_actuator_takes_a_number_and_a_pair(u, band):
    found = check_levels(u, 900, band)
    assert (found.u, tuple(found.command[0])) == ((0.5,), BAND)


@pytest.mark.parametrize(
    ("u", "band", "message"),
    [
        ((0.5, 1.2), None, "level of 1.2 for 'floor': expected a number from 0 to 1, or None"),
        ((-0.5, -0.5), None, "level of -0.5 for 'floor'"),
        ((math.nan, 0.5), None, "level of nan for 'radiator'"),
        (("on", 0.5), None, "level of 'on' for 'radiator'"),
        (0.5, None, "levels of 1 actuators: expected one for each of radiator, floor"),
        ((0.5, 0.5, 0.5), None, "levels of 3 actuators"),
        (None, (BAND,), "commands of 1 actuators"),
        (None, (BAND, (24.0, 20.0)), "room set-points of (24.0, 20.0) °C for 'floor'"),
        (None, ("warm", None), "command of 'warm' for 'radiator'"),
        (None, (math.nan, 21.0), "command of nan for 'radiator'"),
        (None, (BAND, (20.0, math.inf)), "for 'floor'"),
    ],
)
def test_what_is_wrong_is_named_with_its_actuator(u, band, message):
    with pytest.raises(InputError, match=re.escape(message)):
        check_levels(u, 900, band, names=NAMES, u_min=(-1.0, 0.0))


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf, 365 * 86400.0, "900"])
def test_a_bad_duration_is_refused(duration):
    with pytest.raises(InputError, match="step of"):
        check_levels((0.5, 0.5), duration, names=NAMES)
