#!/usr/bin/env bash
# pandapipes converges on water that a heat consumer has cooled below absolute zero, and without flow cools the whole network
# to 20 °C.
#
# Versions: pandapipes 0.16.0
# A good guess: a consumer that asks for more heat than its flow can give is an error, or the network does not converge; no
# flow, no heat
# Seen: 50 kW of 0.01 kg/s: converged, the return is at -1036 °C; of 0 kg/s: converged, every junction is at 293.15 K, the
# supply set to 330 K too, and the result still lists 50 kW
# Why it matters: a controller that closes valves in a loop with it sees a house that is still heated, or a network that is
# suddenly cold
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pandapipes==0.16.0
"$work/venv/bin/python" -W ignore - <<'PY'
import logging

import pandapipes as pp

logging.disable(logging.CRITICAL)


def solved(flow_kg_s):
    net = pp.create_empty_network(fluid="water")
    nodes = [pp.create_junction(net, pn_bar=5, tfluid_k=330) for _ in range(4)]
    pp.create_circ_pump_const_pressure(net, nodes[3], nodes[0], 5, 2, t_flow_k=330)
    pipe = {"length_km": 0.1, "inner_diameter_mm": 50.0, "k_mm": 0.1, "u_w_per_m2k": 10.0, "text_k": 283, "sections": 5}
    pp.create_pipe_from_parameters(net, nodes[0], nodes[1], **pipe)
    pp.create_heat_consumer(net, nodes[1], nodes[2], controlled_mdot_kg_per_s=flow_kg_s, qext_w=50_000)
    pp.create_pipe_from_parameters(net, nodes[2], nodes[3], **pipe)
    pp.pipeflow(net, mode="bidirectional", iter=100)
    return net


good, small, none = solved(1.0), solved(0.01), solved(0.0)
for net in (good, small, none):
    print("converged", net.converged, "junctions, K:", net.res_junction.t_k.round(1).tolist())
assert good.converged and good.res_junction.t_k.min() > 310
assert small.converged and small.res_junction.t_k.min() < 0
assert none.converged and none.res_junction.t_k.round(2).eq(293.15).all()
assert none.res_heat_consumer.qext_w[0] == 50_000
PY
