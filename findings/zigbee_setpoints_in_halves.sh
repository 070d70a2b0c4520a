#!/usr/bin/env bash
# Zigbee2MQTT's converter sends room set-points in steps of 0.5 degC, reports the number that was asked for, and rounds 21.24 up.
#
# Versions: zigbee-herdsman-converters 26.112.0 (npm), Node.js 20
# A good guess: Zigbee's thermostat cluster counts in hundredths, so a set-point of 21.3 degC is sent as 2130
# Seen: 21.3 is sent as 2150, and the state that is published says 21.3; 21.24, nearer to 21.0, is sent as 2150 too, since it
# is first rounded to 42.5 halves. Offsets of the sensor keep 0.1 degC
# Why it matters: a plan in steps of 0.1 K that reads back what it set believes that it was carried out, while the valve
# stands up to 0.26 K elsewhere: the resolution of a command is 0.5 K there, unless the device has a converter of its own
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
npm init -y >/dev/null
npm install --silent --no-fund --no-audit --ignore-scripts zigbee-herdsman-converters@26.112.0 >/dev/null
cat >program.cjs <<'JS'
const assert = require('node:assert');
const converters = require('zigbee-herdsman-converters/converters/toZigbee');

async function convert(converter, key, value) {
    let sent;
    const entity = {write: async (cluster, attributes) => { sent = attributes; }};
    const answer = await converter.convertSet(entity, key, value, {message: {}, options: {}, mapped: {model: 'thermostat'}});
    return [Object.values(sent)[0], answer.state[key]];
}

(async () => {
    for (const [asked, hundredths] of [[21.3, 2150], [21.24, 2150], [21.2, 2100], [21.5, 2150]]) {
        const [sent, state] = await convert(converters.thermostat_occupied_heating_setpoint, 'occupied_heating_setpoint', asked);
        console.log('asked', asked, 'sent', sent, 'reported', state);
        assert.deepStrictEqual([sent, state], [hundredths, asked]);
    }
    const [tenths] = await convert(converters.thermostat_local_temperature_calibration, 'local_temperature_calibration', 0.3);
    assert.strictEqual(tenths, 3);
})();
JS
node program.cjs
