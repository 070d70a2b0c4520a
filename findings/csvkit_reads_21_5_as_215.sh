#!/usr/bin/env bash
# csvkit turns 21,5 °C into 215 and 20,25 °C into 2025, and half past six into six and a half minutes; frictionless takes 21,5 for a place.
#
# Versions: csvkit 2.2.0, agate 1.14.2, frictionless 5.21.0
# A good guess: a column with decimal commas stays text, as in pandas and polars, or has numbers with a comma; "06:30" is a time
# or text
# Seen: without --locale the comma is dropped wherever it stands, so two digits or one decide about a factor of 100 or 10, and a level
# of 0,75 is 75; the table that comes out is a valid one, and nothing is said. With --locale de_DE numbers are right, and the date
# 03.11.2025 is the number 3112025. "06:30" is 0:06:30 in both. frictionless says of the column 21,5 that it holds coordinates
# Why it matters: loggers and heat pumps write such files in half of Europe, and csvkit is at hand to look at them or load them into a
# database (csvstat, csvsql); who does not look at the numbers has a building at 2025 °C and no idea why
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile csvkit==2.2.0 agate==1.14.2 frictionless==5.21.0
cd "$work"
cat > house.csv <<'CSV'
day;from;T;level
03.11.2025;06:30;21,5;0,75
13.11.2025;22:00;20,25;1
CSV
plain=$(venv/bin/in2csv house.csv)
german=$(venv/bin/in2csv --locale de_DE house.csv)
place=$(venv/bin/python -W ignore -c 'import frictionless as f; print(f.describe("house.csv").schema.get_field("T").type)')
printf '%s\n--locale de_DE:\n%s\nfrictionless: T is a %s\n' "$plain" "$german" "$place"
[ "$plain" = "day,from,T,level
03.11.2025,0:06:30,215,75
13.11.2025,0:22:00,2025,1" ]
[ "$german" = "day,from,T,level
3112025,0:06:30,21.5,0.75
13112025,0:22:00,20.25,1" ]
[ "$place" = geopoint ]
