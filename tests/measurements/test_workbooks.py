"""Workbooks are read as tables; the stamp of midnight, which calamine gives as a date, is one like the others."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import pytest

import thermoforce_mpc as tf

pytest.importorskip("python_calamine")

_MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
_RELATED = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_STAMP = 1  # style of the cells of time, "yyyy-mm-dd hh:mm"


def write_workbook(path: Path, header: list[str], rows: list[list[float]]) -> None:
    """A workbook of one sheet; the first column holds days since 1900 as spreadsheets count them."""
    cells = ["".join(f'<c t="inlineStr"><is><t>{escape(name)}</t></is></c>' for name in header)]
    for first, *others in rows:
        cells.append(f'<c s="{_STAMP}"><v>{first!r}</v></c>' + "".join(f"<c><v>{value!r}</v></c>" for value in others))
    files = {
        "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="xml" ContentType="application/xml"/></Types>',
        "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
        f'<Relationship Id="r" Type="{_RELATED}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook {_MAIN} xmlns:r="{_RELATED}"><sheets><sheet name="Trend" sheetId="1" r:id="s"/>'
        "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
        f'relationships"><Relationship Id="s" Type="{_RELATED}/worksheet" Target="worksheets/sheet1.xml"/>'
        f'<Relationship Id="y" Type="{_RELATED}/styles" Target="styles.xml"/></Relationships>',
        "xl/styles.xml": f'<styleSheet {_MAIN}><numFmts count="1"><numFmt numFmtId="164" '
        'formatCode="yyyy\\-mm\\-dd\\ hh:mm"/></numFmts><cellXfs count="2"><xf numFmtId="0"/>'
        '<xf numFmtId="164" applyNumberFormat="1"/></cellXfs></styleSheet>',
        "xl/worksheets/sheet1.xml": f"<worksheet {_MAIN}><sheetData>"
        + "".join(f"<row>{row}</row>" for row in cells)
        + "</sheetData></worksheet>",
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def test_a_workbook_of_a_logger_is_a_record(tmp_path):
    midnight = 45600.0  # 4 November 2024, 0:00
    rows = [[midnight + i / 96, 20.0 + i / 96, 5.0, 50.0] for i in range(96 * 2)]
    write_workbook(tmp_path / "house.xlsx", ["Zeit", "Wohnzimmer °C", "Außen °C", "Ventil %"], rows)
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
