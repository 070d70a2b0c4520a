"""Caching wrapper of a forecaster, since the candidates of a method need the same forecasts."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from functools import lru_cache

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.protocols import FreeResponse

# Cache size: several times the number of windows of a full suite.
_REMEMBERED = 2000


class Remembering:
    """`FreeResponse` that caches the latest forecasts of `inner`, which must be stateless."""

    def __init__(self, inner: FreeResponse) -> None:
        self._inner = inner
        self.name = inner.name
        self._answers: OrderedDict[bytes, FreeForecast] = OrderedDict()

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`."""
        digest = hashlib.blake2b(digest_size=16)
        asked = (free_C, history.time_s, history.T_out_C, history.solar_W_m2)
        for values in (*asked, boundary.time_s, boundary.T_out_C, boundary.solar_W_m2):
            digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
        key = digest.digest()
        if key not in self._answers:
            self._answers[key] = self._inner.forecast(free_C, history, boundary)
            if len(self._answers) > _REMEMBERED:
                self._answers.popitem(last=False)
        return self._answers[key]


@lru_cache(maxsize=2)
def tsfm(backbone: str) -> Remembering:
    """The paper's frozen forecaster: one resolution, loaded once per process, shared by all methods."""
    return Remembering(build_free_response("chronos", backbone=backbone, resolutions="one"))
