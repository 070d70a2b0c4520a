"""Loading of backbones by name: 'shipped', one of `known.KNOWN`, a directory, or a Hugging Face hub name.

Every failure raises `BackboneError` at once, with the cause and what to do: no long retries without a network, and no
randomly initialised weights if a file lacks tensors. Weights are read from safetensors only: a pickle runs code.
"""

from __future__ import annotations

import functools
import json
import weakref
from collections import deque
from collections.abc import Callable
from importlib import import_module, resources
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import BackboneError, suggestion
from thermoforce_mpc.model.free_response.backbones import known
from thermoforce_mpc.model.free_response.backbones.base import Backbone
from thermoforce_mpc.model.free_response.backbones.checkpoint import (
    SHARDS,
    WEIGHTS,
    check_weights,
    damaged,
    hub_folder,
    is_cached,
    stored,
    unsafe,
)
from thermoforce_mpc.registry import Registry, builder

SHIPPED, SHIPPED_WEATHER = known.SHIPPED.name, known.SHIPPED_WEATHER.name
_FOLDERS = {SHIPPED: "bolt_thermal", SHIPPED_WEATHER: "chronos2_thermal"}
FRACAST = known.FRACAST.name
_HERE = __package__
# Backbones in use: frozen, so that one serves all methods that use it, in one pass; and the last one loaded, which
# the next run of a process will need again.
_SHARED: weakref.WeakValueDictionary[tuple[object, ...], Backbone] = weakref.WeakValueDictionary()
_LAST: deque[Backbone] = deque(maxlen=1)
# By what config.json says: the adapter of a family, its loader, and the name of a known model of it.
_BY_KEY = {
    "chronos_config": ("chronos_family", "load", "chronos-2"),
    "stack_config": ("optional", "load_tirex2", "tirex-2"),
    "use_iterative_cpm_revin": ("optional", "load_timesfm3", "timesfm-3"),
    "num_variate_layers_per_group": ("optional", "load_toto2", "toto-2"),
}
_BY_TYPE = {"tinytimemixer": ("optional", "load_ttm", "ttm"), "flowstate": ("optional", "load_flowstate", "flowstate")}
# TimesFM 2.5 is loaded without a config; its weights are known by the first of their names.
_TIMESFM_25 = ("optional", "load_timesfm", "timesfm")
_FAMILIES = "Chronos-Bolt, Chronos-2, TiRex-2, TimesFM, Toto 2, TTM and FlowState"


def load_backbone(name: str) -> Backbone:
    """Load a backbone, frozen: evaluation mode and no gradients; one that is in use, or was the last, is shared.

    `name`: one of `known.KNOWN`, a plugin's, a directory with weights, or a hub name such as
    'amazon/chronos-bolt-small'. Raises `BackboneError` for unknown names, packages that are not installed, damaged or
    incomplete weights, a hub that does not answer, or an unsupported family.
    """
    key = _same(name)
    backbone = _SHARED.get(key)
    if backbone is None:
        backbone = REGISTRY.find(name)() if name in REGISTRY else _named(name)
        for module in backbone.modules:
            module.eval().requires_grad_(False)
        _SHARED[key] = backbone
    _LAST.append(backbone)
    return backbone


def is_fetched(name: str) -> bool:
    """Whether a hub would be asked for the backbone `name`: it is on one, and not in this user's cache of it."""
    for model in known.KNOWN:
        if model.name == name:
            name = model.checkpoint
            break
    else:
        if name in REGISTRY or name.startswith((".", "/", "~")) or Path(name).exists():
            return False
    return name.count("/") == 1 and not is_cached(name)


def _same(name: str) -> tuple[object, ...]:
    """What tells backbones apart: the name, and of a directory the state of its files."""
    folder = Path(name).expanduser()
    if name in REGISTRY or not folder.is_dir():
        return (name,)
    files = [(path.name, path.stat()) for path in sorted(folder.iterdir())]
    return (str(folder.resolve()), *((file, stat.st_size, stat.st_mtime_ns) for file, stat in files))


