"""Write a program as an ONNX graph in double precision, with a free batch axis."""

import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from hybrid.dynamics import Law
from hybrid.model.program import Program

_OPSET, _FORMAT = 18, 9  # operators and file format of 2023, for old runtimes
_NAMES = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div",
    "power": "Pow", "negative": "Neg", "absolute": "Abs", "sign": "Sign",
    "sqrt": "Sqrt", "exp": "Exp", "log": "Log", "sin": "Sin", "cos": "Cos",
    "tanh": "Tanh", "minimum": "Min", "maximum": "Max", "where": "Where",
    "less": "Less", "less_equal": "LessOrEqual", "greater": "Greater",
    "greater_equal": "GreaterOrEqual",
}  # fmt: skip


class _Graph:
    """Nodes and constants of a graph that is being built."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: dict[bytes, Any] = {}

    def node(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """Add an operation; return the name of its result."""
        name = f"x{len(self.nodes)}"
        self.nodes.append(
            helper.make_node(operator, list(inputs), [name], **attributes)
        )
        return name

    def constant(self, values: Any, kind: Any = np.float64) -> str:
        """Add a constant, unless an equal one exists; return its name."""
        array = np.asarray(values, dtype=kind)
        key = array.tobytes() + str((array.shape, array.dtype)).encode()
        if key not in self.constants:
            name = f"c{len(self.constants)}"
            self.constants[key] = numpy_helper.from_array(array, name)
        return str(self.constants[key].name)


def onnx_model(program: Program, manifest: Mapping[str, Any]) -> Any:
    """Build an ``onnx.ModelProto`` with the manifest in its metadata.

    Inputs are q, v and a, shape (N, n), and if the program uses them t, step and known,
    shape (N, 1), and memory, shape (N, s). Outputs are tau and variance, shape (N, n),
    and memory_out, shape (N, s).
    """
    graph = _Graph()
    given, found = program.widths()
    columns = _results(graph, program)
    for name, width in found.items():
        graph.node("Concat", *columns[:width], axis=1)
        graph.nodes[-1].output[0] = name
        del columns[:width]
    inputs, outputs = (
        [
            helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", width])
            for name, width in widths.items()
        ]
        for widths in (given, found)
    )
    constants = list(graph.constants.values())
    made = helper.make_graph(graph.nodes, "hybrid", inputs, outputs, constants)
    opset = helper.make_opsetid("", _OPSET)
    model = helper.make_model(made, opset_imports=[opset], ir_version=_FORMAT)
    for key, value in manifest.items():
        text = value if isinstance(value, str) else json.dumps(value)
        model.metadata_props.add(key=key, value=text)
    return model


def _results(graph: _Graph, program: Program) -> list[str]:
    """Add a node for each operation, shape (N, 1); return the names of the results."""

    def put(operator: str, name: str, *given: str | float) -> str:
        x = [y if isinstance(y, str) else graph.constant([y]) for y in given]
        if name == "where":
            x[0] = graph.node("Greater", x[0], graph.constant([0.5]))
        result = graph.node(operator, *x)
        if operator.startswith(("Less", "Greater")):
            result = graph.node("Cast", result, to=TensorProto.DOUBLE)
        return result

    def gathered(name: str) -> str:
        whole, _, index = name.partition("[")
        if not index or name not in program.uses:
            return whole
        at = graph.constant([int(index.rstrip("]"))], np.int64)
        return graph.node("Gather", whole, at, axis=1)

    law = Law(program.tape, program.results, program.inputs)
    found = law.by({name: partial(put, x, name) for name, x in _NAMES.items()})
    return [_column(graph, x) for x in found(*map(gathered, program.inputs))]


def _column(graph: _Graph, x: str | float) -> str:
    """Make a result, which may be a number, a column of shape (N, 1)."""
    if isinstance(x, str):
        return x
    first = graph.node("Gather", "q", graph.constant([0], np.int64), axis=1)
    zero = graph.node("Mul", first, graph.constant([0.0]))
    return graph.node("Add", zero, graph.constant([x]))
