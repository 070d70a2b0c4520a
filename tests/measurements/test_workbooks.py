"""Workbooks are read as tables; the stamp of midnight, which calamine gives as a date, is one like the others."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TypeAlias
from xml.sax.saxutils import escape

import pytest

import thermoforce_mpc as tf
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.starting_map import starting_map

pytest.importorskip("python_calamine")

_MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
_RELATED = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_STAMP = 1  # style of the cells of time, "yyyy-mm-dd hh:mm"


Sheet: TypeAlias = tuple[list[str], list[list[float]]]


def write_workbook(path: Path, **sheets: Sheet) -> None:
    """A workbook of sheets by name: names of columns and rows, first days since 1900 as spreadsheets count them."""
    numbered = list(enumerate(sheets, 1))
    files = {
        "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="xml" ContentType="application/xml"/></Types>',
        "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        f'<Relationship Id="r" Type="{_RELATED}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook {_MAIN} xmlns:r="{_RELATED}"><sheets>'
        + "".join(f'<sheet name="{name}" sheetId="{k}" r:id="s{k}"/>' for k, name in numbered)
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
        'relationships">'
        + "".join(
            f'<Relationship Id="s{k}" Type="{_RELATED}/worksheet" Target="worksheets/sheet{k}.xml"/>'
            for k, _ in numbered
        )
        + f'<Relationship Id="y" Type="{_RELATED}/styles" Target="styles.xml"/></Relationships>',
        "xl/styles.xml": f'<styleSheet {_MAIN}><numFmts count="1"><numFmt numFmtId="164" '
        'formatCode="yyyy\\-mm\\-dd\\ hh:mm"/></numFmts><cellXfs count="2"><xf numFmtId="0"/>'
        '<xf numFmtId="164" applyNumberFormat="1"/></cellXfs></styleSheet>',
    }
    for k, name in numbered:
        header, rows = sheets[name]
        cells = ["".join(f'<c t="inlineStr"><is><t>{escape(column)}</t></is></c>' for column in header)]
        for first, *others in rows:
            numbers = "".join(f"<c><v>{value!r}</v></c>" for value in others)
            cells.append(f'<c s="{_STAMP}"><v>{first!r}</v></c>{numbers}')
        files[f"xl/worksheets/sheet{k}.xml"] = (
            f"<worksheet {_MAIN}><sheetData>"
            + "".join(f"<row>{row}</row>" for row in cells)
            + "</sheetData></worksheet>"
        )
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


MIDNIGHT = 45600.0  # 4 November 2024, 0:00
COLUMNS = ["Zeit", "Wohnzimmer °C", "Außen °C", "Ventil %"]


def test_a_workbook_of_a_logger_is_a_record(tmp_path):
    rows = [[MIDNIGHT + i / 96, 20.0 + i / 96, 5.0, 50.0] for i in range(96 * 2)]
    write_workbook(tmp_path / "house.xlsx", Trend=(COLUMNS, rows))
    rules = {
        "time": {"column": "Zeit", "zone": "Europe/Berlin"},
        "outdoor": {"column": "Außen °C"},
        "zones": {"living": {"temperature": {"column": "Wohnzimmer °C"}}},
        "actuators": {"valve": {"level": {"column": "Ventil %", "unit": "%"}}},
    }
    record = tf.read_measurements(tmp_path / "house.xlsx", rules).record
    assert record.n_steps in (191, 192)
    assert record.T_zone_C[0, 0] == pytest.approx(20.0)
    assert record.T_zone_C[0, 96] == pytest.approx(21.0), "midnight of the second day"
    assert record.u[0, 10] == pytest.approx(0.5)


def test_the_sheet_of_readings_is_found_behind_a_summary_and_others_are_named(tmp_path):
    def days(n: int, first: float = MIDNIGHT) -> Sheet:
        return COLUMNS, [[first + i / 96, 20.0 + i % 7 / 10, 5.0 + i % 9 / 10, 50.0 * (i % 3)] for i in range(96 * n)]

    book = tmp_path / "house.xlsx"
    write_workbook(book, Summary=(["Rapport"], []), November=days(2), December=days(1, MIDNIGHT + 26.0))
    text = starting_map(book)
    assert "sheet: November" in text
    assert "# CHECK: sheet 'November' is read; save these as files of their own: December" in text
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    assert tf.read_measurements(book, tmp_path / "map.yaml").record.n_steps in (191, 192)
    (tmp_path / "map.yaml").write_text(text.replace("sheet: November", "sheet: Novembre"), encoding="utf-8")
    with pytest.raises(DataError, match=r"no sheet 'Novembre', did you mean 'November'\?; there are Summary"):
        tf.read_measurements(book, tmp_path / "map.yaml")
    write_workbook(book, Trend=days(2))
    assert "sheet" not in starting_map(book), "the first is read without a word"
