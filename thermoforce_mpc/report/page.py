"""Pages of HTML that stand alone, and arrays packed for them."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from thermoforce_mpc.data import Array
from thermoforce_mpc.files import plain_json

_HERE = Path(__file__).resolve().parent
UPLOT = "../vendor/uplot/uPlot.iife.min.js"
"""The library for charts over time, as a script of a page; its style and licence go with it."""


def rendered(template: str, scripts: Sequence[str], data: Mapping[str, Any], **values: Any) -> str:
    """The page of a template (under `templates`), with scripts (under `assets`, in order) that read `data`.

    The browser may run only the page's own scripts, known by their hashes, and load nothing: a name or reason with
    markup in it cannot become a script, whatever becomes of the escaping. `values`: what the template reads.
    """
    library = UPLOT in scripts
    first, *others, last = sources = [_text(f"assets/{name}") for name in ("theme.js", *scripts, "unpack.js")]
    styles = [_text("assets/style.css"), *([_text("vendor/uplot/uPlot.min.css")] if library else [])]
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in sources]
    # What `assets/unpack.js` reads: JSON, deflated, in base64.
    text = json.dumps(plain_json(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    deflated = gzip.compress(text.encode("utf-8", "backslashreplace"), mtime=0)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE / "templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(template).render(
        styles=Markup("\n").join(map(Markup, styles)),
        first_script=Markup(first),
        scripts=[Markup(text) for text in others],
        last_script=Markup(last),
        script_hashes=" ".join(f"'sha256-{one}'" for one in hashes),
        data=base64.b64encode(deflated).decode("ascii"),
        licence=_text("vendor/uplot/LICENSE") if library else "",
        **values,
    )


def _text(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")


Json = dict[str, Any]


def packed(values: Array, coarsest: float, bits: int = 16) -> Json:
    """An array in whole numbers of 8 or 16 `bits` over its range; what is not finite is NaN in the page.

    Where one unit of them would exceed `coarsest` (a sensor that once read nonsense) it goes as floats of 32 bits.
    """
    values = np.asarray(values, dtype=np.float64)
    nothing = -(2 ** (bits - 1))
    finite = np.asarray(np.isfinite(values))
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    step = (high - low) / (-2 * nothing - 2)
    if not step <= coarsest:
        with np.errstate(over="ignore"):
            floats = np.where(finite, values, np.nan).astype("<f4")
        return {"as": "float32", "data": _base64(floats)}
    codes = np.full(values.shape, nothing, dtype=f"<i{bits // 8}")
    codes[finite] = np.rint((values[finite] - low) / (step or 1.0)).astype(np.int64) + nothing + 1
    return {"as": f"int{bits}", "low": low, "step": step, "data": _base64(codes)}


def smooth(courses: Array, finest: float, coarsest: float) -> Json:
    """Courses (P, n) that change little from value to value: starts, and changes in whole numbers of 8 bits.

    Rounded to `finest`, or to more where the largest change needs it; beyond `coarsest`, or where a course has a hole,
    as `packed`. A course may be unknown as a whole.
    """
    courses = np.asarray(courses, dtype=np.float64)
    unknown = np.asarray(np.isnan(courses).all(axis=1))
    known = courses[~unknown]
    largest = float(np.abs(np.diff(known, axis=1)).max(initial=0.0))
    step = max(finest, largest / 126.0)
    if not (np.isfinite(known).all() and step <= coarsest):
        return packed(courses.ravel(), finest)
    codes = np.rint(np.where(unknown[:, None], 0.0, courses) / step).astype(np.int64)
    starts = np.where(unknown, np.nan, codes[:, 0] * step)
    return {
        "as": "changes",
        "step": step,
        "starts": exactly(starts),
        "data": _base64(np.diff(codes, axis=1).astype("<i1")),
    }


def exactly(values: Array) -> Json:
    """An array as it is: times, which must not be rounded."""
    return {"as": "float64", "data": _base64(np.asarray(values, dtype="<f8"))}


def rows_packed(rows: Array, coarsest: float, bits: int = 16) -> list[Json]:
    """Each row of an array (rows, …) by itself, over its own range."""
    return [packed(row, coarsest, bits) for row in rows]


def _base64(array: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
