"""File format of a model: a folder with `model.json` and `arrays.safetensors`, without pickle.

The JSON contains the format's name and version, the SHA-256 of the arrays and that of its own content, so that a file
that was damaged or edited is refused. A folder is written to a temporary place and then moved, so that it is either
complete or absent.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.files import check_replaceable, parse_json, read_bounded, write_folder
from thermoforce_mpc.version import VERSION

FORMAT = "thermoforce-mpc thermal model"
FORMAT_VERSION = 8

JSON_NAME = "model.json"
ARRAYS_NAME = "arrays.safetensors"
# Thirty rooms with all pairs coupled: 0.8 MB of JSON, 2.1 MB of arrays.
_MOST_JSON_BYTES, _MOST_ARRAYS_BYTES = 20_000_000, 100_000_000


def check_target(folder: Path, *, overwrite: bool) -> None:
    """Check that a model may be written to `folder`.

    Raises:
        ArtifactError: `folder` exists, unless `overwrite` is set and it contains a model.
    """
    check_replaceable(folder, JSON_NAME, "model", overwrite=overwrite)


def write_model_file(folder: Path, content: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write `content` (plain values and numpy numbers) and `arrays` to `folder`; equal input gives equal bytes.

    Raises:
        StorageError: the folder cannot be written.
    """
    raw = save_tensors({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    head = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "code_version": VERSION,
        "arrays_sha256": hashlib.sha256(raw).hexdigest(),
    }
    document = _plain(head | dict(content) | head)
    text = json.dumps(document | {"sha256": content_sha256(document)}, indent=2, allow_nan=False) + "\n"
    write_folder(folder, {ARRAYS_NAME: raw, JSON_NAME: text.encode()})


def read_model_file(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the content and the arrays of a saved model.

    Raises:
        ArtifactError: the folder or a file is missing, damaged, not a model or of another version; names the file.
    """
    path = folder / JSON_NAME
    content = _read_json(folder)
    if content.get("version") != FORMAT_VERSION:
        raise ArtifactError(
            f"{path}: format version {content.get('version')!r:.20}, this release reads {FORMAT_VERSION}; identify "
            f"again from the same data, or use thermoforce-mpc {content.get('code_version')!s:.20}, which wrote it"
        )
    if content_sha256(content) != content.get("sha256"):
        raise ArtifactError(f"{path}: damaged or edited, its content has another sha256 than it says; identify again")
    return content, _read_arrays(folder, content)


def _read_arrays(folder: Path, content: Mapping[str, Any]) -> dict[str, Array]:
    arrays_path = folder / ARRAYS_NAME
    raw = read_bounded(arrays_path, _MOST_ARRAYS_BYTES, ArtifactError)
    digest = hashlib.sha256(raw).hexdigest()
    if digest != content.get("arrays_sha256"):
        raise ArtifactError(f"{arrays_path}: damaged or swapped, its sha256 is not the one in {JSON_NAME}")
    try:
        return load_tensors(raw)
    except (SafetensorError, ValueError, TypeError, KeyError) as error:  # the last two: a type that numpy lacks
        raise ArtifactError(f"{arrays_path}: not a readable safetensors file ({error})") from error


def _read_json(folder: Path) -> dict[str, Any]:
    path = folder / JSON_NAME
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; `tf-mpc identify` makes one")
    document = parse_json(read_bounded(path, _MOST_JSON_BYTES, ArtifactError), str(path), ArtifactError)
    if document.get("format") != FORMAT:
        raise ArtifactError(f"{path}: not a model of thermoforce-mpc (its 'format' is not '{FORMAT}')")
    return document


def content_sha256(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a model's JSON document, layout and the entry `sha256` left aside."""
    content = {key: value for key, value in document.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return `value` in JSON types; numbers that are not finite become null, since JSON has no NaN."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
