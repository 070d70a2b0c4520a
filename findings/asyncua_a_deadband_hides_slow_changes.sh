#!/usr/bin/env bash
# A server of asyncua never reports a room that cools by 5 K to who asked for changes of 0.5 K, nor that its sensor has failed.
#
# Versions: asyncua 2.1.0 (server and client)
# A good guess: as OPC UA says of a deadband, a value is reported once it is 0.5 K away from the one reported last, and a change of
# the status always
# Seen: each value is compared with the one written before it. A room that falls from 21 to 16 °C in steps of 0.1 K is reported as
# 21 °C and never again; in steps of 0.6 K every one is. A status that turns bad while the value stays is not reported either;
# without a deadband it is
# Why it matters: rooms and tanks change by less than any deadband from one reading to the next, so a controller that subscribes to a
# gateway built with this server holds the temperature of its first minute; ask without a deadband, or read
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile asyncua==2.1.0
"$work/venv/bin/python" -W ignore - <<'PY'
import asyncio
import logging
import socket

from asyncua import Client, Server, ua

logging.disable(logging.CRITICAL)


class Heard:
    def __init__(self):
        self.values = []

    def datachange_notification(self, node, value, data):
        self.values.append((None if value is None else round(value, 1), data.monitored_item.Value.StatusCode.is_good()))


async def heard(temperatures, deadband, then_bad=False):
    """What a client hears of a room that was at 21 °C."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}"
    server = Server()
    await server.init()
    server.set_endpoint(address)
    node = await server.nodes.objects.add_variable(await server.register_namespace("house"), "T", 21.0)
    async with server, Client(address) as client:
        heard = Heard()
        subscription = await client.create_subscription(20, heard)
        room = client.get_node(node.nodeid)
        if deadband:
            await subscription.deadband_monitor(room, deadband, deadbandtype=1)
        else:
            await subscription.subscribe_data_change(room)
        await asyncio.sleep(0.3)
        for temperature in temperatures:
            await node.write_value(temperature)
            await asyncio.sleep(0.05)
        if then_bad:
            await server.write_attribute_value(
                node.nodeid, ua.DataValue(ua.Variant(21.0), StatusCode=ua.StatusCode(ua.StatusCodes.BadSensorFailure))
            )
        await asyncio.sleep(0.5)
        return heard.values


slow = asyncio.run(heard([21 - 0.1 * i for i in range(1, 51)], 0.5))
quick = asyncio.run(heard([21 - 0.6 * i for i in range(1, 6)], 0.5))
failed = asyncio.run(heard([], 0.5, then_bad=True))
without = asyncio.run(heard([], 0.0, then_bad=True))
print("5 K in steps of 0.1 K:", slow, "| 3 K in steps of 0.6 K:", quick)
print("failed sensor:", failed, "| without a deadband:", without)
assert slow == [(21.0, True)] and len(quick) == 6
assert failed == [(21.0, True)] and len(without) == 2 and not without[-1][1]
PY
