#!/usr/bin/env bash
# StatsD subtracts an outdoor temperature below zero from the one before: clients of Node.js send it as it is, and -6 °C after -5 is -7 °C.
#
# Versions: statsd 0.9.0 (server, npm), hot-shots 17.1.1, node-statsd 0.1.1, lynx 0.2.0 (npm), Node.js 20; statsd 4.0.1 (PyPI) in comparison
# A good guess: a gauge reads what it was set to last: 4, -5, -6, 3 °C
# Seen: a number with a sign is a change in StatsD's protocol, so a gauge is set below zero only by way of 0. `gauge(name, -5)` of three
# clients of Node.js sends "-5|g": the server has 4, -1, -7, 3. The client of Python sends 0 first, and has 4, -5, -6, 3
# Why it matters: nothing is wrong until the first frost; then the heating curve, the COP and the frost alarm are given 4 K too much, and
# each further reading drifts away by the whole outdoor temperature until one is above zero
set -euo pipefail
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null; rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile statsd==4.0.1
cd "$work"
npm init -y >/dev/null
npm install --silent --no-audit --no-fund --ignore-scripts statsd@0.9.0 hot-shots@17.1.1 node-statsd@0.1.1 lynx@0.2.0
read -r port admin < <(python3 -c 'import socket
ends = [socket.socket(socket.AF_INET, kind) for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM)]
[end.bind(("127.0.0.1", 0)) for end in ends]
print(*[end.getsockname()[1] for end in ends])')
cat >config.js <<EOF
{ port: $port, address: "127.0.0.1", mgmt_port: $admin, mgmt_address: "127.0.0.1", backends: [], flushInterval: 600000 }
EOF
timeout 60 node node_modules/statsd/stats.js config.js >server.log 2>&1 &
server=$!
cat >send.py <<EOF
import sys

import statsd

statsd.StatsClient("127.0.0.1", $port).gauge("python", float(sys.argv[1]))
EOF
cat >send.js <<EOF
const assert = require("assert"), { execFileSync } = require("child_process"), net = require("net");
const at = { host: "127.0.0.1", port: $port };
const clients = {
  "hot-shots": new (require("hot-shots"))(at),
  "node-statsd": new (require("node-statsd"))(at),
  lynx: new (require("lynx"))(at.host, at.port),
};
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
/** What the server says its gauges read. */
const gauges = () =>
  new Promise((done, fail) => {
    let told = "";
    const line = net.connect($admin, "127.0.0.1", () => line.write("gauges\n"));
    line.on("error", fail).on("data", (part) => {
      told += part;
      if (!told.includes("END")) return;
      line.destroy();
      done(Function("return " + told.split("END")[0])());
    });
  });
(async () => {
  for (let tries = 0; ; tries++)
    try { await gauges(); break; } catch (error) { if (tries > 50) throw error; await pause(200); }
  const seen = {};
  for (const outdoor of [4, -5, -6, 3]) {
    for (const name in clients) clients[name].gauge(name, outdoor);
    execFileSync("venv/bin/python", ["send.py", String(outdoor)]);
    await pause(1500);
    for (const [name, value] of Object.entries(await gauges())) if (name === "python" || clients[name]) (seen[name] ??= []).push(value);
  }
  console.log("sent: 4, -5, -6, 3; read:", seen);
  assert.deepStrictEqual(seen.python, [4, -5, -6, 3]);
  for (const name in clients) assert.deepStrictEqual(seen[name], [4, -1, -7, 3]);
  process.exit(0);
})().catch((error) => { console.error(error); process.exit(1); });
EOF
node send.js
