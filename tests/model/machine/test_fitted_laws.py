"""The list of laws that are fitted by least squares, with what a step of their record counts with."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import thermoforce_mpc
from thermoforce_mpc.model.machine import load

PACKAGE = Path(thermoforce_mpc.__file__).parent
SOLVERS = {"lstsq", "lsq_linear", "nnls", "least_squares", "polyfit", "curve_fit"}


def fits(path: Path) -> bool:
    """Whether a module calls a solver of least squares."""
    called = (node.func for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call))
    return any(getattr(one, "attr", getattr(one, "id", "")) in SOLVERS for one in called)


def test_every_law_that_is_fitted_is_in_the_list():
    assert load.__doc__
    listed = set(re.findall(r"`([a-z_/]+\.py)`", load.__doc__))
    assert listed == {path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if fits(path)}


def test_those_that_say_so_count_steps_by_the_correlation_of_their_errors():
    assert load.__doc__
    said = {path for path in re.findall(r"`(\S+\.py)` \| `error_of_a_step`", load.__doc__)}
    uses = {p for p in PACKAGE.rglob("*.py") if "error_of_a_step(" in p.read_text("utf-8")} - {Path(load.__file__)}
    assert said == {path.relative_to(PACKAGE).as_posix() for path in uses}
