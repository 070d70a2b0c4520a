"""Loading of backbones by name: 'shipped' (or a smaller scale), 'fracast', a directory, or a Hugging Face hub name.

Every failure raises `BackboneError` at once, with the cause and what to do: no long retries without a network, and no
randomly initialised weights if a file lacks tensors. Weights are read from safetensors only: a pickle runs code.
"""

from __future__ import annotations

import functools
import json
import os
import weakref
from collections import deque
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone
from thermoforce_mpc.model.free_response.backbones.graph import GRAPH, Graph
from thermoforce_mpc.registry import Registry, builder

SHIPPED = "shipped"
FRACAST = "fracast"
_WEIGHTS = "model.safetensors"
_SHARDS = f"{_WEIGHTS}.index.json"
_HUB_TIMEOUT_S = 5.0
# Shipped forecaster, and smaller scales of it for comparison (`tf-mpc bench backbones`).
_SHIPPED_FOLDERS = {SHIPPED: "bolt_thermal", "shipped_small": "bolt_thermal_small", "shipped_tiny": "bolt_thermal_tiny"}
SHIPPED_SCALES = tuple(_SHIPPED_FOLDERS)
# Backbones in use: frozen, so that one serves all methods that use it, in one pass; and the last one loaded, which
# the next run of a process will need again.
_SHARED: weakref.WeakValueDictionary[tuple[object, ...], Backbone] = weakref.WeakValueDictionary()
_LAST: deque[Backbone] = deque(maxlen=1)


def load_backbone(name: str) -> Backbone:
    """Load a backbone, frozen: evaluation mode and no gradients; one that is in use, or was the last, is shared.

    Args:
        name: one of `SHIPPED_SCALES`, 'fracast', a plugin's, a directory with config.json and weights of Chronos-Bolt
            or Chronos-2, or a hub name such as 'amazon/chronos-bolt-small'.

    Raises:
        BackboneError: unknown name, damaged or incomplete weights, hub not reachable, or unsupported model family.
    """
    key = _same(name)
    backbone = _SHARED.get(key)
    if backbone is None:
        backbone = REGISTRY.find(name)() if name in REGISTRY else _chronos(name)
        for module in backbone.modules:
            module.eval().requires_grad_(False)
        _SHARED[key] = backbone
    _LAST.append(backbone)
    return backbone


def _same(name: str) -> tuple[object, ...]:
    """What tells backbones apart: the name, and of a directory the state of its files."""
    folder = Path(name).expanduser()
    if name in REGISTRY or not folder.is_dir():
        return (name,)
    files = [(path.name, path.stat()) for path in sorted(folder.iterdir())]
    return (str(folder.resolve()), *((file, stat.st_size, stat.st_mtime_ns) for file, stat in files))


def shipped_folder(name: str = SHIPPED) -> Path:
    """Return the folder of a shipped checkpoint, one of `SHIPPED_SCALES`."""
    return Path(
        str(
            resources.files("thermoforce_mpc.model.free_response.backbones").joinpath("weights", _SHIPPED_FOLDERS[name])
        )
    )


def _fracast() -> Backbone:
    """A second pretrained backbone, extra [fracast]."""
    from thermoforce_mpc.model.free_response.backbones.fracast import FracastBackbone

    return FracastBackbone()


def _chronos(name: str) -> Backbone:
    shipped = name in SHIPPED_SCALES
    folder = shipped_folder(name) if shipped else Path(name).expanduser()
    if shipped or folder.exists() or name.startswith((".", "/", "~")):
        if not (folder / "config.json").is_file():
            raise BackboneError(
                f"backbone {folder}: no config.json there; give the directory of a Chronos-Bolt or Chronos-2 checkpoint"
            )
        if not ((folder / _WEIGHTS).is_file() or (folder / _SHARDS).is_file()):
            raise BackboneError(_unsafe(f"backbone {folder}: no {_WEIGHTS} there"))
        if (folder / GRAPH).is_file():
            return _by_graph(name, folder)
        pipeline = _pipeline(name, str(folder), local=True)
        weights = folder / _WEIGHTS
    else:
        if name.count("/") != 1:
            raise BackboneError(
                f"backbone '{name}': neither a directory nor a hub name; use one of {', '.join(REGISTRY.names)}, "
                f"a directory, or a name like 'amazon/chronos-bolt-small'"
            )
        # A cached download needs no network and keeps its version.
        cached = _cached(name, "config.json") is not None and _cached(name, _WEIGHTS) is not None
        if not cached:
            _check_hub(name)
        pipeline = _pipeline(name, name, local=cached)
        weights = _cached(name, _WEIGHTS) or Path()
    _check_weights(name, pipeline.model, weights)
    return _wrapped(name, pipeline)


def _shipped(name: str) -> Backbone:
    """Chronos-Bolt trained on synthetic series of buildings, in this package."""
    return _chronos(name)


# Other distributions announce a function that returns a `Backbone` in the group `thermoforce_mpc.backbones`.
REGISTRY: Registry[Callable[[], Backbone]] = Registry(
    "backbone",
    "backbones",
    {**{name: functools.partial(_shipped, name) for name in SHIPPED_SCALES}, FRACAST: _fracast},
    BackboneError,
    builder,
)


def _label(name: str) -> str:
    if name not in SHIPPED_SCALES:
        return f"Chronos-Bolt '{name}'"
    scale = name.removeprefix(SHIPPED).replace("_", " ")
    return f"shipped{scale} Bolt checkpoint, trained on synthetic series only"


