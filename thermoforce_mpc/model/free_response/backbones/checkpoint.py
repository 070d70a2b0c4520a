"""Folders of checkpoints: fetched from the Hugging Face hub (`owner/model@revision`), and their weights checked.

Only config.json and safetensors files are fetched: other weights are pickles, which can run any code.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import BackboneError

WEIGHTS = "model.safetensors"
SHARDS = f"{WEIGHTS}.index.json"
# A server that is there answers a question for a file's head within it, s; a person waits for the answer.
_TIMEOUT_S = 5.0
_WANTED = ["config.json", "*.safetensors", SHARDS]
_ADVICE = "download it where there is a network and give its directory, or use backbone: shipped"


def hub_folder(name: str) -> Path:
    """The folder of a hub's model, downloaded unless it is cached; raises `BackboneError` within seconds."""
    from huggingface_hub import snapshot_download

    owner_model, _, revision = name.partition("@")
    local = is_cached(name)
    if not local:
        _check_hub(name, owner_model, revision or "main")
    try:
        return Path(
            snapshot_download(owner_model, revision=revision or None, allow_patterns=_WANTED, local_files_only=local)
        )
    except Exception as error:  # the library raises many types
        reason = " ".join(str(error).split())[:300]
        raise BackboneError(
            f"backbone '{name}' cannot be downloaded ({type(error).__name__}: {reason}); {_ADVICE}"
        ) from error


@contextmanager
def quiet() -> Iterator[None]:
    """Without the progress bars of `transformers`, and with what the libraries print on stderr: stdout is ours."""
    from transformers.utils import logging

    bars = logging.is_progress_bar_enabled()
    logging.disable_progress_bar()
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        if bars:
            logging.enable_progress_bar()


def unsafe(what: str) -> str:
    """What is said of a checkpoint whose weights are in a pickle; `what`: which, and where."""
    return (
        f"{what}; weights in other files (pickle: pytorch_model.bin) are not loaded, since they can run any code: "
        "convert them where you trust them (`model.save_pretrained(folder)` of transformers), or use backbone: shipped"
    )


def stored(name: str, folder: Path) -> set[str]:
    """Names of the tensors in the folder's file of weights; empty where they are in shards."""
    from safetensors import SafetensorError, safe_open

    if not (folder / WEIGHTS).is_file():
        return set()
    try:
        with safe_open(str(folder / WEIGHTS), framework="numpy") as content:
            return set(content.keys())
    except (OSError, SafetensorError) as error:
        raise damaged(name, folder, error) from error


def damaged(name: str, folder: Path, error: Exception) -> BackboneError:
    """What is raised of a folder that a library cannot load."""
    reason = " ".join(str(error).split())[:300]
    return BackboneError(
        f"backbone '{name}': {folder} cannot be loaded ({type(error).__name__}: {reason}); "
        "download or copy the checkpoint again, or use backbone: shipped"
    )


def check_weights(name: str, state: dict[str, Any], folder: Path) -> None:
    """Raise `BackboneError` for weights that are not finite or missing in the file (the libraries randomise those)."""
    import torch

    broken = [key for key, value in state.items() if not bool(torch.isfinite(value).all())]
    if broken:
        raise BackboneError(f"backbone '{name}': weights of {broken[0]} are not finite; the checkpoint is damaged")
    names = stored(name, folder)
    if not names:
        return  # in shards, whose index the libraries check
    filled = {state[key].data_ptr() for key in names & set(state)}
    missing = [key for key, value in state.items() if key not in names and value.data_ptr() not in filled]
    if missing:
        raise BackboneError(
            f"backbone '{name}': {folder / WEIGHTS} lacks {len(missing)} of {len(state)} weights, first {missing[0]}; "
            "the checkpoint is incomplete"
        )


def is_cached(name: str) -> bool:
    """Whether the weights of a hub's model are in this user's cache; False too for what is no name of one."""
    from huggingface_hub import try_to_load_from_cache
    from huggingface_hub.errors import HFValidationError

    owner_model, _, revision = name.partition("@")
    try:
        found = [try_to_load_from_cache(owner_model, file, revision=revision or None) for file in (WEIGHTS, SHARDS)]
    except HFValidationError:
        return False
    return any(isinstance(path, str) for path in found)


def _check_hub(name: str, owner_model: str, revision: str) -> None:
    """Raise `BackboneError` if the hub does not answer within 5 s, instead of after the library's retries."""
    import requests

    endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co").rstrip("/")
    if os.environ.get("HF_HUB_OFFLINE", "").upper() in {"1", "TRUE", "YES", "ON"}:
        raise BackboneError(f"backbone '{name}' is not in the local cache and HF_HUB_OFFLINE is set; {_ADVICE}")

    def status(file: str) -> int:
        try:
            url = f"{endpoint}/{owner_model}/resolve/{revision}/{file}"
            return requests.head(url, timeout=_TIMEOUT_S, allow_redirects=True).status_code
        except requests.RequestException as error:
            raise BackboneError(
                f"backbone '{name}': {endpoint} cannot be reached ({type(error).__name__}); {_ADVICE}"
            ) from error

    codes = [status(file) for file in (WEIGHTS, SHARDS)]
    if min(codes) < 400:
        return
    if status("config.json") < 400:
        raise BackboneError(unsafe(f"backbone '{name}': {endpoint} has no {WEIGHTS} of it"))
    raise BackboneError(f"backbone '{name}': {endpoint} answers {codes[0]}; check the name, or {_ADVICE}")
