"""Run an identified model in Python at the speed of C: compile the exported header."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.exports.export import export
from hybrid.model.dynamic_model import DynamicModel
from hybrid.names import c_identifier

_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O3", "-fno-math-errno", "-shared", "-fPIC")
_LIBRARY = """#include "{p}.h"
#define API __attribute__((visibility("default")))
API const size_t size = sizeof({p}_state);
API void start({p}_state *s, double step)
{{
    int j;
    {p}_start(s, step);
    for (j = 0; j < {n}; j++)
        s->clamp[j] = INFINITY;
}}
API int torque({p}_state *s, long count, const double *q, const double *v,
    const double *a, double *tau, double *variance)
{{
    long k;
    for (k = 0; k < count * {n}; k += {n}) {{
        if ({p}_torque(s, q + k, v + k, a + k, tau + k,
                variance == NULL ? NULL : variance + k) < 0)
            return -1;
    }}
    return 0;
}}
"""


class CompiledModel:
    """A compiled model that computes torque sample by sample, as in a control loop.

    Args:
        model: An identified model.
        step: Time between samples, [s].

    Raises:
        HybridError: There is no C compiler.
        EffectError: An effect cannot run in a control loop.
    """

    def __init__(self, model: DynamicModel, *, step: float = 0.001) -> None:
        compiler = next((c for c in _COMPILERS if shutil.which(c)), None)
        if compiler is None:
            raise HybridError(f"no C compiler; valid are {', '.join(_COMPILERS)}")
        self._n, self._step = model.robot.size, step
        with TemporaryDirectory() as name:
            folder, p = Path(name), c_identifier(model.robot.name)
            export(model, folder, format="c")
            source = folder / "library.c"
            source.write_text(_LIBRARY.format(p=p, n=self._n), encoding="utf-8")
            library = folder / "library.so"
            subprocess.run(
                [compiler, *_FLAGS, "-o", library, source, "-lm"], check=True
            )
            self._library = ctypes.CDLL(str(library))
        size = ctypes.c_size_t.in_dll(self._library, "size").value
        self._state = ctypes.create_string_buffer(size)
        address = ctypes.c_void_p
        self._torque = self._library.torque
        self._torque.argtypes = [address, ctypes.c_long, *[address] * 5]
        self._library.start.argtypes = [address, ctypes.c_double]
        self.start()

    def start(self) -> None:
        """Clear the memory of the model."""
        self._library.start(self._state, self._step)

    def predict(self, q: Array, v: Array, a: Array) -> Array:
        """Torque of successive samples, shape (N, n) or (n,), [N·m].

        Args:
            q: Positions, shape (N, n) or (n,), [rad].
            v: Speeds, of the same shape, [rad/s].
            a: Accelerations, of the same shape, [rad/s²].

        Raises:
            HybridError: A shape is wrong, or a number is not finite.
        """
        q, v, a = (np.ascontiguousarray(x, dtype=np.float64) for x in (q, v, a))
        if not (q.shape == v.shape == a.shape and q.shape[-1:] == (self._n,)):
            raise HybridError(
                f"shapes are {q.shape}, {v.shape} and {a.shape}; "
                f"valid is (N, {self._n})"
            )
        tau = np.empty_like(q)
        given = (x.ctypes.data for x in (q, v, a, tau))
        if self._torque(self._state, q.size // self._n, *given, None) != 0:
            raise HybridError("a number is not finite")
        return tau
