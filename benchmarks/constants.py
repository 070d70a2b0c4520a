"""Which constants matter: `python -m benchmarks.constants` changes each by a third and runs three buildings again.

A constant is a number, or a tuple or array of numbers, at the top of a module of the controllers, of identification or
of the model, or a class variable there (an option that nobody turns). Each building is probed once; with every constant
in turn its model is identified from that probing and controls one day, in a process of its own; for a constant of the
controllers, which no model depends on, once for all. What is compared: step responses and their standard deviations,
scores, cost, discomfort and levels. A constant that moves none of them here may still matter for other buildings,
faults or commands; its comment says for which. Values that defaults of dataclasses and functions took when they were
imported, and what CasADi keeps on disk (`controllers.optimisation.statement`), do not follow a change.
"""

from __future__ import annotations

import ast
import csv
import functools
import gc
import importlib
import json
import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

import thermoforce_mpc as tf
from thermoforce_mpc.errors import ThermoForceError

_ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("controllers", "thermoforce_mpc/identification", "thermoforce_mpc/model")
# One room with a meter of power, the embedded heat pump with meters of heat and power, three rooms on one machine.
BUILDINGS = ("generated:4242:1", "bestest_hydronic_heat_pump", "house:3rooms:8811")
# Changes below this share are rounding.
_ROUNDING = 1e-6
# Numbers nearer to 0, such as probabilities of what is not so, are compared as if they were this.
_NEAR_0 = 0.1
_TIMEOUT_S = 600.0
COLUMNS = ("constant", "value", "buildings", "a third more", "day")


@dataclass(frozen=True)
class Constant:
    """A number at the top of a module or of a class, `owner`, and the line where it stands."""

    module: str
    name: str
    line: int
    owner: str = ""

    @property
    def place(self) -> str:
        """`module.name`, or `module.owner.name`."""
        return ".".join(filter(None, (self.module, self.owner, self.name)))

    def value(self) -> Any:
        """What it is now."""
        module = importlib.import_module(self.module)
        return getattr(getattr(module, self.owner) if self.owner else module, self.name)


def constants() -> Iterator[Constant]:
    """The constants of the rooms, in the order of files and lines."""
    for file in sorted(file for room in ROOMS for file in (_ROOT / room).rglob("*.py")):
        module = ".".join(file.relative_to(_ROOT).with_suffix("").parts)
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            for name, line in _assigned(node):
                found = Constant(module, name, line)
                if _numbers(found.value()):
                    yield found
            if isinstance(node, ast.ClassDef):
                for member in node.body:
                    if isinstance(member, ast.AnnAssign) and ast.unparse(member.annotation).startswith("ClassVar"):
                        found = Constant(module, ast.unparse(member.target), member.lineno, node.name)
                        if _numbers(found.value()):
                            yield found


def _assigned(node: ast.stmt) -> Iterator[tuple[str, int]]:
    """Names that a statement assigns to, and its line."""
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    for target in (name for one in targets if one is not None for name in ast.walk(one)):
        if isinstance(target, ast.Name) and not target.id.startswith("__"):
            yield target.id, node.lineno


