#!/usr/bin/env bash
# s2-python takes a forecast whose lower limit lies above its upper one, and leakage with a hole between fill levels.
#
# Versions: s2-python 0.11.1, pydantic 2.14.4
# A good guess: messages of the standard (EN 50491-12-2) by which heat pumps and tanks offer flexibility are checked as it says: "the
# fill_level_ranges of the elements must be contiguous", limits in order, a range from its least on; each message of a kind likewise
# Seen: a power range and a fill level target from high to low are refused. A number range from 1 to 0, a power or usage forecast with its
# lower limit above the upper and the expected value outside both, and leakage told from 20 to 40 and from 50 to 60 °C are taken, written
# and read back without a word. Times without a zone and durations below 0 are refused
# Why it matters: an energy manager that trusts the checks has no leakage for a tank at 45 °C, and a band that no plan can lie in
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile s2-python==0.11.1 pydantic==2.14.4
"$work/venv/bin/python" - <<'EOF'
import uuid

from s2python.common import NumberRange, PowerForecastValue, PowerRange
from s2python.frbc import (
    FRBCFillLevelTargetProfileElement,
    FRBCLeakageBehaviour,
    FRBCLeakageBehaviourElement,
    FRBCUsageForecastElement,
)
from s2python.s2_validation_error import S2ValidationError

L1 = "ELECTRIC.POWER.L1"


def span(begin, end):
    return NumberRange(start_of_range=begin, end_of_range=end)


def taken(kind, **given):
    try:
        message = kind(**given)
    except S2ValidationError:
        print("refused:", kind.__name__)
        return False
    assert kind.from_json(message.to_json()) == message
    print("taken:  ", kind.__name__, {key: value for key, value in given.items() if isinstance(value, float)})
    return True


assert not taken(PowerRange, start_of_range=1000.0, end_of_range=0.0, commodity_quantity=L1)
assert not taken(FRBCFillLevelTargetProfileElement, duration=900_000, fill_level_range=span(60.0, 40.0))
assert taken(NumberRange, start_of_range=1.0, end_of_range=0.0)
crossed = {"value_lower_limit": 5000.0, "value_expected": 9000.0, "value_upper_limit": 100.0}
assert taken(PowerForecastValue, commodity_quantity=L1, **crossed)
crossed = {"usage_rate_lower_limit": 5.0, "usage_rate_expected": 9.0, "usage_rate_upper_limit": 1.0}
assert taken(FRBCUsageForecastElement, duration=900_000, **crossed)
leaks = [
    FRBCLeakageBehaviourElement(fill_level_range=span(*between), leakage_rate=rate)
    for between, rate in (((20.0, 40.0), 0.1), ((50.0, 60.0), 0.3))
]
assert taken(FRBCLeakageBehaviour, message_id=uuid.uuid4(), valid_from="2026-01-01T00:00:00Z", elements=leaks)
EOF
