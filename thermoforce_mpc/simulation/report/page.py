"""Pages of HTML that stand alone: data, style and scripts in one file that reaches for nothing outside it."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from thermoforce_mpc.simulation.folder.run_folder import plain_json

_HERE = Path(__file__).resolve().parent
UPLOT = "../vendor/uplot/uPlot.iife.min.js"
"""The library for charts over time, as a script of a page; its style and licence go with it."""


def rendered(template: str, scripts: Sequence[str], data: Mapping[str, Any], **values: Any) -> str:
    """The page of a template.

    The browser may run only the page's own scripts, known by their hashes, and load nothing: a name or reason with
    markup in it cannot become a script, whatever becomes of the escaping.

    Args:
        template: file under `templates`; it extends `page.html.j2`.
        scripts: files under `assets`, in the order in which they are run once the data are unpacked; `UPLOT` where it
            is used.
        data: what the scripts read; numbers that are not finite become null.
        values: what the template reads.
    """
    library = UPLOT in scripts
    first, *others, last = sources = [_text(f"assets/{name}") for name in ("theme.js", *scripts, "unpack.js")]
    styles = [_text("assets/style.css"), *([_text("vendor/uplot/uPlot.min.css")] if library else [])]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE / "templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(template).render(
        styles=Markup("\n").join(map(Markup, styles)),
        first_script=Markup(first),
        scripts=[Markup(text) for text in others],
        last_script=Markup(last),
        script_hashes=" ".join(f"'sha256-{_sha256(text)}'" for text in sources),
        data=_packed(data),
        licence=_text("vendor/uplot/LICENSE") if library else "",
        **values,
    )


def _packed(data: Mapping[str, Any]) -> str:
    """JSON, deflated, in base64: what `assets/unpack.js` reads."""
    text = json.dumps(plain_json(data), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode("utf-8", "backslashreplace"), mtime=0)).decode("ascii")


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def _text(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")
