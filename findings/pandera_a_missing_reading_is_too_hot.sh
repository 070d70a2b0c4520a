#!/usr/bin/env bash
# pandera lets a missing reading pass a lower limit and not an upper one where the table is of polars.
#
# Versions: pandera 0.35.0, pandas 3.1.1, polars 2.1.0
# A good guess: one schema gives one verdict; where a column is nullable a missing reading (NaN) passes every limit, as pandas has it
# Seen: NaN passes all limits in pandas. In polars, where it is larger than every number, it passes ge(15) and gt(15) and fails le(30)
# and in_range(15, 30); null passes all. What is not nullable refuses NaN in both
# Why it matters: NaN is what numpy, Parquet files of pandas and sensors leave; a check that a room is not too cold passes by a dead
# sensor, one that it is not too hot fails, and moving a pipeline to polars turns good days into refused ones
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile "pandera[pandas,polars]==0.35.0" pandas==3.1.1 polars==2.1.0
"$work/venv/bin/python" -W ignore - <<'PY'
import pandas as pd
import pandera.pandas as of_pandas
import pandera.polars as of_polars
import polars as pl

LIMITS = {"ge(15)": ("ge", 15.0), "gt(15)": ("gt", 15.0), "le(30)": ("le", 30.0), "in_range(15, 30)": ("in_range", 15.0, 30.0)}


def passes(engine, table, limit, nullable):
    name, *values = LIMITS[limit]
    column = engine.Column(float, getattr(engine.Check, name)(*values), nullable=nullable)
    try:
        engine.DataFrameSchema({"room_C": column}).validate(table)
    except (engine.errors.SchemaError, engine.errors.SchemaErrors):
        return False
    return True


nan = [21.0, float("nan")]
tables = {"pandas": (of_pandas, pd.DataFrame({"room_C": nan})), "polars": (of_polars, pl.DataFrame({"room_C": nan}))}
tables["polars, null"] = of_polars, pl.DataFrame({"room_C": [21.0, None]})
found = {name: [passes(*of, limit, True) for limit in LIMITS] for name, of in tables.items()}
print(list(LIMITS), found)
assert found == {"pandas": [True] * 4, "polars": [True, True, False, False], "polars, null": [True] * 4}
assert not any(passes(*of, limit, False) for of in tables.values() for limit in LIMITS)
PY
