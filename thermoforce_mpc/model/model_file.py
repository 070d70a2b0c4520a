"""Saving and loading what was identified: one folder, `model.json` and `arrays.safetensors`. Never pickle.

The JSON carries the format's name and version, the sha256 of the arrays, scalars, provenance and the certificate,
which is proven again from the weights at load. A folder is written aside and then moved in place, so that it is either
complete or absent.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.return_water import ReturnWater
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ModelCard, ThermalModel
from thermoforce_mpc.version import VERSION

FORMAT = "thermoforce-mpc thermal model"
FORMAT_VERSION = 2

JSON_NAME = "model.json"
ARRAYS_NAME = "arrays.safetensors"

_OPERATOR_ARRAYS = (
    "poles",
    "gains",
    "hidden_weight",
    "hidden_bias",
    "output_weight",
    "feature_mean",
    "feature_scale",
    "pole_bounds",
)
_FREE_ARRAYS = ("poles", "weights", "process_sd_K")


def save_model(folder: Path, model: ThermalModel, *, overwrite: bool = False) -> Path:
    """Write `model` to `folder`; the same model gives the same bytes.

    Raises:
        ArtifactError: `folder` exists (unless `overwrite` and it holds a model), the model fails its certificate, or
            the disk refuses.
    """
    folder = Path(folder)
    if folder.exists():
        if not overwrite:
            raise ArtifactError(f"{folder}: exists already; choose another folder or ask to overwrite it")
        if not (folder / JSON_NAME).is_file():
            raise ArtifactError(f"{folder}: not overwritten, since it holds no {JSON_NAME} and so is not a saved model")
    proof = certificate(model.operator)
    if not proof.certified:
        raise ArtifactError(f"{folder}: not saved, the operator fails its certificate: {'; '.join(proof.reasons)}")
    arrays = save_tensors(_arrays(model))
    document = _document(model, hashlib.sha256(arrays).hexdigest()) | {"certificate": proof.to_json()}
    text = json.dumps(_plain(document), indent=2, allow_nan=False) + "\n"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            aside.chmod(0o755)
            (aside / ARRAYS_NAME).write_bytes(arrays)
            (aside / JSON_NAME).write_text(text, encoding="utf-8")
            if folder.exists():
                shutil.rmtree(folder)
            os.replace(aside, folder)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise ArtifactError(f"{folder}: cannot be written ({error.strerror or error})") from error
    return folder


def load_model(folder: Path) -> ThermalModel:
    """Read a saved model and prove its certificate again.

    Raises:
        ArtifactError: the folder or a file is missing, damaged, foreign or of another version, or the operator fails
            its certificate; the message names the file and the reason.
    """
    folder = Path(folder)
    json_path, arrays_path = folder / JSON_NAME, folder / ARRAYS_NAME
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; `tf-mpc identify` makes one")
    document = _read_json(json_path)
    try:
        raw = arrays_path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"{arrays_path}: cannot be read ({error.strerror or error})") from error
    found = hashlib.sha256(raw).hexdigest()
    if found != document.get("arrays_sha256"):
        raise ArtifactError(f"{arrays_path}: damaged or swapped, its sha256 is not the one in {JSON_NAME}")
    try:
        tensors = load_tensors(raw)
    except (SafetensorError, ValueError) as error:
        raise ArtifactError(f"{arrays_path}: not a readable safetensors file ({error})") from error
    try:
        model = _model(document, tensors)
    except KeyError as error:
        raise ArtifactError(f"{json_path}: key {error} is missing; the file is damaged or was edited") from error
    except (DataError, TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{json_path}: {error}") from error
    proof = certificate(model.operator)
    if not proof.certified:
        raise ArtifactError(f"{json_path}: the operator fails its certificate: {'; '.join(proof.reasons)}")
    return model


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArtifactError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise ArtifactError(f"{path}: not valid JSON ({error})") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ArtifactError(f"{path}: not a model of thermoforce-mpc (its 'format' is not '{FORMAT}')")
    if document.get("version") != FORMAT_VERSION:
        raise ArtifactError(
            f"{path}: format version {document.get('version')!r}, this release reads {FORMAT_VERSION}; identify again"
        )
    return document


def _arrays(model: ThermalModel) -> dict[str, Array]:
    arrays = {f"operator.{name}": getattr(model.operator, name) for name in _OPERATOR_ARRAYS}
    if model.free is not None:
        arrays |= {f"free.{name}": getattr(model.free, name) for name in _FREE_ARRAYS}
    return {name: np.ascontiguousarray(value) for name, value in arrays.items()}


def _document(model: ThermalModel, arrays_sha256: str) -> dict[str, Any]:
    op, free, power = model.operator, model.free, model.power
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "code_version": VERSION,
        "arrays_sha256": arrays_sha256,
        "operator": {
            "order": op.order,
            "n_trained": op.n_trained,
            "output_bias": op.output_bias,
            "gamma": op.gamma,
            "sign": op.sign,
            "step_s": op.step_s,
            "feedback": op.feedback,
            "heat_input": dataclasses.asdict(op.heat_input),
            "time_constants_h": op.time_constants_h,
            "steady_gains_K": op.steady_gains_K,
        },
        "free": None if free is None else {"step_s": free.step_s, "sensor_sd_K": free.sensor_sd_K},
        "power": None if power is None else dataclasses.asdict(power),
        "card": dataclasses.asdict(model.card),
    }


def _plain(value: Any) -> Any:
    """`value` in JSON's own types; what is not a finite number becomes null, since JSON has no NaN."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _load(data: Mapping[str, Any]) -> MachineLoad:
    c0, c1, c2, c3 = (float(c) for c in data["coefficients"])
    low, high = (float(T) for T in data["T_out_range_C"])
    return MachineLoad((c0, c1, c2, c3), (low, high), float(data["lowest_level"]), bool(data["levels_seen"]))


