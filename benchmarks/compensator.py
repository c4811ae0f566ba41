"""Seconds to train a Gaussian mixture on a million samples, and time to predict.

Twelve inputs, one torque, twenty components; expectation maximisation on a draw of the
samples. Prints a table; with ``--json`` writes the figures.

    python benchmarks/compensator.py --samples 1000000
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.report import provenance, write_results

COMPONENTS = 20


def samples(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and speeds of six joints along sums of sines, and a torque."""
    rng = np.random.default_rng(0)
    t = np.arange(count) * 0.002
    speed, phase = rng.uniform(0.5, 3.0, (2, 6))
    q = np.sin(np.outer(t, speed) + phase) + 0.3 * np.sin(np.outer(t, 2.7 * speed))
    x = np.hstack([q, np.gradient(q, 0.002, axis=0)])
    y = np.sin(2 * x[:, :1]) + np.tanh(3 * x[:, 6:7]) + 0.3 * x[:, 1:2] * x[:, 8:9]
    return x, y + 0.1 * rng.normal(size=y.shape)


def measure(count: int) -> dict[str, Any]:
    """Train once and predict."""
    x, y = samples(count)
    start, busy = time.perf_counter(), time.process_time()
    model = fit_gmr(x, y, components=COMPONENTS, covariance_floor=1e-3)
    found: dict[str, Any] = {"train_seconds": time.perf_counter() - start}
    found["train_processor_seconds"] = time.process_time() - busy
    error = y - model.predict(x)
    found["rms_over_deviation"] = float(error.std() / y.std())
    for rows in (1, 100_000):
        part, repeats = x[:rows], max(3, 2000 // rows)
        start = time.perf_counter()
        for _ in range(repeats):
            model.predict(part)
        spent = (time.perf_counter() - start) / repeats / rows
        found[f"predict_{rows}_microseconds_per_sample"] = 1e6 * spent
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--json")
    args = parser.parse_args()
    found = measure(args.samples)
    for name, value in found.items():
        print(f"{name:42} {value}")
    if args.json:
        command = f"python benchmarks/compensator.py --samples {args.samples}"
        write_results(args.json, {"provenance": provenance(command=command), **found})


if __name__ == "__main__":
    main()
