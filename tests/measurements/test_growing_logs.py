"""A log that grows is read in parts, of which those that were read before are known by their bytes."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.measurements.tables import appended
from thermoforce_mpc.measurements.tables.earlier import Earlier

OF_READINGS = {
    "time": {"column": "time", "zone": "Europe/Vienna"},
    "table": {"point": "topic", "value": "value"},
    "outdoor": "out",
    "zones": {"room": {"temperature": "T", "lower": 20, "upper": 24}},
    "actuators": {"pump": {"level": "u"}},
    "machines": {"meter": {"power": "P", "price": 0.25}},
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.csv"


def readings(n=400) -> list[str]:
    """As a broker's log has them: a line per reading, and a signal that nobody asked for."""
    at = pd.date_range("2025-01-10 20:00:03", periods=n, freq="5min", tz="UTC")
    values = {"T": "{:.1f}", "out": "{:.1f}", "u": "{:.0f}", "P": "{:.0f} W", "door": "{}"}
    k = np.arange(n)
    of = {
        "T": 21 + k % 5 / 10,
        "out": 2 + k % 7 / 10,
        "u": k % 2,
        "P": 1000 * (k % 2),
        "door": np.array(["on", "off"])[k % 2],
    }
    return [
        f"{t.isoformat()},{name},{form.format(of[name][i])}\n"
        for i, t in enumerate(at)
        for name, form in values.items()
    ]


