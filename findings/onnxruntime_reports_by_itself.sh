#!/usr/bin/env bash
# onnxruntime's wheel for Linux writes a device id and a database of events when it is imported, and sends events.
#
# Versions: onnxruntime 1.32.0
# A good guess: a library of inference writes and sends nothing on Linux, where telemetry was off until now; if it did,
# `onnxruntime.disable_telemetry_events()` would stop it
# Seen: `import onnxruntime` leaves ~/.cache/Microsoft/DeveloperTools/.onnxruntime/{deviceid,onnxruntime.db} and
# $TMPDIR/.ses; a session later asks for mobile.events.data.microsoft.com. ORT_DISABLE_TELEMETRY=1 before the import
# stops all of it; the call comes after the first event
# Why it matters: a controller in a building has a network that is watched, a home that is read-only, or a promise that
# nothing leaves the house; a minor release within the usual bound (<2) broke it
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile onnxruntime==1.32.0
left() { (cd "$work/$1" && find . -type f | sort); }
mkdir -p "$work/on/tmp" "$work/off/tmp" "$work/late/tmp"
env -i HOME="$work/on" TMPDIR="$work/on/tmp" "$work/venv/bin/python" -c "import onnxruntime"
env -i HOME="$work/off" TMPDIR="$work/off/tmp" ORT_DISABLE_TELEMETRY=1 "$work/venv/bin/python" -c "import onnxruntime"
env -i HOME="$work/late" TMPDIR="$work/late/tmp" "$work/venv/bin/python" -c \
  "import onnxruntime; onnxruntime.disable_telemetry_events()"
echo "imported:"; left on
echo "with disable_telemetry_events():"; left late
echo "with ORT_DISABLE_TELEMETRY=1:"; left off
[ -n "$(left on)" ] && [ -n "$(left late)" ] && [ -z "$(left off)" ]