def shipped_folder(name: str = SHIPPED) -> Path:
    """Return the folder of a shipped checkpoint: 'shipped' or 'shipped_weather'."""
    return Path(str(resources.files(_HERE).joinpath("weights", _FOLDERS[name])))


def _shipped(name: str, model: str) -> Backbone:
    """A checkpoint in this package."""
    from thermoforce_mpc.model.free_response.backbones.chronos_family import load

    label = f"shipped {model} checkpoint, trained on synthetic series only"
    return _checked(name, shipped_folder(name), functools.partial(load, label=label))


def _fracast() -> Backbone:
    """A second pretrained backbone, extra [fracast]."""
    from thermoforce_mpc.model.free_response.backbones.optional import FracastBackbone

    return FracastBackbone()


def _on_hub(model: known.Known) -> Backbone:
    """A model whose weights are on the hub."""
    model.check()
    return _of_folder(model.name, hub_folder(model.checkpoint))


# Other distributions announce a function that returns a `Backbone` in the group `thermoforce_mpc.backbones`.
REGISTRY: Registry[Callable[[], Backbone]] = Registry(
    "backbone",
    "backbones",
    {
        SHIPPED: functools.partial(_shipped, SHIPPED, "Bolt"),
        SHIPPED_WEATHER: functools.partial(_shipped, SHIPPED_WEATHER, "Chronos-2"),
        FRACAST: _fracast,
        **{model.name: functools.partial(_on_hub, model) for model in known.KNOWN if model.checkpoint},
    },
    BackboneError,
    builder,
)


def _named(name: str) -> Backbone:
    """The backbone of a directory or of a hub name."""
    folder = Path(name).expanduser()
    if folder.exists() or name.startswith((".", "/", "~")):
        return _of_folder(name, folder)
    if name.count("/") != 1:
        raise BackboneError(
            f"backbone '{name}': neither a directory nor a hub name; use one of "
            f"{', '.join(REGISTRY.names)}, a directory, or a name like 'amazon/chronos-bolt-small'"
            f"{suggestion(name, REGISTRY.names)}"
        )
    return _of_folder(name, hub_folder(name))


def _of_folder(name: str, folder: Path) -> Backbone:
    if not any((folder / file).is_file() for file in ("config.json", WEIGHTS, SHARDS)):
        raise BackboneError(f"backbone {folder}: no config.json there; give the directory of a checkpoint: {_FAMILIES}")
    if not any((folder / file).is_file() for file in (WEIGHTS, SHARDS)):
        raise BackboneError(unsafe(f"backbone {folder}: no {WEIGHTS} there"))
    adapter, loader, of = _family(name, folder)
    next(model for model in known.KNOWN if model.name == of).check()
    return _checked(name, folder, getattr(import_module(f"{_HERE}.{adapter}"), loader))


def _family(name: str, folder: Path) -> tuple[str, str, str]:
    """The adapter and loader of the family that the folder's config.json, or else its weights, are of."""
    config = _config(name, folder)
    for key, family in _BY_KEY.items():
        if key in config:
            return family
    if str(config.get("model_type")) in _BY_TYPE:
        return _BY_TYPE[str(config["model_type"])]
    if any(tensor.startswith("stacked_xf.0.") for tensor in stored(name, folder)):
        return _TIMESFM_25
    raise BackboneError(
        f"backbone '{name}': {folder} holds a {config.get('model_type', 'model of an unknown kind')}; "
        f"{_FAMILIES} are supported"
    )


def _config(name: str, folder: Path) -> dict[str, Any]:
    file = folder / "config.json"
    try:
        return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}
    except (OSError, ValueError) as error:
        raise BackboneError(f"backbone '{name}': {file} cannot be loaded ({error}); copy it again") from error


def _checked(name: str, folder: Path, load: Callable[[str, Path], Backbone]) -> Backbone:
    """The backbone that `load` makes of a folder, unless its weights are not finite or were not all in the file."""
    try:
        backbone = load(name, folder)
    except BackboneError:
        raise
    except Exception as error:  # the libraries raise many types
        raise damaged(name, folder, error) from error
    for module in backbone.modules:
        check_weights(name, module.state_dict(), folder)
    return backbone
