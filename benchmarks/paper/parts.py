"""What `tf-mpc paper` runs: the bench behind each group of the paper's tables, and what differs from the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.factual.bench import run_factual_bench
from benchmarks.factual.readers import read_homes
from benchmarks.interventions.bench import run_interventions_bench
from benchmarks.interventions.studies import run_study
from benchmarks.paper import tables
from benchmarks.paper.closed_loop import run_closed_loop_tables
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import Engine

Result = dict[str, Any]


@dataclass(frozen=True)
class Setting:
    """`records`: folders with measured homes. `weather`: file of the closed loop, None: synthetic. `quick`: a smaller
    version of everything. `seeds`: how many of the closed loop. `engine`: where tasks run; `say`: progress lines.
    """

    out: Path
    records: tuple[Path, ...]
    weather: Path | None
    quick: bool
    engine: Engine
    say: Callable[[str], None]
    seeds: int = 1

    @property
    def pairs(self) -> Path:
        """Folder of simulated pairs, which several parts use."""
        return self.out / "interventions-data"


class Table(NamedTuple):
    """A table of the paper: its `label`, and figures drawn beside it, as files below the part's folder."""

    label: str
    title: str
    rows: Callable[[tables.Result], tables.Rows]
    figures: tuple[str, ...] = ()


class Part(NamedTuple):
    """One bench: `differs` says what is not as in the paper."""

    run: Callable[[Setting, Path], Result]
    tables: tuple[Table, ...]
    differs: str


def _interventions(setting: Setting, out: Path) -> Result:
    quick, engine = setting.quick, setting.engine
    return run_interventions_bench(setting.pairs, out=out, days=(3,), quick=quick, engine=engine, progress=setting.say)


def _homes(setting: Setting, out: Path) -> Result:
    if not setting.records:
        raise InputError(
            "--records: no folder of measured homes was given, and the repository holds none: give the cleaned REFIT "
            "release (https://doi.org/10.15129/9ab14b0e-19ac-4279-938f-27f643078cec; CLEAN_House1.csv …), or your own "
            "as docs/evidence/measured.md says"
        )
    homes = [home for folder in setting.records for home in read_homes(folder, say=setting.say)]
    return run_factual_bench(homes, out, quick=setting.quick, engine=setting.engine, progress=setting.say)


def _closed_loop(setting: Setting, out: Path) -> Result:
    return run_closed_loop_tables(
        out, weather=setting.weather, quick=setting.quick, seeds=setting.seeds, progress=setting.say
    )


def _study(name: str, gains: tuple[str, ...] = ()) -> Callable[[Setting, Path], Result]:
    def run(setting: Setting, out: Path) -> Result:
        quick, engine = setting.quick, setting.engine
        return run_study(name, setting.pairs, out=out, quick=quick, engine=engine, gains=gains, progress=setting.say)

    return run


PARTS = {
    "interventions": Part(
        _interventions,
        (Table("tab:interv", "Interventional validity", tables.interventions, ("scatter.png", "fan.png")),),
        "two houses of our own in EnergyPlus, one seed; the paper does not say which zones it simulated; methods "
        "without a figure of the paper are not in it",
    ),
    "homes": Part(
        _homes,
        (
            Table("tab:refit", "Few-shot forecasts of homes", tables.factual, ("few_shot.png", "decomposition.png")),
            Table("tab:cov", "Forecasters that are given covariates", tables.covariates),
            Table("tab:backbone", "Scales of the frozen forecaster", tables.backbones),
        ),
        "the homes of --records (the paper: 19 of REFIT, 8 for the scales); our own weights of Chronos-Bolt's form, "
        "trained on synthetic series, since Chronos' cannot be downloaded here",
    ),
    "closed-loop": Part(
        _closed_loop,
        (Table("tab:closedloop", "Closed loop over two weeks", tables.closed_loop, ("pareto.png",)),),
        "our emulator of the test case; a horizon of 24 h, which the paper does not print; for the real test case "
        "tf-mpc run --config paper_closed_loop --url URL",
    ),
    "ablation": Part(
        _study("ablation", gains=("linear", "neural")),
        (Table("tab:ablation", "Linear and neural gain", tables.ablation, ("ablation.png",)),),
        "houses as for tab:interv; the network is always kept, what auto would do is in ablation.json",
    ),
    "gamma": Part(
        _study("gamma"),
        (Table("fig:gamma", "Coefficient of the modulation", tables.gamma, ("gamma.png",)),),
        "houses as for tab:interv; the paper prints no figures of this curve",
    ),
    "efficiency": Part(
        _study("efficiency"),
        (Table("tab:efficiency", "Computational cost", tables.efficiency, ("efficiency.png",)),),
        "wall times of this machine; the network is always kept",
    ),
}
# Tables and figures of the paper that hold nothing measured.
NOT_MEASURED = {
    "tab:positioning, tab:thermostill": "a comparison of publications in words; nothing to measure",
    "tab:datasets": "the sources; ours stand under 'What differs'",
    "fig:framework": "a drawing; docs/how-it-works has ours",
}
