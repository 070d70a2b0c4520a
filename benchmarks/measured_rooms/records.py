"""The measured records that are known here, by their files; each is read with its map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data.dataframes import seconds_at
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.load import Measurements, read_measurements

BOX, MONS = "armadillo_H2_30min.csv", "mons_house_30min.csv.gz"
_EHBE_2019, _EHBE_2023 = "ehbe/ehbe_2019_15min.csv", "ehbe/ehbe_2023_15min.csv"

_BOX_MAP: dict[str, Any] = {
    "time": {"unit": "s", "since": "2016-01-01"},
    "outdoor": "T_ext",
    "sun": "I_sol",
    "zones": {"box": {"temperature": "T_int"}},
    "actuators": {"heater": {"heat": "P_hea"}},
    "machines": {"electric": {"power": "P_hea"}},
}
# Of the nine rooms, the office: the one on which its heater tells.
_MONS_MAP: dict[str, Any] = {
    "time": {"zone": "Etc/GMT-1"},
    "site": {"latitude": 50.45, "longitude": 3.95},
    "outdoor": "T_out_degC",
    "sun": {"estimate": "humidity", "humidity": "RH_out_pct"},
    "zones": {"office": {"temperature": "T4_degC"}},
    "actuators": {"heater": {}},
    "machines": {"electric": {"power": {"column": "heater_Wh", "unit": "Wh per step"}}},
}


@dataclass(frozen=True)
class MeasuredRecord:
    """A record: `name`, its file below a folder of records, and its map, a file beside or keys and values.

    What was recorded from `until` on is left out.
    """

    name: str
    file: str
    map: str | Mapping[str, Any]
    until: str = ""

    def read(self, folder: Path) -> Measurements:
        """The zones of the record in `folder` that an actuator serves.

        Raises:
            ConfigError: the map is wrong.
            DataError: the file cannot be used.
        """
        rules = folder / self.map if isinstance(self.map, str) else self.map
        measured = read_measurements(folder / self.file, rules).served()
        record = measured.record
        if not self.until:
            return measured
        n = int(np.count_nonzero(record.time_s <= seconds_at(record.origin, self.until, "until"))) - 1
        return replace(measured, record=record.slice(0, n))


KNOWN = (
    MeasuredRecord("all19", _EHBE_2019, "all19.yaml"),
    MeasuredRecord("one19", _EHBE_2019, "one19.yaml"),
    MeasuredRecord("all23e", _EHBE_2023, "all23e.yaml"),
    MeasuredRecord("box", BOX, _BOX_MAP),
    MeasuredRecord("mons", MONS, _MONS_MAP, until="2016-04-01"),
)
"""`all19`: nine rooms under thermostats; `one19`: one of them, its neighbours left out; `all23e`: the nine four years
later, some days under an MPC; `box`: a test box of five days; `mons`: an office and the heater of its house, in winter.
"""


def found_records(folders: Sequence[Path], only: Sequence[str] = ()) -> list[tuple[MeasuredRecord, Path]]:
    """The known records that lie in one of `folders`, each with its folder; with `only` those of these names.

    Raises:
        DataError: none of them is there, or there is none of a name.
    """
    names = [one.name for one in KNOWN]
    if unknown := [name for name in only if name not in names]:
        raise DataError(f"--only {unknown[0]}: there is no such record; there are {', '.join(names)}")
    wanted = [one for one in KNOWN if not only or one.name in only]
    places = [(one, folder) for one in wanted for folder in folders if (folder / one.file).is_file()]
    if not places:
        files = ", ".join(dict.fromkeys(one.file for one in wanted))
        raise DataError(f"--records {' '.join(map(str, folders))}: none of {files} is there")
    for one, folder in places:
        if isinstance(one.map, str) and not (folder / one.map).is_file():
            raise DataError(f"--records {folder}: {one.file} is there, but its map {one.map} is not")
    return list({one.name: (one, folder) for one, folder in reversed(places)}.values())[::-1]