def _water(data: Mapping[str, Any] | None) -> ReturnWater | None:
    if data is None:
        return None
    low, high = (float(T) for T in data["range_C"])
    return ReturnWater(float(data["per_K"]), float(data["reference_C"]), (low, high), float(data["above_zone_K"]))


def _model(document: Mapping[str, Any], tensors: Mapping[str, Array]) -> ThermalModel:
    op, free, power, card = (document[key] for key in ("operator", "free", "power", "card"))
    heat = op["heat_input"]["heat"]
    return ThermalModel(
        operator=OperatorParameters(
            **{name: tensors[f"operator.{name}"] for name in _OPERATOR_ARRAYS},
            output_bias=float(op["output_bias"]),
            gamma=float(op["gamma"]),
            sign=int(op["sign"]),
            step_s=float(op["step_s"]),
            feedback=op["feedback"],
            heat_input=HeatInput(
                heat=None if heat is None else _load(heat), reference_C=float(op["heat_input"]["reference_C"])
            ),
        ),
        free=None
        if free is None
        else RcParameters(
            **{name: tensors[f"free.{name}"] for name in _FREE_ARRAYS},
            step_s=float(free["step_s"]),
            sensor_sd_K=float(free["sensor_sd_K"]),
        ),
        power=None
        if power is None
        else PowerModel(
            _load(power["load"]),
            _number(power["rmse_W"]),
            _number(power["r2"]),
            str(power["source"]),
            _water(power["water"]),
        ),
        card=ModelCard(
            source=card["source"],
            data=card["data"],
            ranges={key: (_number(low), _number(high)) for key, (low, high) in card["ranges"].items()},
            scores={key: _number(value) for key, value in card["scores"].items()},
            uncertainty={key: _number(value) for key, value in card["uncertainty"].items()},
            config=card["config"],
            notes=tuple(card["notes"]),
        ),
    )