def _by_graph(name: str, folder: Path) -> Backbone:
    """The backbone of a folder with a graph, which runs it; torch is loaded once it is asked for more."""
    from thermoforce_mpc.model.free_response.backbones.bolt import BoltBackbone

    try:
        settings = json.loads((folder / "config.json").read_text(encoding="utf-8"))["chronos_config"]
    except (ValueError, KeyError) as error:
        raise BackboneError(f"backbone {folder}: config.json is not that of a checkpoint ({error!r})") from error
    return BoltBackbone(settings, _label(name), lambda: torch_pipeline(name, folder), Graph(folder))


def torch_pipeline(name: str, folder: Path) -> Any:
    """The library's pipeline of a local checkpoint, its weights checked and frozen; raises `BackboneError`."""
    pipeline = _pipeline(name, str(folder), local=True)
    _check_weights(name, pipeline.model, folder / _WEIGHTS)
    pipeline.model.eval().requires_grad_(False)
    return pipeline


def _wrapped(name: str, pipeline: Any) -> Backbone:
    family = type(pipeline).__name__
    levels = getattr(pipeline, "quantiles", [])
    # The library clamps quantiles outside its trained levels, which would give too narrow an interval.
    if family in {"ChronosBoltPipeline", "Chronos2Pipeline"} and not (min(levels) <= 0.1 and max(levels) >= 0.9):
        raise BackboneError(f"backbone '{name}': trained for the quantiles {levels}; 0.1 to 0.9 are needed")
    if family == "ChronosBoltPipeline":
        from thermoforce_mpc.model.free_response.backbones.bolt import BoltBackbone

        return BoltBackbone(vars(pipeline.model.chronos_config), _label(name), lambda: pipeline)
    if family == "Chronos2Pipeline":
        from thermoforce_mpc.model.free_response.backbones.chronos2 import Chronos2Backbone

        return Chronos2Backbone(pipeline, f"Chronos-2 '{name}' with weather")
    raise BackboneError(f"backbone '{name}' is a {family}; Chronos-Bolt and Chronos-2 are supported")


def _pipeline(name: str, source: str, *, local: bool) -> Any:
    import torch
    from chronos import BaseChronosPipeline
    from transformers.utils import logging as transformers_logging

    bars = transformers_logging.is_progress_bar_enabled()
    transformers_logging.disable_progress_bar()
    try:
        return BaseChronosPipeline.from_pretrained(
            source, device_map="cpu", dtype=torch.float32, local_files_only=local, use_safetensors=True
        )
    except Exception as error:  # the libraries raise many types
        reason = " ".join(str(error).split())[:300]
        raise BackboneError(
            f"backbone '{name}': {source} cannot be loaded ({type(error).__name__}: {reason}); "
            "download or copy the checkpoint again, or use backbone: shipped"
        ) from error
    finally:
        if bars:
            transformers_logging.enable_progress_bar()


def _check_weights(name: str, model: Any, file: Path) -> None:
    """Raise `BackboneError` for weights that are not finite or missing in the file (the library randomises those)."""
    import torch

    state = model.state_dict()
    broken = [key for key, value in state.items() if not bool(torch.isfinite(value).all())]
    if broken:
        raise BackboneError(f"backbone '{name}': weights of {broken[0]} are not finite; the checkpoint is damaged")
    if not file.is_file():
        return  # in shards, whose index the library checks
    from safetensors import safe_open

    with safe_open(str(file), framework="pt") as content:
        stored = set(content.keys())
    filled = {state[key].data_ptr() for key in stored & set(state)}
    missing = [key for key, value in state.items() if key not in stored and value.data_ptr() not in filled]
    if missing:
        raise BackboneError(
            f"backbone '{name}': {file} lacks {len(missing)} of {len(state)} weights, first {missing[0]}; "
            "the checkpoint is incomplete"
        )


def _cached(name: str, file: str) -> Path | None:
    from huggingface_hub import try_to_load_from_cache

    path = try_to_load_from_cache(name, file)
    return Path(path) if isinstance(path, str) else None


def _check_hub(name: str) -> None:
    """Raise `BackboneError` if the hub does not answer within 5 s, instead of after the library's retries."""
    import requests

    endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co").rstrip("/")
    advice = "download it where there is a network and give its directory, or use backbone: shipped"
    if os.environ.get("HF_HUB_OFFLINE", "").upper() in {"1", "TRUE", "YES", "ON"}:
        raise BackboneError(f"backbone '{name}' is not in the local cache and HF_HUB_OFFLINE is set; {advice}")

    def status(file: str) -> int:
        try:
            url = f"{endpoint}/{name}/resolve/main/{file}"
            return requests.head(url, timeout=_HUB_TIMEOUT_S, allow_redirects=True).status_code
        except requests.RequestException as error:
            raise BackboneError(
                f"backbone '{name}': {endpoint} cannot be reached ({type(error).__name__}); {advice}"
            ) from error

    code = status("config.json")
    if code >= 400:
        raise BackboneError(f"backbone '{name}': {endpoint} answers {code}; check the name, or {advice}")
    if status(_WEIGHTS) == 404 and status(_SHARDS) == 404:
        raise BackboneError(_unsafe(f"backbone '{name}': {endpoint} has no {_WEIGHTS} of it"))


def _unsafe(what: str) -> str:
    return (
        f"{what}; weights in other files (pickle: pytorch_model.bin) are not loaded, since they can run any code: "
        "convert them where you trust them (`model.save_pretrained(folder)` of transformers), or use backbone: shipped"
    )
