"""Run the cases of `../shared/cases` against what their files say: `python tests/cases/shared_cases.py [NAME ...]`.

A case is a line of `CASES`: its name; patterns that the output holds, in this order; patterns that it does not hold;
and its run.sh or words of commands, in which `$C` is its folder. Exits with 1 where one fails; skips what is absent.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT.parent / "shared" / "cases"
# No place in our source reaches a user.
_TRACES = r"Traceback|\.py:\d+: \w*Warning"
_NIAGARA = "$C/North_SpaceTemp.csv $C/North_ValvePos.csv $C/OutdoorTemp.csv"
_ROOMS = "$C/room_living.csv $C/room_bath.csv"


@dataclass(frozen=True)
class Case:
    """A case: `says` and `never` are patterns of its output, `run` what is run."""

    name: str
    says: tuple[str, ...]
    never: tuple[str, ...] = (_TRACES,)
    run: tuple[str, ...] = ("run.sh",)


CASES = (
    Case("long_table", ("one row per reading",), ("looks like a temperature", _TRACES)),
    Case(
        "ha_long",
        (r"\(3\.0 days", "living.temp", "outdoor: {column: sensor.outdoor_temp", "column: sensor.living_temp"),
        run=("data map $C/history.csv > map.yaml", "data check $C/history.csv --map map.yaml --no-fit", "cat map.yaml"),
    ),
    Case(
        "niagara",
        (
            "Europe/Berlin",
            "column: OutdoorTemp",
            "column: North_SpaceTemp",
            "column: North_ValvePos",
            "3 signals|every",
        ),
        run=(f"data map {_NIAGARA} > map.yaml", "cat map.yaml", f"data check {_NIAGARA} --map map.yaml --no-fit"),
    ),
    Case(
        "rooms_same_columns",
        (
            "different rooms or points",
            "different rooms or points",
            "by_file: prefix",
            "room_living temp",
            "room_bath temp",
        ),
        ("duplicates: first or last", _TRACES),
        (
            f"data check {_ROOMS} --map $C/rooms2.yaml --no-fit",
            f"data check {_ROOMS} --map $C/rooms4.yaml --no-fit",
            f"data map {_ROOMS}",
        ),
    ),
    Case("date_and_time_columns", (r"stamps of a day are all the same.*time\.column: \[Date, Time\]",)),
    Case("price_files", ("plain.csv\n.*valid scenario", "comments.csv\n.*valid scen", "semicolon.csv\n.*valid scen")),
    Case(
        "out_in_south",
        ("outdoor: {column: 'OA-T", "'North ZN-T", "'South ZN-T", "level: {column: 'North VLV-O"),
        run=("data map $C/bms.csv",),
    ),
    Case(
        "onoff_room",
        ("column: living_temperature", "level: {column: living_valve_position", "not used: bedroom_window"),
        run=("data map $C/wide.csv",),
    ),
    Case(
        "setpoint_as_percent",
        ("look like set-points.*a set-point is no level", "look like set-points"),
        ("set unit: '%'", _TRACES),
        ("data check $C/setp.csv --map $C/ok.yaml --no-fit", "data check $C/setp.csv --map $C/setp.yaml --no-fit"),
    ),
    Case(
        "onchange_tail",
        (r"valve\.level.*100\.0 % +none",),
        run=("data check $C/house.csv --map $C/map.yaml --no-fit",),
    ),
    Case(
        "on_change",
        ("stored only when they change", "pump: competent", "with hold_h", "pump: competent"),
        ("days of data", _TRACES),
    ),
    Case("offsets_of_hours", ("rc 0",)),
    Case(
        "epw_missing",
        (
            r"cover99_all\.epw: opaque cover is missing \(99\) in 8760 hours",
            r"wind999\.epw: wind speed is missing \(999\)",
            "dew point is missing",
            "wind direction is missing",
            "pressure is missing",
        ),
        ("Error", _TRACES),
    ),
    Case(
        "mos_bounds",
        (
            "from_0.mos\n.*valid",
            "from_3600.mos\n.*valid",
            "two_rows_more.mos: 2 rows beyond the year.*not used\n.*valid",
        ),
        ("Error", "29 February", _TRACES),
    ),
    Case("locator_warning", ("Picture: data_check.png",), run=("data check $C/ok.csv --map $C/ok.yaml --no-fit",)),
    Case("reversible", ("COMPETENT", "Plan from", "Plan from"), (r"leave \(0, 1\)", "belong together", _TRACES)),
    Case("min_run", (r"10 min\)\n", r"7200\n.*\n\[(?=.*0\.0, 0\.0)(?=.*1\.0, 1\.0)(0\.0|1\.0|, )+\]")),
    Case(
        "price_tail",
        ("== complete", "UTC  pump", "exit code 0", "UTC  pump", "exit code 0", "UTC  pump", "exit code 0"),
    ),
    Case("plan_late_readings", (r"Plan from 2025-02-09 23:45", r"09 Feb 23:45 .*100 %")),
    Case(
        "plan_step",
        (
            "Plan from 2025-02-10 00:00",
            "--step 7min: a plan of",
            "--step 30: has no unit",
            "--step 1h30min: is no step",
        ),
        ("end at 23:40", "3e-08", _TRACES),
    ),
    Case("future_stamps", ("true_clock", "exit code 0", "exit code 2", r"after the clock.*time\.zone")),
    Case(
        "gate_levels_in_plan",
        (
            "south_valve: gate: This model may not act",
            "own control",
            r"own control, set nothing: bounds of south(, meeting)? and",
            '"u\\[south_valve\\]": null',
        ),
        (r'"u\[south_valve\]": \d', _TRACES),
        (
            "identify --data $C/metasys.csv.gz --map $C/map.yaml --out office",
            "plan --model office --data $C/office_recent.csv.gz --map $C/map.yaml --forecast $C/forecast.csv "
            "--hours 24 --out plan.json",
            "cat plan.json",
        ),
    ),
    Case(
        "embed_own_plant",
        ("A record ends with a row of now.*append one",),
        ("Warning",),
        ("python $C/embed_own_plant.py",),
    ),
)


def failure(case: Case) -> str:
    """What is wrong with the output of a case, with the output; '' where nothing is."""
    with tempfile.TemporaryDirectory() as name:
        where = Path(name)
        programs = where / "bin"
        programs.mkdir()
        for program, module in (("tf-mpc", "-m thermoforce_mpc"), ("python", "")):
            (programs / program).write_text(f'#!/bin/bash\nexec "{sys.executable}" {module} "$@"\n')
            (programs / program).chmod(0o755)
        environment = {**os.environ, "TF": str(programs / "tf-mpc"), "PATH": f"{programs}:{os.environ['PATH']}"}
        environment |= {"COLUMNS": "160", "PYTHONPATH": str(ROOT)}
        said = "".join(_ran(one, FOLDER / case.name, where, environment) for one in case.run)
    at = 0
    for pattern in case.says:
        found = re.search(pattern, said[at:])
        if not found:
            return f"{pattern!r} is not said, or too early:\n{said}"
        at += found.start() + 1
    return next((f"{pattern!r} is said:\n{said}" for pattern in case.never if re.search(pattern, said)), "")


def _ran(words: str, folder: Path, where: Path, environment: dict[str, str]) -> str:
    if words == "run.sh":
        command = f"bash {shlex.quote(str(folder / words))}"
    else:
        first = "" if words.split()[0] in ("cat", "python") else "tf-mpc "
        command = first + words.replace("$C", shlex.quote(str(folder)))
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=where,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=900,
        check=False,
    )
    return done.stdout + done.stderr


def main(names: list[str]) -> int:
    """Run the cases of `names`, or all; 1 where one fails."""
    failed = 0
    for case in CASES:
        if names and case.name not in names:
            continue
        if not (FOLDER / case.name).is_dir():
            print(f"skipped  {case.name}: {FOLDER / case.name} is absent")
            continue
        wrong = failure(case)
        failed += bool(wrong)
        print(f"{'FAILED ' if wrong else 'as said'}  {case.name}{': ' + wrong if wrong else ''}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
