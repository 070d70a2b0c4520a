"""Trials of chaos with files from elsewhere: none is wrong today, and a fault in them would be told."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.chaos.files import TRIALS, prepared, run_trial


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield prepared(tmp_path_factory.mktemp("trials"))


SLOW = {"hanging FMU", "two controllers", "torn table", "wrong wall clock", "live faults"}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "n"), [(kind, n) for kind in TRIALS for n in range(1 if kind in SLOW else 3)])
def test_no_trial_is_wrong(folder, kind, n):
    outcome = run_trial(kind, (11, n), folder)
    assert outcome.faults == ()
    assert outcome.made == {kind: 1}


def test_what_a_trial_raises_is_a_fault(monkeypatch, tmp_path):
    def broken(rng: np.random.Generator, folder: object) -> list[str]:
        raise ZeroDivisionError("odd")

    monkeypatch.setitem(TRIALS, "flipped bits", broken)
    assert run_trial("flipped bits", (1, 1), tmp_path).faults == ("ended with ZeroDivisionError: odd",)
