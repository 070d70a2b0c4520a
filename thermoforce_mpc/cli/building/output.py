"""Files that commands on a building write: a table, and a picture over time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from rich.console import Console

from thermoforce_mpc.files import written

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_table(path: Path, table: pd.DataFrame, console: Console, what: str, **beside: Any) -> None:
    """Write a table of times to a .csv or .json file, in JSON as `rows` with `beside`; raises `StorageError`."""
    table = table.round(4)
    if path.suffix == ".csv":
        text = table.to_csv(lineterminator="\n")
    else:
        plain = table.astype(object).where(table.notna(), None)
        plain.index = [at.isoformat() if hasattr(at, "isoformat") else float(at) for at in table.index]
        rows = plain.reset_index(names="time").to_dict("records")
        text = json.dumps({**beside, "rows": rows}, indent=1, ensure_ascii=False)
    _write(path, lambda aside: aside.write_text(text, encoding="utf-8"), console, what)


def write_json_file(path: Path, content: Any, console: Console, what: str) -> None:
    """Write a result as JSON; raises `StorageError`."""
    text = json.dumps(content, indent=1, ensure_ascii=False)
    _write(path, lambda aside: aside.write_text(text, encoding="utf-8"), console, what)


def write_picture(path: Path, figure: Figure, console: Console) -> None:
    """Write a picture, the same bytes each time; raises `StorageError`."""
    metadata = {"Software": None} if path.suffix == ".png" else {"Date": None}
    _write(path, lambda aside: figure.savefig(aside, dpi=120, metadata=metadata), console, "Picture")


def _write(path: Path, write: Callable[[Path], object], console: Console, what: str) -> None:
    with written(path) as aside:
        write(aside)
    console.print(f"{what}: {path}", soft_wrap=True, markup=False)


def on_clock(index: pd.Index[Any]) -> np.ndarray[Any, Any]:
    """Times for the axis of a picture: those of the clock there, without their zone."""
    return (index.tz_localize(None) if isinstance(index, pd.DatetimeIndex) else index).to_numpy()


def finish_axes(figure: Figure) -> None:
    """A grid and a legend in the upper axes, and times below that do not run into one another."""
    upper, *_ = axes = figure.axes
    upper.grid(alpha=0.3)
    upper.legend(frameon=False, fontsize="small")
    axes[-1].tick_params(axis="x", rotation=20)
