#!/usr/bin/env bash
# asyncua raises for a value of uncertain quality where one node is read, and returns it, or None, where several are.
#
# Versions: asyncua 2.1.0
# A good guess: OPC UA has good, uncertain and bad; `read_value` raises for bad alone, since an uncertain value (the last usable
# one, one outside its range) is there to be used; `read_values` does the same for each node
# Seen: `read_value` raises for uncertain too; `read_values` returns the uncertain value unmarked, and None for a bad one
# Why it matters: one call loses the reading of a sensor that was only slow, the other takes it for a good one, and a plant's
# code that goes from one to the other changes both
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile asyncua==2.1.0
"$work/venv/bin/python" -W ignore - <<'EOF'
import asyncio
import logging
import socket

from asyncua import Client, Server, ua

logging.disable(logging.CRITICAL)
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    ADDRESS = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}/plant"


async def read(node, client):
    try:
        one = await node.read_value()
    except ua.UaStatusCodeError as error:
        one = type(error).__name__
    return one, (await client.read_values([node]))[0]


async def main():
    server = Server()
    await server.init()
    server.set_endpoint(ADDRESS)
    space = await server.register_namespace("plant")
    room = await server.nodes.objects.add_variable(space, "room", 21.5)
    seen = {}
    async with server:
        async with Client(ADDRESS) as client:
            for quality in ("Good", "UncertainLastUsableValue", "BadSensorFailure"):
                status = ua.StatusCode(getattr(ua.StatusCodes, quality))
                await room.write_value(ua.DataValue(ua.Variant(21.5, ua.VariantType.Double), StatusCode=status))
                seen[quality] = await read(client.get_node(room.nodeid), client)
                print(f"{quality}: read_value {seen[quality][0]}, read_values {seen[quality][1]}")
    assert seen["Good"] == (21.5, 21.5)
    assert seen["UncertainLastUsableValue"] == ("UaStatusCodeError", 21.5)
    assert seen["BadSensorFailure"] == ("BadSensorFailure", None)


asyncio.run(main())
EOF
