"""What a bench prints: whole figures under whole headings, however many columns there are."""

from __future__ import annotations

from benchmarks.cli.show import show


def test_a_table_of_many_columns_is_cut_into_tables_that_can_be_read(capsys):
    names = [f"energy_planned_{k}_kWh" for k in range(24)]
    rows = [
        {"house": f"house {h}", "by": "set-points"} | {name: h + 0.125 * k for k, name in enumerate(names)}
        for h in (1, 2)
    ]
    show({"bench": "commands", "rows": rows, "targets": []}, None)
    lines = capsys.readouterr().out.splitlines()
    for name in names:
        assert sum(f" {name} " in line for line in lines) == 1
    tables = sum(line.startswith("bench commands") for line in lines)
    assert 1 < tables < 8
    assert sum("house 2" in line for line in lines) == tables
    assert max(map(len, lines)) <= 160


def test_a_table_that_fits_is_one(capsys):
    show({"bench": "fleet", "rows": [{"plan for": 10, "a second": 84.0}], "targets": []}, None)
    assert capsys.readouterr().out.count("bench fleet") == 1
