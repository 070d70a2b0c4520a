"""What a page of `thermoforce_mpc.report` holds, read back without a browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
from typing import Any

import numpy as np


def data_of(page: str) -> dict[str, Any]:
    """The data that travel in the page."""
    (packed,) = re.findall(r'<script type="text/plain" id="data">(.*?)</script>', page)
    text = gzip.decompress(base64.b64decode(packed))
    return json.loads(text, parse_constant=lambda name: (_ for _ in ()).throw(ValueError(f"{name} is not JSON")))


def body_of(page: str) -> str:
    """What is written in the page, without its data and scripts."""
    return page.split("<main>")[1].split("<script")[0]


def numbers(packed: dict[str, Any]) -> np.ndarray:
    """The numbers of a packed array, NaN where there is none: what `numbers` of assets/base.js gives."""
    if packed["as"] == "changes":
        starts = numbers(packed["starts"])
        changes = np.frombuffer(base64.b64decode(packed["data"]), "<i1").astype(float).reshape(starts.size, -1)
        return np.cumsum(np.column_stack([starts, changes * packed["step"]]), axis=1).ravel()
    raw = base64.b64decode(packed["data"])
    kinds = {"float32": "<f4", "float64": "<f8", "int8": "<i1", "int16": "<i2"}
    found = np.frombuffer(raw, kinds[packed["as"]]).astype(float)
    if packed["as"].startswith("float"):
        return found
    nothing = float(np.iinfo(packed["as"]).min)
    return np.where(found == nothing, np.nan, packed["low"] + (found - nothing - 1) * packed["step"])
