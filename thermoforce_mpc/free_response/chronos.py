"""A frozen time-series foundation model on the control-free series T − F (paper eq:compose), never trained here.

Any Chronos-Bolt checkpoint: the one this package ships, a local directory, or a name on the Hugging Face hub.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.errors import BackboneError, DataError
from thermoforce_mpc.free_response.checks import LEVELS, checked_free
from thermoforce_mpc.free_response.persistence import Persistence
from thermoforce_mpc.types import DAY_S, Array, Boundary, FreeForecast, History

SHIPPED = "shipped"
_SHIPPED_LABEL = "shipped Bolt checkpoint, trained on synthetic series only"
# Below a day of history a daily course cannot be known: persistence takes over and says so.
_SHORTEST_HISTORY_S = DAY_S
_HUB_TIMEOUT_S = "5"


class ChronosFreeResponse:
    """Chronos-Bolt, frozen: evaluation mode, no gradients, weights hashed on request."""

    name = "chronos"

    def __init__(self, backbone: str = SHIPPED, context_steps: int = 512) -> None:
        """Load the weights.

        Args:
            backbone: 'shipped', a local directory with config.json and weights, or a hub name such as
                'amazon/chronos-bolt-small'.
            context_steps: how much of the history the model sees at most.

        Raises:
            BackboneError: the directory is missing or damaged, the hub cannot be reached or does not know the name, or
                the model is not of the Bolt family.
        """
        if context_steps < 16:
            raise BackboneError(f"context_steps is {context_steps}: the backbone reads patches of 16, give at least 16")
        self.backbone = backbone
        self._context_steps = context_steps
        self._pipeline = _load(backbone)
        for parameter in self._pipeline.model.parameters():
            parameter.requires_grad_(False)
        self._pipeline.model.eval()
        self._short = Persistence()

    @property
    def label(self) -> str:
        """What it is, for reports."""
        return _SHIPPED_LABEL if self.backbone == SHIPPED else f"Chronos-Bolt '{self.backbone}'"

    def weight_hash(self) -> str:
        """SHA-256 over names and bytes of all weights: equal before and after a run, since they are frozen."""
        digest = hashlib.sha256()
        for name, tensor in sorted(self._pipeline.model.state_dict().items()):
            digest.update(name.encode())
            digest.update(tensor.detach().cpu().contiguous().float().numpy().tobytes())
        return digest.hexdigest()

    def forecast(self, free_C: Array, history: History, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`. NaN gaps are passed to the model as they are, nothing is filled in.

        Raises:
            DataError: no value was ever measured, history and forecast differ in step, or the model's answer is not
                finite.
        """
        import torch

        free = checked_free(free_C, history)
        if free.size * boundary.step_s < _SHORTEST_HISTORY_S:
            short = self._short.forecast(free, history, boundary)
            hours = history.n_steps * boundary.step_s / 3600
            return FreeForecast(short.levels, short.quantiles_C, f"persistence: only {hours:g} h of history")
        if abs(history.step_s - boundary.step_s) > 1e-6:
            raise DataError(f"history at {history.step_s:g} s and forecast at {boundary.step_s:g} s differ in step")
        context = torch.tensor(free[-self._context_steps :], dtype=torch.float32)[None]
        with torch.no_grad(), warnings.catch_warnings():
            # Longer horizons than the model was trained for are unrolled; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            quantiles, _ = self._pipeline.predict_quantiles(context, boundary.n_steps, LEVELS.round(1).tolist())
        values = np.sort(quantiles[0].T.double().numpy(), axis=0)
        if not np.isfinite(values).all():
            raise DataError(f"{self.label} gave values that are not finite")
        return FreeForecast(LEVELS, values, self.label)


def shipped_folder() -> Path:
    """Where the shipped checkpoint lies."""
    return Path(str(resources.files("thermoforce_mpc").joinpath("data/bolt_thermal")))


def _load(backbone: str) -> Any:
    """The pipeline of a backbone; every failure is a `BackboneError` that says what to do."""
    folder = shipped_folder() if backbone == SHIPPED else Path(backbone)
    local = backbone == SHIPPED or folder.exists() or backbone.startswith((".", "/", "~"))
    if local and not (folder / "config.json").is_file():
        raise BackboneError(f"backbone {folder}: no config.json there; give the directory of a Chronos-Bolt checkpoint")
    if not local and backbone.count("/") != 1:
        raise BackboneError(
            f"backbone '{backbone}': neither a directory nor a hub name; use 'shipped', a directory, or a name like "
            "'amazon/chronos-bolt-small'"
        )
    if not local:
        # One short try: a machine without a network should hear so at once.
        os.environ.setdefault("HF_HUB_ETAG_TIMEOUT", _HUB_TIMEOUT_S)
        os.environ.setdefault("HF_HUB_DOWNLOAD_TIMEOUT", _HUB_TIMEOUT_S)
        _check_hub(backbone)
    import torch
    from chronos import BaseChronosPipeline

    try:
        pipeline = BaseChronosPipeline.from_pretrained(
            str(folder) if local else backbone, device_map="cpu", dtype=torch.float32
        )
    except Exception as error:  # the libraries below raise anything from KeyError to their own types
        reason = " ".join(str(error).split())[:300]
        raise BackboneError(f"backbone '{backbone}' cannot be loaded: {type(error).__name__}: {reason}") from error
    if not hasattr(pipeline, "quantiles"):
        raise BackboneError(f"backbone '{backbone}' is a {type(pipeline).__name__}; only Chronos-Bolt is supported")
    return pipeline


def _check_hub(name: str) -> None:
    """Fail at once when the hub does not answer, instead of after the library's many retries."""
    import requests

    endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co")
    from huggingface_hub import try_to_load_from_cache

    if isinstance(try_to_load_from_cache(name, "config.json"), str):
        return  # downloaded before: no network needed
    advice = "download it where there is a network and give its directory, or use backbone: shipped"
    if os.environ.get("HF_HUB_OFFLINE", "").upper() in {"1", "TRUE", "YES", "ON"}:
        raise BackboneError(f"backbone '{name}' is not in the local cache and HF_HUB_OFFLINE is set; {advice}")
    try:
        answer = requests.head(f"{endpoint}/{name}/resolve/main/config.json", timeout=5, allow_redirects=True)
    except requests.RequestException as error:
        raise BackboneError(
            f"backbone '{name}': {endpoint} cannot be reached ({type(error).__name__}); {advice}"
        ) from error
    if answer.status_code >= 400:
        raise BackboneError(f"backbone '{name}': {endpoint} answers {answer.status_code}; check the name, or {advice}")