def _numbers(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return bool(value.dtype.kind == "f")
    if type(value) is tuple:
        return bool(value) and all(map(_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def by_a_third(value: Any) -> Any:
    """`value` a third larger; a share above one half a third further from 1, a whole number by 1 or more."""
    if isinstance(value, np.ndarray):
        return value * (4.0 / 3.0)
    if isinstance(value, tuple):
        return tuple(map(by_a_third, value))
    if isinstance(value, int):
        return value + max(1, round(value / 3.0))
    return 1.0 - (1.0 - value) * 4.0 / 3.0 if 0.5 < value < 1.0 else value * 4.0 / 3.0


def _change(constant: Constant) -> None:
    before = constant.value()
    if constant.owner:
        setattr(getattr(sys.modules[constant.module], constant.owner), constant.name, by_a_third(before))
        return
    for module in [
        module for name, module in sys.modules.items() if name.startswith(("controllers", "thermoforce_mpc"))
    ]:
        if vars(module).get(constant.name) is before:
            setattr(module, constant.name, by_a_third(before))


def _forget() -> None:
    """Drop what the rooms keep of former calls; what reads a network's weights does not depend on their constants."""
    kept_by = type(functools.lru_cache(_kind))
    for kept in [one for one in gc.get_objects() if type(one) is kept_by]:
        if (
            kept.__module__.startswith(tuple(room.replace("/", ".") for room in ROOMS))
            and "backbones" not in kept.__module__
        ):
            kept.cache_clear()


def _kind(name: str) -> str:
    return "effect" if name.startswith("step_response") and not name.endswith("_sd_K") else "model"


def outcome(building: str, probing: Path, model: tf.ThermalModel | None = None) -> dict[str, float]:
    """What identification from a probing finds, unless there is a `model`, and one day of control by it."""
    given: dict[str, Any] = {} if model is not None else {"identification": {"probed": str(probing)}}
    result = tf.run(building, days=1, baselines=[], equal_comfort=False, progress=False, model=model, **given)
    (model,), (kpis,) = result.models.values(), result.kpis.values()
    found = {"cost": kpis["cost_tot"], "discomfort": kpis["tdis_tot"]}
    for index, card in enumerate(model.cards):
        competent = card.competence is not None and card.competence.competent
        numbers = {**card.uncertainty, **card.scores, "competent": float(competent)}
        found |= {f"{_kind(name)} {index} {name}": float(value) for name, value in numbers.items()}
    levels = result.to_dataframe().filter(regex="^u_")
    return found | {f"level {name} {row}": float(v) for name in levels for row, v in enumerate(levels[name])}


def _answer(sender: Connection, constant: Constant | None, building: str, probing: Path) -> None:
    model = None
    if constant is not None:
        if constant.module.startswith("controllers"):
            model = tf.load_model(probing / "model")
        _change(constant)
        _forget()
    try:
        sender.send(outcome(building, probing, model))
    except Exception as error:  # whatever a changed constant breaks is an answer here
        sender.send(f"{type(error).__name__}: {error}")


def _outcome_with(constant: Constant | None, building: str, probing: Path) -> dict[str, float] | str:
    forked = multiprocessing.get_context("fork")
    receiver, sender = forked.Pipe(duplex=False)
    process = forked.Process(target=_answer, args=(sender, constant, building, probing))
    process.start()
    sender.close()
    try:
        return receiver.recv() if receiver.poll(_TIMEOUT_S) else f"no answer in {_TIMEOUT_S:g} s"
    except EOFError:
        return "its process ended"
    finally:
        process.kill()
        process.join()


def moved(before: Mapping[str, float], after: Mapping[str, float] | str) -> dict[str, Any]:
    """Largest change of step responses, of the rest of the card and of levels, of cost (shares) and discomfort."""
    if isinstance(after, str):
        return {"failed": after}

    def largest(prefix: str) -> float:
        names = {name for name in {*before, *after} if name.startswith(prefix)}
        pairs = [(before.get(name, 0.0), after.get(name, 0.0)) for name in names]
        return max((abs(b - a) / max(abs(a), abs(b), _NEAR_0) for a, b in pairs if a != b), default=0.0)

    return {
        "effect": largest("effect"),
        "model": largest("model"),
        "levels": largest("level"),
        "cost": after["cost"] / before["cost"] - 1.0,
        "discomfort_Kh": after["discomfort"] - before["discomfort"],
    }


def _moves(found: Mapping[str, Any]) -> bool:
    return "failed" in found or any(abs(value) > _ROUNDING for value in found.values())


def in_words(found: Mapping[str, Mapping[str, Any]]) -> str:
    """What moved in which building."""
    moving = [(building, moves) for building, moves in found.items() if _moves(moves)]
    if not moving:
        return "moves nothing"

    def text(moves: Mapping[str, Any]) -> str:
        return moves.get("failed") or ", ".join(f"{name} {value:.2g}" for name, value in moves.items())

    return "; ".join(f"{building}: {text(moves)}" for building, moves in moving)


def _probe(building: str, place: Path) -> None:
    call = [sys.executable, "-m", "thermoforce_mpc", "run", "--testcase", building, "--days", "1", "--baselines", ""]
    subprocess.run([*call, "--quiet", "--out", str(place)], check=True, capture_output=True, cwd=_ROOT)


def sensitivity(
    buildings: Sequence[str], only: Sequence[str], at_once: int, progress: Callable[[str], None]
) -> list[dict[str, Any]]:
    """A row for each constant: its place, value, and what a third more moves in each building."""
    chosen = [constant for constant in constants() if any(text in constant.place for text in only)]
    with TemporaryDirectory() as folder, ThreadPoolExecutor(at_once) as threads:
        places = {building: Path(folder) / building.replace(":", "_") for building in buildings}
        for building, place in places.items():
            _probe(building, place)
        # In this process, so that the others have loaded all that they need; its fork must find the same.
        bases = {building: outcome(building, place) for building, place in places.items()}
        for building, place in places.items():
            again = moved(bases[building], _outcome_with(None, building, place))
            if _moves(again):
                raise ThermoForceError(f"{building}: {again} without any change")

        def row(constant: Constant) -> dict[str, Any]:
            found = {
                building: moved(bases[building], _outcome_with(constant, building, place))
                for building, place in places.items()
            }
            progress(f"{constant.place} = {constant.value()}: {in_words(found)}")
            return {"constant": constant.place, "value": str(constant.value()), "line": constant.line} | found

        return list(threads.map(row, chosen))


def keep(rows: Sequence[Mapping[str, Any]], buildings: Sequence[str], file: Path) -> None:
    """Put `rows` of `sensitivity` into a table of all constants that were run, each by its last run."""
    known: dict[str, dict[str, str]] = {}
    if file.exists():
        with file.open(encoding="utf-8", newline="") as lines:
            known = {row["constant"]: row for row in csv.DictReader(lines)}
    day = f"{datetime.now(UTC):%Y-%m-%d}"
    for row in rows:
        moved_there = in_words({building: row[building] for building in buildings})
        found = (row["constant"], row["value"], " ".join(buildings), moved_there, day)
        known[row["constant"]] = dict(zip(COLUMNS, found, strict=True))
    now = {constant.place for constant in constants()}
    with file.open("w", encoding="utf-8", newline="") as lines:
        table = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(known[name] for name in sorted(known) if name in now)


@click.command()
@click.option(
    "--building", "buildings", multiple=True, default=BUILDINGS, metavar="NAME", help="Test case; repeatable."
)
@click.option("--only", default=("",), multiple=True, metavar="TEXT", help="Only constants whose place holds this.")
@click.option("--at-once", type=click.IntRange(min=1), default=1, show_default=True, help="Processes at a time.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write all rows to this JSON file.")
@click.option("--into", type=click.Path(path_type=Path), help="Put all rows into this CSV table, which keeps others.")
def main(
    buildings: tuple[str, ...], only: Sequence[str], at_once: int, json_file: Path | None, into: Path | None
) -> None:
    """Change each constant by a third, one by one, and say what moves; about 10 s a constant on one core."""
    rows = sensitivity(buildings, only, at_once, lambda line: click.echo(line, err=True))
    if json_file is not None:
        json_file.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    if into is not None:
        keep(rows, buildings, into)
    moving = [row for row in rows if any(_moves(row[building]) for building in buildings)]
    click.echo(f"{len(rows)} constants, {len(moving)} move something")


if __name__ == "__main__":
    main()
