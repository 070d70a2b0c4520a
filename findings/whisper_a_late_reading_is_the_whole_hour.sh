#!/usr/bin/env bash
# Whisper, Graphite's store: one reading that comes late replaces the mean of its whole hour.
#
# Versions: whisper 1.1.10
# A good guess: minutes are kept for two hours and their means by the hour for two days; a reading of four hours ago, from a gateway that
# was offline, is one sixtieth of its hour's mean, or is refused
# Seen: an hour of sixty readings of 21 °C becomes 25 °C by one reading of 25, which is written where the mean stood. Sixty late
# readings that rise from 20 to 26 °C leave the last, 25.9 °C, not their mean of 22.95. No word is said
# Why it matters: radiators' and meters' gateways send again what they could not send, so hours around an outage are single readings
# among means: peaks that never were, and energy that is off by the ratio of the last minute to the hour
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile whisper==1.1.10
cd "$work"
"$work/venv/bin/python" - <<'EOF'
import whisper

MINUTE, HOUR = 60, 3600
NOW = 1_800_000_000 // HOUR * HOUR
whisper.create("room.wsp", [(MINUTE, 120), (HOUR, 48)], aggregationMethod="average")


def hours():
    _, values = whisper.fetch("room.wsp", NOW - 6 * HOUR - 1, NOW - HOUR, now=NOW)
    return [value if value is None else round(value, 2) for value in values]


for at in range(NOW - 6 * HOUR, NOW, MINUTE):
    whisper.update("room.wsp", 21.0, at, now=at)
print("hours as they were read:", hours())
assert hours() == [21.0] * 6
whisper.update("room.wsp", 25.0, NOW - 4 * HOUR + 10 * MINUTE, now=NOW)
print("one reading of 25 °C comes late:", hours())
assert hours() == [21.0, 21.0, 25.0, 21.0, 21.0, 21.0]
late = [(NOW - 5 * HOUR + MINUTE * i, 20 + i / 10) for i in range(60)]
whisper.update_many("room.wsp", late, now=NOW)
print("an hour of late readings, mean", sum(value for _, value in late) / 60, "last", late[-1][1], ":", hours())
assert hours() == [21.0, 25.9, 25.0, 21.0, 21.0, 21.0]
EOF
