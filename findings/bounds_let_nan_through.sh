#!/usr/bin/env bash
# jsonschema, fastjsonschema, cerberus, traitlets and voluptuous' Clamp let NaN through bounds of 5 to 30.
#
# Versions: jsonschema 4.26.0, fastjsonschema 2.22.3, cerberus 1.3.8, traitlets 5.16.1, voluptuous 0.16.0; pydantic 2.14.4, attrs 26.1.0
# A good guess: a set-point that must lie between 5 and 30 is refused where it is NaN (json.loads reads NaN, though JSON has none)
# Seen: those ask whether the value is below or above, which NaN never is, and take it; Clamp gives NaN back. pydantic, attrs and
# voluptuous' Range ask whether it is within, and refuse it
# Why it matters: a set-point or a reading that was checked by its schema is no number, and goes to the building
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile jsonschema==4.26.0 fastjsonschema==2.22.3 cerberus==1.3.8 traitlets==5.16.1 \
  voluptuous==0.16.0 pydantic==2.14.4 attrs==26.1.0
"$work/venv/bin/python" -W ignore - <<'PY'
import json

import attr
import cerberus
import fastjsonschema
import jsonschema
import pydantic
import traitlets
import voluptuous

SCHEMA = {"type": "object", "properties": {"T_set": {"type": "number", "minimum": 5, "maximum": 30}}}


class Traits(traitlets.HasTraits):
    T_set = traitlets.Float(20.0, min=5.0, max=30.0)


class Model(pydantic.BaseModel):
    T_set: float = pydantic.Field(ge=5, le=30)


@attr.s
class Attrs:
    T_set = attr.ib(validator=[attr.validators.ge(5), attr.validators.le(30)])


def by_cerberus(document):
    validator = cerberus.Validator({"T_set": {"type": "float", "min": 5, "max": 30}})
    if not validator.validate(document):
        raise ValueError(validator.errors)


CHECKS = {
    "jsonschema": lambda d: jsonschema.validate(d, SCHEMA),
    "fastjsonschema": lambda d: fastjsonschema.compile(SCHEMA)(d),
    "cerberus": by_cerberus,
    "traitlets": lambda d: Traits(**d),
    "voluptuous Clamp": lambda d: voluptuous.Schema({"T_set": voluptuous.Clamp(5, 30)})(d),
    "voluptuous Range": lambda d: voluptuous.Schema({"T_set": voluptuous.Range(5, 30)})(d),
    "pydantic": lambda d: Model(**d),
    "attrs": lambda d: Attrs(**d),
}


def takes(check, text):
    try:
        check(json.loads(text))
    except Exception:
        return False
    return True


taken = {name for name, check in CHECKS.items() if takes(check, '{"T_set": NaN}')}
for name, check in CHECKS.items():
    print(f"{name}: NaN {'taken' if name in taken else 'refused'}")
    assert takes(check, '{"T_set": 21.0}')
    assert name == "voluptuous Clamp" or not takes(check, '{"T_set": 31.0}')
assert taken == {"jsonschema", "fastjsonschema", "cerberus", "traitlets", "voluptuous Clamp"}
PY