WRONG = {
    "nothing": "",
    "nul": "\x00" * 40 + "\n",
    "header": "time,topic,value\n",
    "torn": "2025-01-10T23:0",
    "1970": "1970-01-01T00:00:04+00:00,T,20.0\n",
    "no offset": "2025-01-11 00:00:00,T,21.0\n",
    "unit": "2025-01-11T00:00:00+00:00,P,1.2 kW\n",
    "err": "2025-01-11T00:00:00+00:00,T,ERR\n",
    "a cell more": "2025-01-11T00:00:00+00:00,T,21.0,\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("units", [True, False])
def test_a_log_that_grows_is_read_as_if_at_once(path, monkeypatch, wrong, units):
    """What was read before is known by its bytes: also of a file that is cut at its head, or mended in between."""
    rows = [row if units else row.replace(" W\n", "\n") for row in readings()]
    rows[700:700] = [WRONG[wrong]]
    for content in (rows[:1600], rows, rows[500:], rows[:700] + rows[701:]):
        path.write_text("time,topic,value\n" + "".join(content))
        now = pd.Timestamp("2025-01-12 05:20:30", tz="UTC")
        both = []
        for part_bytes in (12_000, 10**9):
            monkeypatch.setattr(appended, "PART_BYTES", part_bytes)
            found = read_measurements(str(path), OF_READINGS, step_s=900.0, at=now.floor("15min"), now=now)
            record = found.record
            both.append((record.T_zone_C, record.T_out_C, record.u, record.power_W, np.array(found.left_out)))
        for in_parts, at_once in zip(*both, strict=True):
            np.testing.assert_array_equal(in_parts, at_once)
        assert np.nanmax(record.power_W) == pytest.approx(663.3, abs=0.1)
        assert bool(found.left_out) == (WRONG[wrong] in content and wrong not in ("nothing", "unit"))


def test_of_a_log_that_grows_only_the_end_is_read(path, monkeypatch):
    monkeypatch.setattr(appended, "PART_BYTES", 4000)
    rows, read, read_csv = [row.replace(" W\n", "\n") for row in readings()], list[int](), pd.read_csv

    def counted(content, **options):
        read[-1] += len(content.getvalue())
        return read_csv(content, **options)

    monkeypatch.setattr(pd, "read_csv", counted)
    now = pd.Timestamp("2025-01-12 05:20:30", tz="UTC")
    for content in (rows[:-20], rows, rows):
        path.write_text("time,topic,value\n" + "".join(content))
        read.append(0)
        read_measurements(str(path), OF_READINGS, step_s=900.0, at=now.floor("15min"), now=now)
    first, again, same = read
    assert first == sum(map(len, rows[:-20]))
    assert 0 < again <= 2 * 4000 + sum(map(len, rows[-20:]))
    assert same == 0


WIDE = {
    "time": {"zone": "UTC"},
    "step": "15min",
    "outdoor": "out",
    "zones": {"room": {"temperature": "T", "lower": 20, "upper": 24}},
    "actuators": {"pump": {"level": "u"}},
    "machines": {"meter": {"power": "P", "price": 0.25}},
}


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize(
    "headers",
    [
        ["time,T,out,u,P", "time,out,T,u,P"],
        ["time,T,out,u,P", "time,T,co2,out,u,P"],
        ["time,T,out,u,P", "P,u,out,T,time", "time,T,out,u,P"],
        ["T,time,out,u,P", "time,out,co2,T,u", "time,out,co2,T,u,P"],
    ],
)
def test_a_header_in_the_middle_of_a_log_says_what_stands_below_it(path, monkeypatch, headers, live):
    """A logger that was started again with another sensor, or with its columns in another order."""
    at = pd.date_range("2025-01-10", periods=600, freq="5min", tz="UTC")
    k = np.arange(at.size)
    table = pd.DataFrame({"time": at.strftime("%Y-%m-%dT%H:%M:%SZ"), "T": 21 + k % 5 / 10, "out": 2 + k % 7 / 10})
    table = table.assign(u=k % 2, P=1000 * (k % 2), co2=400 + k % 90)
    parts = [table.iloc[of][head.split(",")] for of, head in zip(np.array_split(k, len(headers)), headers, strict=True)]
    path.write_text("".join(part.to_csv(index=False) for part in parts))
    monkeypatch.setattr(appended, "PART_BYTES", 3000)
    now = {"now": at[-1] + pd.Timedelta("30s")} if live else {}
    rules = WIDE if headers[0].startswith("time") else WIDE | {"time": {"zone": "UTC", "column": "time"}}
    found = [read_measurements(str(path), rules, **now) for _ in range(2)]
    for one in found:
        record = one.record
        every = 3
        np.testing.assert_allclose(record.T_zone_C[0], table["T"][::every][: record.n_steps + 1])
        np.testing.assert_allclose(record.T_out_C, table["out"][::every][: record.n_steps + 1])
        known = np.isfinite(record.power_W[0])
        assert known.mean() == (1.0 if all("P" in head for head in headers) else pytest.approx(2 / 3, abs=0.02))
        if live:
            (note,) = one.left_out
            line = len(table) // len(headers) * (len(headers) - 1) + len(headers)
            assert note == f"{path}, line {line}: another header: its columns are read by their names"


def log_of(n: int) -> pd.DataFrame:
    at, k = pd.date_range("2025-01-10", periods=n, freq="5min", tz="UTC"), np.arange(n)
    return pd.DataFrame({"T": 21 + k % 5 / 10, "out": 2 + k % 7 / 10, "u": k % 2, "P": 1000 * (k % 2)}, index=at)


def test_a_log_whose_first_column_has_no_name_is_read(path):
    """As pandas writes its index: the search for another header with that name never ended."""
    table = log_of(600)
    table.to_csv(path)
    record = read_measurements(str(path), WIDE, now=table.index[-1] + pd.Timedelta("30s")).record
    np.testing.assert_allclose(record.T_zone_C[0], table["T"][::3])


def test_a_log_that_begins_anew_with_its_last_row_or_with_a_clock_that_is_not_set_costs_nothing(path):
    """What was read before was lost with one row in both files, or stamped 1970 as the first of the new one."""
    table = log_of(600)
    at = table.index
    unset = table[400:401].set_axis(pd.DatetimeIndex(["1970-01-01 00:00:10"], tz="UTC"))
    for looks in ([table[399:]], [unset, pd.concat([unset, table[400:]])]):
        before = Earlier(31.0, ahead={0.0, at[0].timestamp()})
        for rows in (table[:400], *looks):
            rows.to_csv(path, index_label="time")
            now = max(rows.index[-1], at[399]) + pd.Timedelta("30s")
            found = read_measurements(str(path), WIDE, now=now, before=before)
            assert found.record.T_zone_C.shape[1] >= 133
        np.testing.assert_allclose(found.record.T_zone_C[0], table["T"][::3])
        assert before.ahead == {at[0].timestamp()}, "of months ago nothing is kept"


def test_a_log_whose_clock_was_years_ahead_is_read_once_it_is_right(path):
    table, before = log_of(600), Earlier(31.0)
    now = table.index[-1] + pd.Timedelta("30s")
    for years in (4, 0):
        table.set_axis(table.index + pd.Timedelta(days=365 * years)).to_csv(path, index_label="time")
        found = read_measurements(str(path), WIDE, now=now, before=before)
    assert found.newest_s() == (table.index[-1] - found.record.origin).total_seconds()


@pytest.mark.parametrize(
    "content", ["\x00" * 500, "zeit,T_room,T_out,level,power\n2025-01-12T02:00:00Z,21.0,2.0,1,0\n"]
)
def test_a_log_that_has_nothing_any_more_leaves_what_was_read(path, content):
    """Of NUL after a power failure, or with all columns renamed: `control` ended with a ValueError."""
    table, before = log_of(600), Earlier(31.0)
    for _ in range(2):
        now = {"now": table.index[-1] + pd.Timedelta("30s"), "before": before}
        table.to_csv(path, index_label="time")
        read_measurements(str(path), WIDE, **now)
        path.write_text(content)
        found = read_measurements(str(path), WIDE, **now)
        np.testing.assert_allclose(found.record.T_zone_C[0], table["T"][::3])
        assert f"{path}: has none of the columns that were read before: what was read before stands" in found.left_out


def test_a_phase_without_any_reading_stops_nothing_where_a_column_goes_away(path):
    """The sum of columns with instants of their own looked for the last of none."""
    rules = WIDE | {"machines": {"meter": {"power": {"column": ["P", "P3"]}, "price": 0.25}}}
    table, before = log_of(600).assign(P3=np.nan), Earlier(31.0)
    for rows in (table, table.drop(columns="out")):
        rows.to_csv(path, index_label="time")
        found = read_measurements(str(path), rules, now=table.index[-1] + pd.Timedelta("30s"), before=before)
        assert np.isnan(found.record.power_W).all()
