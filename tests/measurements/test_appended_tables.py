"""A table that a machine appends to: what is wrong in it is left out and named. A person's table is refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import thermoforce_mpc as tf
from thermoforce_mpc.data.limits import RULES as RULES_OF_SIGNALS
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.measurements.tables import appended
from thermoforce_mpc.model.screening import ReadingLimits, screened_history

RULES = {
    "time": {"zone": "Europe/Vienna"},
    "outdoor": "out",
    "zones": {"room": {"temperature": "T", "lower": 20, "upper": 24}},
    "actuators": {"pump": {"level": "u"}},
    "machines": {"meter": {"power": "P", "price": 0.25}},
}
NOW = pd.Timestamp("2025-01-12 00:00:30", tz="Europe/Vienna")
HEADER = "time,T,out,u,P\n"


def lines(end="2025-01-12 00:00", n=193) -> list[str]:
    at = pd.date_range(end=end, periods=n, freq="15min")
    return [
        f"{t:%Y-%m-%d %H:%M:%S},{21 + k % 5 / 10:.1f},{2 + k % 7 / 10:.1f},{k % 2},{1000 * (k % 2)}\n"
        for k, t in enumerate(at)
    ]


def live(path, rows, now=NOW, rules=RULES, encoding="utf-8"):
    path.write_text(HEADER + "".join(rows), encoding=encoding)
    return read_measurements(str(path), rules, step_s=900.0, at=now.tz_convert("UTC").floor("15min"), now=now)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.csv"


@pytest.fixture(autouse=True, params=["whole", "in parts"])
def parts(request, monkeypatch):
    """Each case with the file read at once, and in parts of a few lines, as a long one is."""
    if request.param == "in parts":
        monkeypatch.setattr(appended, "PART_BYTES", 400)
    return request.param


@pytest.mark.slow
@pytest.mark.parametrize("behind", ["", "\x00" * 64], ids=["torn", "nul"])
def test_a_last_line_torn_at_any_byte_tells_nothing_that_was_not_measured(path, behind):
    """Of a room in the last column too, of which the first digits are another number."""
    header, row = "time,out,u,P,T\n", "2025-01-12 00:00:00,2.2,1,1000,21.4"
    rows = [line.strip().split(",") for line in lines()]
    whole = header + "".join(",".join([t, out, u, P, T]) + "\n" for t, T, out, u, P in rows[:-1])
    for cut in range(len(row) + 1):
        path.write_text(whole + row[:cut] + behind)
        at = NOW.tz_convert("UTC").floor("15min")
        found = read_measurements(str(path), RULES, step_s=900.0, at=at, now=NOW)
        assert np.nanmin(found.record.T_zone_C) > 20.5, row[:cut]
        assert len(found.left_out) <= 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("last", "believed"), [("200", False), ("2", False), ("1000.5", False), ("1000.0", True), ("1000\n", True)]
)
def test_a_torn_number_that_looks_whole_is_not_believed(path, last, believed):
    """2000 begins as 200; the end of the line, or as many decimals as in all rows before, says that it is whole."""
    rows = [line.rstrip("\n") for line in lines()]
    if last == "1000.0":
        rows = [f"{row}.0" for row in rows]
    power = ",".join(rows[-1].split(",")[:-1])
    found = live(path, ["\n".join([*rows[:-1], f"{power},{last}"])])
    end = "no end of line: its last cell may be cut off"
    assert any(end in note for note in found.left_out) is not believed
    assert np.isfinite(found.record.T_zone_C[0, -1])  # the rest of the line is


@pytest.mark.slow
def test_a_torn_line_with_the_next_one_behind_it_is_no_row(path):
    """Its last cells are empty: as many as there are names, but for one that ends the line."""
    last = "2025-01-12 00:00:00,21.2,2.2,,\n"
    for cut in range(1, len(last)):
        found = live(path, [*lines()[:-1], last[:cut] + last])
        assert np.nanmax(found.record.T_out_C) < 3.0, last[:cut] + last
        assert np.nanmin(found.record.T_zone_C) > 20.0
        assert found.left_out


def test_rows_that_end_with_a_separator_are_rows(path):
    rows = [line.replace("\n", ",\n") for line in lines()]
    assert not live(path, rows).left_out
    assert not live(path, [*rows[:-1], rows[-1].rstrip("\n")]).left_out


def test_a_signal_of_which_every_row_is_left_out_was_not_measured(path):
    """As of a sensor whose decimal comma makes a cell more."""
    cells = {"T": "21,3", "out": "2.5", "u": "1", "P": "1000"}
    rows = [f"{line.partition(',')[0]},{key},{cell}\n" for line in lines(n=20) for key, cell in cells.items()]
    path.write_text("time,point,value\n" + "".join(rows))
    rules = RULES | {"table": {"point": "point", "value": "value"}}
    found = read_measurements(str(path), rules, step_s=900.0, now=NOW)
    assert np.isnan(found.record.T_zone_C).all()
    assert np.isfinite(found.record.u).all()
    assert "4 cells, the header has 3" in found.left_out[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "note"),
    [
        ("2025-01-11 23:5\n", "line 194: 1 cell, the header has 5, '2025-01-11 23:5'"),
        ("2025-01-11 23:50:00,21.2,2.32025-01-11 23:52:00,21.2,2.1,1,1000\n", "line 194: 7 cells, the header has 5"),
        ("\x00" * 512 + "\n", "line 194: NUL bytes"),
        (HEADER, "line 194: the header again"),
        ("2025-01-11 23:50:00,ERR,2.3,1,1000\n", "line 194: column 'T' holds no number, 'ERR'"),
        ("1970-01-01 00:00:12,21.0,2.3,1,1000\n", "line 194: a time far from those of the rows around, '1970-01-01"),
        ("2099-01-01 00:00:00,21.0,2.3,1,1000\n", "line 194: a time far from those of the rows around, '2099-01-01"),
        ("soon,21.0,2.3,1,1000\n", "line 194: no time stamp, 'soon'"),
        (",21.0,2.3,1,1000\n", "line 194: no time stamp"),
        ("2025-01-11 20:07:00,21.0,2.3,1,1000\n", "comes after 2025-01-11 23:45:00+01:00; 1 such rows: sorted"),
        ("2025-01-11 23:45:00,21.2,2.3,1,1000\n", "stands at"),
        ("2025-01-11 23:50:00+01:00,21.0,2.3,1,1000\n", "line 194: its stamp has an offset from UTC, as most have not"),
    ],
    ids=["torn", "joined", "nul", "header", "err", "1970", "2099", "word", "no stamp", "order", "twice", "offset"],
)
def test_what_cannot_be_read_is_left_out_with_line_and_reason(path, wrong, note):
    rows = lines()
    found = live(path, [*rows[:-1], wrong, rows[-1]])
    assert any(note in said for said in found.left_out), found.left_out
    assert found.record.n_steps == 192
    assert np.isfinite(found.record.T_zone_C).all()
    np.testing.assert_allclose(found.record.T_zone_C[0, -1], 21 + 192 % 5 / 10)
    clean = live(path, rows)
    assert not clean.left_out
    changed = np.abs(found.record.T_zone_C - clean.record.T_zone_C) > 0.21
    assert not changed.any()
    if note != "stands at" and "sorted" not in note and "ERR" not in wrong:
        np.testing.assert_array_equal(found.record.u, clean.record.u)
    if wrong == HEADER:
        return
    path.write_text(HEADER + "".join([*rows[:-1], wrong, rows[-1]]), encoding="utf-8")
    with pytest.raises(DataError):
        tf.read_measurements(path, RULES)


def test_a_data_frame_of_a_connection_is_read_in_the_same_way(path):
    path.write_text(HEADER + "".join(lines()), encoding="utf-8")
    table = pd.read_csv(path).astype({"T": object, "time": object})
    table.loc[90, "T"] = "ERR"
    table.loc[95, "time"] = "1970-01-01 00:00:00"
    at = NOW.floor("15min")
    for frame in (table, table.set_index("time")):
        found = read_measurements(frame, RULES, step_s=900.0, at=at, now=NOW)
        assert any("row 91: column 'T' holds no number, 'ERR'" in note for note in found.left_out)
        assert any("row 96: a time far from those" in note for note in found.left_out)
        assert np.isfinite(found.record.T_zone_C).sum() >= 191
    aware = table.drop(index=95)
    aware.index = pd.to_datetime(aware.pop("time")).dt.tz_localize("Europe/Vienna")
    assert len(read_measurements(aware, RULES, step_s=900.0, at=at, now=NOW).left_out) == 1


def test_all_of_it_at_once_and_again_is_one_note_each(path):
    rows = lines()
    bad = ["\x00\x00\n", HEADER, "2025-01-11 23\n", "1970-01-01 00:00:00,1,1,1,1\n"]
    found = live(path, [*rows[:90], *bad, *rows[90:150], *bad, *rows[150:]])
    assert sum("such lines" in note for note in found.left_out) == 4
    assert np.isfinite(found.record.T_zone_C).all()


def test_a_file_of_nothing_that_can_be_read_is_refused(path):
    with pytest.raises(DataError, match="nothing of it can be read"):
        live(path, ["\x00\n", "ERR\n"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "change", "words"),
    [
        ("T", lambda x: x + 273.15, "zones.room.temperature (column T): 193 readings refused (range), first 294.1"),
        ("T", lambda x: x * 1.8 + 32, "in °F they were usual"),
        ("out", lambda x: x + 273.15, "in K they were usual: set unit: 'K'"),
    ],
)
def test_what_is_refused_by_range_is_said_with_the_likelier_unit(path, column, change, words):
    rows = pd.read_csv(pd.io.common.StringIO(HEADER + "".join(lines())))
    rows[column] = change(rows[column]).round(2)
    found = live(path, rows.to_csv(index=False, header=False, lineterminator="\n").splitlines(keepends=True))
    assert any(words in note for note in found.left_out), found.left_out
    other = found.record.T_out_C if column == "T" else found.record.T_zone_C[0]
    assert np.isfinite(other).all()


@pytest.mark.parametrize(
    ("end", "now", "newest"),
    [
        ("2025-10-26 02:30", "2025-10-26 00:31Z", "2025-10-26 02:30:00+02:00"),
        ("2025-10-26 02:45", "2025-10-26 00:46Z", "2025-10-26 02:45:00+02:00"),
    ],
)
def test_the_hour_that_comes_twice_is_told_by_the_clock_while_it_happens_first(path, end, now, newest):
    now = pd.Timestamp(now).tz_convert("Europe/Vienna")
    found = live(path, lines(end), now)
    assert str(found.record.stamps()[-1]) == newest
    assert np.isfinite(found.record.T_zone_C[0, -1])
    assert any("told apart by the clock" in note for note in found.left_out)
    with pytest.raises(DataError, match="comes twice"):
        tf.read_measurements(path, RULES)


def test_its_second_pass_is_told_by_the_order_and_a_late_row_does_not_matter(path):
    first = lines("2025-10-26 02:45")
    again = lines("2025-10-26 02:30", n=3)
    now = pd.Timestamp("2025-10-26 01:31Z").tz_convert("Europe/Vienna")
    found = live(path, [*first, *again], now)
    assert str(found.record.stamps()[-1]) == "2025-10-26 02:30:00+01:00"
    assert np.isfinite(found.record.T_zone_C[0, -7:]).all()
    first[-2], first[-1] = first[-1], first[-2]  # a row out of order in the first pass
    shuffled = live(path, [*first, *again], now)
    np.testing.assert_array_equal(shuffled.record.T_zone_C[0, -3:], found.record.T_zone_C[0, -3:])


@pytest.mark.parametrize("jump", ["3h", "30h", "400D"])
@pytest.mark.parametrize("zone_is_wrong", [False, True])
def test_what_a_clock_stamped_before_it_was_set_back_blocks_no_later_reading(path, jump, zone_is_wrong):
    """An hour of rows of a record of topics in the order in which they came, the last of it said but once; rows whose
    zone is wrong are ahead to the end, and stay: what reads them says so.
    """
    rules = RULES | {"table": {"point": "topic", "value": "value"}}
    rows, now = [], NOW.tz_convert("UTC").floor("15min")
    for k, line in enumerate(lines(end=f"{now:%Y-%m-%d %H:%M}")):
        at, *cells = line.strip().split(",")
        wrong = pd.Timedelta(jump) * int(k >= 184 if zone_is_wrong else 184 <= k < 188)
        at = f"{pd.Timestamp(at, tz='UTC') + wrong:%Y-%m-%dT%H:%M:%S+00:00}"
        rows += [f"{at},{name},{cell}\n" for name, cell in zip(("T", "out", "u", "P"), cells, strict=True)]
        rows += [f"{at},once,1\n"] if k == 187 else []
    path.write_text("time,topic,value\n" + "".join(rows))
    measured = read_measurements(str(path), rules, step_s=900.0, now=NOW)
    ahead = pd.Timestamp(measured.understood.ends) > NOW
    assert ahead == zone_is_wrong
    assert any("stamped after the clock, which was set back since" in note for note in measured.left_out) != ahead
    if not zone_is_wrong:
        assert measured.record.T_zone_C[0, -2:].tolist() == pytest.approx([21.0, 21.1], abs=0.11)


def test_offsets_in_whole_hours_are_read_over_the_change_of_summer_time(tmp_path):
    at = pd.date_range("2025-03-29 12:00", "2025-03-31", freq="15min", tz="Europe/Vienna")
    table = pd.DataFrame({"T": 21.0, "out": np.arange(at.size) % 9, "u": 0.5, "P": 500.0})
    found = {}
    for name, form in (("whole", "%Y-%m-%d %H:%M:%S"), ("space", "%Y-%m-%d %H:%M:%S.250 "), ("colon", "")):
        stamps = [t.isoformat(sep=" ") if not form else f"{t.strftime(form)}{t:%z}"[:-2] for t in at]
        table.assign(time=stamps).to_csv(tmp_path / f"{name}.csv", index=False)
        rules = {**RULES, "time": {"column": "time", "zone": "Europe/Vienna"}}
        found[name] = tf.read_measurements(tmp_path / f"{name}.csv", rules).record
    np.testing.assert_array_equal(found["whole"].T_out_C, found["colon"].T_out_C)
    assert found["space"].n_steps == found["colon"].n_steps
    table.assign(time=[f"{t:%Y-%m-%d %H:%M:%S%z}"[:-2] for t in at]).to_csv(tmp_path / "log.csv", index=False)
    now = at[-1] + pd.Timedelta("20s")
    record = read_measurements(str(tmp_path / "log.csv"), rules, step_s=900.0, at=at[-1], now=now).record
    np.testing.assert_array_equal(record.T_out_C, found["colon"].T_out_C)


@pytest.mark.parametrize(
    ("begin", "zone", "step", "at", "first", "last"),
    [
        ("2025-01-01 00:30", "Asia/Kolkata", "1h", "begin", "2025-01-01 00:30:00+05:30", "2025-01-02 00:30:00+05:30"),
        ("2025-01-01 00:07", "Europe/Vienna", "1h", "begin", "2025-01-01 00:07:00+01:00", "2025-01-02 00:07:00+01:00"),
        ("2025-01-01 00:00:03", "UTC", "1h", "begin", "2025-01-01 00:00:00+00:00", "2025-01-02 00:00:00+00:00"),
        ("2025-01-01 00:07", "UTC", "15min", "begin", "2025-01-01 01:00:00+00:00", "2025-01-01 06:00:00+00:00"),
        ("2025-01-01 00:00", "UTC", "15min", "end", "2025-01-01 00:00:00+00:00", "2025-01-01 06:00:00+00:00"),
        ("2025-01-01 00:00", "UTC", "10min", "end", "2025-01-01 00:00:00+00:00", "2025-01-01 04:00:00+00:00"),
        ("2025-01-01 00:45", "UTC", "15min", "end", "2025-01-01 00:45:00+00:00", "2025-01-01 06:45:00+00:00"),
    ],
)
def test_steps_begin_where_readings_are(begin, zone, step, at, first, last):
    index = pd.date_range(begin, periods=25, freq=step, tz=zone)
    table = pd.DataFrame({"T": np.arange(25.0) / 10 + 20, "out": 5.0, "u": 0.5, "P": 500.0}, index=index)
    record = read_measurements(table, {**RULES, "time": {"zone": zone}}, step_s=3600.0, at=at).record
    assert [str(record.stamps()[k]) for k in (0, -1)] == [first, last]
    assert np.isfinite(record.T_zone_C).all()
    if at == "end":
        assert record.T_zone_C[0, -1] == pytest.approx(22.4)


@pytest.mark.parametrize(("name", "column"), [("T_zone_C", "T"), ("T_out_C", "out")])
def test_tables_and_a_running_loop_refuse_by_the_same_rule(path, name, column):
    low, high = RULES_OF_SIGNALS[name].range
    for value in (low - 0.01, low + 0.01, high - 0.01, high + 0.01):
        rows = pd.read_csv(pd.io.common.StringIO(HEADER + "".join(lines())))
        rows.loc[100, column] = value
        wide = {"column": column, "range": (-1e4, 1e4), "spike": 1e4}
        open_rules = (
            {**RULES, "outdoor": wide} if column == "out" else {**RULES, "zones": {"room": {"temperature": wide}}}
        )
        table = rows.set_index(pd.to_datetime(rows.pop("time"))).rename_axis("time")
        as_read = tf.read_measurements(table, open_rules).record
        measured, _ = screened_history(as_read, ReadingLimits())
        refused = np.isnan(np.atleast_2d(getattr(measured, name))[0, 100])
        found = tf.read_measurements(table, RULES).understood.signals
        flags = [flag.rule for signal in found if signal.source == column for flag in signal.flags]
        assert ("range" in flags) == (value < low or value > high)
        assert refused or "range" not in flags, "what a table refuses, a loop does not believe"
