#!/usr/bin/env bash
# In rdflib the largest of several readings, one of which is NaN, depends on the order in which they stand; sorting raises.
#
# Versions: rdflib 7.6.0
# A good guess: MAX and MIN of readings with a NaN are NaN (or leave it out), ORDER BY puts NaN at one end
# Seen: MAX of (NaN, 21.5, 9.5) is NaN and of (21.5, NaN, 9.5) is 21.5; where a reading is a decimal beside a NaN, MAX, MIN
# and ORDER BY raise decimal.InvalidOperation
# Why it matters: a model of a building with readings in it (Brick, SOSA) gives set-points and limits that depend on the order
# of a file, as soon as one sensor has failed
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile rdflib==7.6.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import decimal

import rdflib

HEAD = "@prefix e: <http://example.org/> . @prefix x: <http://www.w3.org/2001/XMLSchema#> .\n"


def ask(values, what):
    graph = rdflib.Graph()
    graph.parse(data=HEAD + "".join(f"e:{k} e:reads {value} .\n" for k, value in enumerate(values)), format="turtle")
    try:
        return [str(row[0]) for row in graph.query(f"SELECT {what} WHERE {{?s <http://example.org/reads> ?v}}")]
    except decimal.InvalidOperation:
        return "InvalidOperation"


nan, warm, cold = '"NaN"^^x:double', '"21.5"^^x:double', '"9.5"^^x:double'
first, second = ask([nan, warm, cold], "(MAX(?v) AS ?m)"), ask([warm, nan, cold], "(MAX(?v) AS ?m)")
mixed = ask(["21.5", nan, "9.5"], "(MAX(?v) AS ?m)")
print(f"largest: NaN first {first}, NaN second {second}, with decimals {mixed}")
assert first == ["nan"] and second == ["21.5"] and mixed == "InvalidOperation"
EOF
