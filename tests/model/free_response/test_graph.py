"""Shipped backbones run as graphs: what the library computes, refused with other weights, and exported again."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from forecasting import daily, hours
from later import Later, safetensors_torch

from benchmarks.free_response.scales import SMALLER
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Context
from thermoforce_mpc.model.free_response.backbones.loading import load_backbone, shipped_folder

exporting = Later("benchmarks.pretraining.export")
FOLDERS = (shipped_folder(), shipped_folder("shipped_weather"), *SMALLER.values())


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The least of the checkpoints with a graph, to be damaged."""
    return Path(shutil.copytree(SMALLER["shipped_tiny"], tmp_path / "copy"))


def _contexts(*sizes: tuple[int, int]) -> list[Context]:
    """Series of so many hours with gaps, one of them with nothing in its first days, and steps ahead.

    The fourth column is read by models that correct a linear one.
    """
    rng = np.random.default_rng(4)
    contexts = []
    for known, steps in sizes:
        free = daily(hours(known)) + 0.1 * rng.standard_normal(known + 1)
        free[rng.random(known + 1) < 0.1] = np.nan
        free[: known // 3] = np.nan
        contexts.append(Context(free, 5.0 * rng.random((known + 1, 4)), 5.0 * rng.random((steps, 4))))
    return contexts


def _by_library(folder: Path, to: Path, contexts: list[Context]) -> list[Array]:
    """The quantiles by torch, of a copy of the folder without a graph."""
    if not to.exists():
        shutil.copytree(folder, to, ignore=shutil.ignore_patterns("model.onnx"))
    backbone = load_backbone(str(to))
    assert backbone.modules
    return backbone.quantiles_C(contexts)


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_graph_gives_what_the_library_gives(folder: Path, tmp_path: Path) -> None:
    """For any number, length and gaps of series, also longer ones than the model reads and horizons it unrolls."""
    backbone = load_backbone(str(folder))
    assert backbone.graph is not None  # type: ignore[attr-defined]
    for sizes in ([(30, 5)], [(511, 64), (240, 24), (168, 48)], [(240, 24)] * 60, [(700, 64)], [(300, 24), (300, 90)]):
        contexts = _contexts(*sizes)
        for graph, library in zip(
            backbone.quantiles_C(contexts), _by_library(folder, tmp_path / folder.name, contexts), strict=True
        ):
            np.testing.assert_allclose(graph, library, rtol=0.0, atol=1e-4)


def test_a_graph_of_other_weights_is_refused(copy: Path) -> None:
    weights = safetensors_torch.load_file(copy / "model.safetensors")
    weights[sorted(weights)[0]].view(-1)[0] += 1e-2
    safetensors_torch.save_file(weights, copy / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(BackboneError, match=r"exported from other weights than model\.safetensors; export it again"):
        load_backbone(str(copy))


def test_a_graph_with_other_inputs_is_refused(copy: Path) -> None:
    """As one that an earlier version exported."""
    graph = copy / "model.onnx"
    graph.write_bytes(graph.read_bytes().replace(b"context", b"history"))
    with pytest.raises(BackboneError, match=r"takes history, expected context; export it again"):
        load_backbone(str(copy))


def test_a_damaged_graph_is_refused_and_without_it_the_weights_are_run_by_torch(copy: Path) -> None:
    graph = copy / "model.onnx"
    before = load_backbone(str(copy)).quantiles_C(_contexts((240, 24)))[0]
    graph.write_bytes(graph.read_bytes()[:-1000])
    with pytest.raises(BackboneError, match=r"model\.onnx cannot be loaded \(.*or delete it"):
        load_backbone(str(copy))
    graph.unlink()
    backbone = load_backbone(str(copy))
    assert backbone.modules
    np.testing.assert_allclose(backbone.quantiles_C(_contexts((240, 24)))[0], before, rtol=0.0, atol=1e-4)


@pytest.mark.slow
def test_an_exported_graph_runs_the_weights_beside_it(chronos2_folder: Path, tmp_path: Path) -> None:
    """Also with weather, another number of patches ahead, and a horizon that is left to the library."""
    folder = Path(shutil.copytree(chronos2_folder, tmp_path / "exported"))
    contexts = _contexts((100, 16), (60, 10), (30, 16), (300, 10), (100, 100))
    library = _by_library(folder, tmp_path / "library", contexts)
    assert exporting.export(folder).stat().st_size < 100_000
    backbone = load_backbone(str(folder))
    assert not backbone.modules
    for graph, expected in zip(backbone.quantiles_C(contexts), library, strict=True):
        # Random weights give hundreds of kelvin, and all of it in single precision.
        assert np.abs(graph - expected).max() < 1e-5 * np.abs(expected).max()
