#!/usr/bin/env bash
# OpenVINO gives numbers for NaN where ONNX Runtime gives NaN: Relu 0, Clip its lower bound, Exp infinity.
#
# Versions: openvino 2026.4.1, onnxruntime 1.32.0, onnx 1.23.2
# A good guess: what is computed of a lost reading is no number, in either runtime of the same file
# Seen: in OpenVINO on a CPU NaN becomes 0 by Relu (after Gemm and Conv too, so all of a network's outputs are finite), 5 by
# Clip(5, 30), 1 by Min with 1, 1 by HardSigmoid and infinity by Exp. In ONNX Runtime the greatest of a row (ReduceMax) is NaN where
# NaN stands first, and is not where it stands later; OpenVINO's is never
# Why it matters: a forecast or a command made by a network without one of its readings looks like any other; a check of its output
# for NaN, that held with one runtime, holds no longer with the other
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile openvino==2026.4.1 onnxruntime==1.32.0 onnx==1.23.2 numpy==2.4.6
ORT_DISABLE_TELEMETRY=1 "$work/venv/bin/python" -W ignore - <<'PY'
import numpy as np
import onnxruntime
import openvino
from onnx import TensorProto, helper

CORE = openvino.Core()


def model(nodes, constants, n):
    graph = helper.make_graph(
        nodes,
        "g",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, n])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, None)],
        [helper.make_tensor(name, TensorProto.FLOAT, np.shape(v), np.ravel(v).tolist()) for name, v in constants.items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    return made.SerializeToString()


def by_onnxruntime(content, x):
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0].ravel()


def by_openvino(content, x):
    compiled = CORE.compile_model(CORE.read_model(content), "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return np.ravel(compiled({"x": x})[0])


def one(operation, **constants):
    return [helper.make_node(operation, ["x", *constants], ["y"])], constants


LAYER = {"W": np.ones((16, 4)), "b": np.zeros(4)}
CASES = {
    "Relu": one("Relu"),
    "Clip(5, 30)": one("Clip", low=5.0, high=30.0),
    "Min(., 1)": one("Min", one=[[1.0]]),
    "HardSigmoid": one("HardSigmoid"),
    "Exp": one("Exp"),
    "Gemm and Relu": ([helper.make_node("Gemm", ["x", "W", "b"], ["a"]), helper.make_node("Relu", ["a"], ["y"])], LAYER),
}
seen = {}
lost = np.ones((1, 16), np.float32)
lost[0, 3] = np.nan
for name, (nodes, constants) in CASES.items():
    content = model(nodes, constants, 16)
    ours, theirs = by_onnxruntime(content, lost)[3], by_openvino(content, lost)[3]
    seen[name] = float(theirs)
    print(f"{name} of NaN: ONNX Runtime {ours}, OpenVINO {theirs}")
    assert np.isnan(ours) and not np.isnan(theirs)
assert seen == {
    "Relu": 0.0, "Clip(5, 30)": 5.0, "Min(., 1)": 1.0, "HardSigmoid": 1.0, "Exp": float("inf"), "Gemm and Relu": 0.0
}  # fmt: skip
greatest = model(*one("ReduceMax"), 5)
first, later = np.ones((2, 1, 5), np.float32)
first[0, 0] = later[0, 3] = np.nan
values = [float(run(greatest, x)[0]) for run in (by_onnxruntime, by_openvino) for x in (first, later)]
print(f"ReduceMax, NaN first and later: ONNX Runtime {values[:2]}, OpenVINO {values[2:]}")
assert np.isnan(values[0]) and values[1:] == [1.0, 1.0, 1.0]
PY
