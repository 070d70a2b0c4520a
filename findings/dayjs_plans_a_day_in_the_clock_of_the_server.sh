#!/usr/bin/env bash
# Day.js: "06:30 in Brussels, a day later" is 05:30 on a server in UTC where clocks go back in between; date-fns has 24 hours of that day.
#
# Versions: dayjs 1.11.23 (plugins utc and timezone), date-fns 4.4.0 with @date-fns/tz 1.5.0, luxon 3.7.2 (npm), Node.js 20
# A good guess: `dayjs.tz(…, "Europe/Brussels").add(1, "day")` is the same hour of the next day there, wherever the program runs; a
# time that is printed with its offset is the instant that it stands for; the day on which clocks go back has 25 hours
# Seen: on a server in UTC 06:30 on 24 October plus one day is 05:30 local time, and stays an hour early all winter. On one in Brussels
# the instant is right, but it is printed as 06:30+02:00, an hour before itself: JSON and APIs get another time. date-fns'
# eachHourOfInterval leaves out the second 02:00 and gives 24 hours. luxon is right in all
# Why it matters: heating schedules of Node-RED flows and dashboards are tried on a laptop at home and run in a container in UTC; from
# the last Sunday of October on they are an hour early, and 24 prices are laid on 25 hours
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm install --silent --no-fund --no-audit --ignore-scripts dayjs@1.11.23 date-fns@4.4.0 @date-fns/tz@1.5.0 luxon@3.7.2 >npm.log 2>&1
cat > program.cjs <<'JS'
const dayjs = require("dayjs");
dayjs.extend(require("dayjs/plugin/utc"));
dayjs.extend(require("dayjs/plugin/timezone"));
const { DateTime } = require("luxon");
const { addDays, eachHourOfInterval, subMilliseconds } = require("date-fns");
const { TZDate } = require("@date-fns/tz");
const zone = "Europe/Brussels";
const of_dayjs = dayjs.tz("2026-10-24 06:30", zone).add(1, "day");
const of_luxon = DateTime.fromISO("2026-10-24T06:30", { zone }).plus({ days: 1 });
const midnight = new TZDate(2026, 9, 25, zone);
const hours = eachHourOfInterval({ start: midnight, end: subMilliseconds(addDays(midnight, 1), 1) });
console.log(of_dayjs.format(), of_dayjs.toISOString(), of_luxon.toUTC().toISO(), hours.length);
JS
for server in UTC Europe/Brussels; do
    read -r printed instant luxon hours < <(TZ=$server node program.cjs)
    echo "server in $server: dayjs prints $printed and means $instant; luxon $luxon; hours of date-fns $hours"
    [ "$printed" = 2026-10-25T06:30:00+02:00 ] && [ "$luxon" = 2026-10-25T05:30:00.000Z ] && [ "$hours" = 24 ]
    [ "$instant" = "2026-10-25T0$([ $server = UTC ] && echo 4 || echo 5):30:00.000Z" ]
done
