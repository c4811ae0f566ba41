"""Write a program as TorchScript in double precision, with a free batch axis.

An archive is a zip file of tensors, operations as text, and tables in pickle format.
``torch.jit.load`` has its own reader for these, which only knows numbers, tensors and
the operations of the archive. It imports and calls no Python code.
"""

import io
import json
import operator
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from hybrid.dynamics import Law
from hybrid.model.program import Program


def _of_tensors(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Let a function of tensors also take numbers."""
    return lambda *given: function(
        *(torch.as_tensor(x, dtype=None if isinstance(x, Tensor) else torch.float64)
          for x in given)
    )  # fmt: skip


def _compared(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Let a comparison be 1 or 0, which laws may calculate with, as in C and ONNX."""
    return lambda x, y: function(x, y).to(torch.float64)


def _chosen(condition: Tensor, x: Tensor, y: Tensor) -> Tensor:
    return torch.where(condition > 0.5, x, y)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add, "subtract": operator.sub, "multiply": operator.mul,
    "divide": operator.truediv, "power": operator.pow, "negative": operator.neg,
    "less": _compared(operator.lt), "less_equal": _compared(operator.le),
    "greater": _compared(operator.gt), "greater_equal": _compared(operator.ge),
    "absolute": torch.abs, "sign": torch.sign, "sqrt": torch.sqrt, "exp": torch.exp,
    "log": torch.log, "sin": torch.sin, "cos": torch.cos, "tanh": torch.tanh,
    "minimum": _of_tensors(torch.minimum), "maximum": _of_tensors(torch.maximum),
    "where": _of_tensors(_chosen),
}  # fmt: skip
_BATCH = 3  # rows of the example for tracing


class ProgramModule(torch.nn.Module):
    """The program as a torch module, with the inputs and outputs of the ONNX export.

    Inputs are q, v and a, shape (N, n), and if the program uses them t, step and known,
    shape (N, 1), and memory, shape (N, s), in this order. Outputs are tau and variance,
    shape (N, n), and memory_out, shape (N, s), if there is memory.
    """

    def __init__(self, program: Program) -> None:
        super().__init__()
        self.program = program
        given, found = program.widths()
        self.names, self.widths = list(given)[3:], list(found.values())
        self.law = Law(program.tape, program.results, program.inputs).by(_OPERATIONS)

    def forward(self, q: Tensor, v: Tensor, a: Tensor, *others: Tensor) -> Any:
        """Torque [N·m], variance [(N·m)²] of its learned part, and memory."""
        given = {"q": q, "v": v, "a": a}
        given |= dict(zip(self.names, others, strict=True))
        values = self.law(*(_column(given, name) for name in self.program.inputs))
        zero = torch.zeros_like(q[:, :1])
        whole = torch.cat([zero + x for x in values], dim=1)
        return torch.split(whole, self.widths, dim=1)


def _column(given: Mapping[str, Tensor], name: str) -> Tensor | None:
    """Input of the tape, shape (N, 1); None if the program does not use it."""
    whole, _, index = name.partition("[")
    j = int(index.rstrip("]")) if index else 0
    return given[whole][:, j : j + 1] if whole in given else None


def write_torchscript(
    program: Program, manifest: Mapping[str, Any], path: Path
) -> None:
    """Write the archive, which includes the manifest as ``manifest.json``."""
    module, (given, _) = ProgramModule(program), program.widths()
    example = tuple(
        torch.full((_BATCH, width), 0.1, dtype=torch.float64)
        for width in given.values()
    )
    with warnings.catch_warnings():
        # torch warns that TorchScript has a successor.
        warnings.simplefilter("ignore")
        traced = torch.jit.trace(  # type: ignore[no-untyped-call]
            module, example, check_trace=False
        )
        text = json.dumps(dict(manifest), ensure_ascii=False)
        whole = io.BytesIO()
        torch.jit.save(traced, whole, _extra_files={"manifest.json": text})
    # Debug information is left out, because it names files of this computer.
    with zipfile.ZipFile(whole) as saved, zipfile.ZipFile(path, "w") as archive:
        for name in saved.namelist():
            if not name.endswith(".debug_pkl"):
                archive.writestr(zipfile.ZipInfo(name), saved.read(name))
