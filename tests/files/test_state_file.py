"""The file of a controller's state: what is written is read again, and nothing but values of this package is built."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from controllers.monitoring.watch import Judged, Track, WatchState
from controllers.mpc.margins import Margins
from controllers.mpc.state import MPCState
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.data import PlanStatus
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.state_file import StateFormat

FORMAT = StateFormat((*STATE_CLASSES, PlanStatus, Judged))


def test_a_state_is_read_as_it_was_written(tmp_path):
    track = Track(judged=np.array([[1.0, 0.0, np.nan, 0.1, 0.2]]), evidence={(0, 1, -1): 2.5})
    watch = WatchState((track,), asked=((900.0, 0.5), (1800.0, float("nan"))), alarm="weak", since_s=7.0)
    values = {"status": PlanStatus.WATCH, 3: [1, 2.5, None, True], "judged": Judged(1.0, 0, 0.1, 0.2, 0.3)}
    state = MPCState(0.1 + 0.2, peak_W=float("inf"), watch=(watch,), margins=Margins(np.array([1e-300, np.pi])))
    FORMAT.write(tmp_path / "state.npz", (state, values))
    again, others = FORMAT.read(tmp_path / "state.npz")
    assert others == values
    assert type(others["judged"]) is Judged
    assert (again.first_s, again.peak_W, again.predictor) == (0.1 + 0.2, float("inf"), None)
    np.testing.assert_array_equal(again.margins.offset_K, state.margins.offset_K)
    found = again.watch[0]
    assert (found.alarm, found.since_s, found.returned_s) == ("weak", 7.0, -float("inf"))
    assert found.asked[0] == (900.0, 0.5)
    assert np.isnan(found.asked[1][1])
    assert found.tracks[0].evidence == {(0, 1, -1): 2.5}
    np.testing.assert_array_equal(found.tracks[0].judged, track.judged)


@dataclass
class Foreign:
    """A class of somebody else."""

    x: int = 1


class Colour(Enum):
    """Another one."""

    RED = 1


@pytest.mark.parametrize("value", [object(), {"f": len}, np.array([object()], dtype=object), Foreign(), Colour.RED])
def test_what_is_no_value_is_not_written(tmp_path, value):
    with pytest.raises(TypeError, match="cannot be kept"):
        FORMAT.write(tmp_path / "state.npz", value)
    assert not list(tmp_path.iterdir())


def stored(path, structure):
    content = io.BytesIO()
    np.savez(content, structure=np.frombuffer(json.dumps(structure).encode(), np.uint8))
    path.write_bytes(content.getvalue())


@pytest.mark.parametrize(
    "structure",
    [
        {"is": "subprocess:Popen", "of": {"args": ["touch", "harm"]}},
        {"is": "thermoforce_mpc.files:write_whole", "of": {"path": "harm", "content": ""}},
        {"is": "controllers.mpc.controller:ThermoForceMPC", "of": {}},
        {"is": "controllers.mpc.state:MPCState", "of": {"first_s": 0.0}},
        {"is": "MPCState", "of": {"first_s": 0.0, "of_another_version": 1}},
        {"is": "WatchState", "of": {"shown_by": "a neighbour"}},
        {"is": "of_a_newer_release", "of": {}},
        {"is": "", "of": {}},
        {"is": ["MPCState"], "of": {}},
        {"is": "PlanStatus", "of": {}},
        {"enum": "thermoforce_mpc.data.plan:PlanStatus", "member": "SOLVED"},
        {"enum": "PlanStatus", "member": "BETTER"},
        {"enum": "MPCState", "member": "first_s"},
        {"array": 0},
        {"unknown": 0},
    ],
)
def test_what_this_package_did_not_write_is_refused(tmp_path, structure, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stored(tmp_path / "state.npz", structure)
    with pytest.raises(InputError, match=r"state\.npz: no state of this version"):
        FORMAT.read(tmp_path / "state.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


@dataclass(frozen=True)
class Room:
    """A class that has been renamed, and given another field."""

    temperature_C: float
    name: str = "room"


def test_a_torn_file_is_refused(tmp_path):
    FORMAT.write(tmp_path / "state.npz", MPCState(0.0))
    whole = (tmp_path / "state.npz").read_bytes()
    for n in (0, 10, len(whole) // 2, len(whole) - 1):
        (tmp_path / "state.npz").write_bytes(whole[:n])
        with pytest.raises(InputError, match="no state of this version"):
            FORMAT.read(tmp_path / "state.npz")
