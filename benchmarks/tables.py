"""What benchmarks measured, as tables and in print."""

from __future__ import annotations

from typing import Any

from hybrid.report import Table, provenance, write_results


def length_table(runs: list[dict[str, Any]]) -> Table:
    """Time and memory against length."""
    first = runs[0]["seconds"] / runs[0]["samples"]
    rows = [
        (
            f"{x['samples']:,}",
            f"{x['seconds']:.2f}",
            f"{x['samples'] / x['seconds']:,.0f}",
            f"{x['seconds'] / x['samples'] / first:.2f}",
            f"{x['peak_mebibytes']:.0f}",
            f"{x['before_mebibytes']:.0f}",
            f"{x['predict_seconds']:.2f}",
        )
        for x in runs
    ]
    header = ("samples", "identify [s]", "samples/s", "time per sample, relative")
    header += ("peak memory [MiB]", "before the fit [MiB]", "predict [s]")
    return Table(
        header, tuple(rows), "One identification, 84 columns a sample, one core"
    )


def ratio_table(run: dict[str, Any], other: dict[str, Any]) -> Table:
    """Times beside others', those of the whole identification being one."""
    whole = run["seconds"]
    times = {
        "whole identification": whole,
        **{f"– {k}": x for k, x in run["steps"].items()},
    }
    times |= {"predict, every kind of term": run["predict_seconds"]}
    times |= {"batched regressor alone": other["regressor"]}
    times |= {"Python loop over pin.computeJointTorqueRegressor": other["loop"]}
    if other["figaroh"]:
        times |= {"FIGAROH, build to solve": sum(other["figaroh"].values())}
        times |= {f"– {k}": x for k, x in other["figaroh"].items()}
    rows = tuple((k, f"{x / whole:.2f}", f"{x:.3f}") for k, x in times.items())
    caption = f"{run['samples']:,} samples, {run['iterations']} reweightings"
    return Table(("", "ratio", "[s]"), rows, caption)


def show(found: dict[str, dict[str, float]], *, command: str, path: str | None) -> None:
    """Print some numbers of each model, and write them if there is a path."""
    for name, values in found.items():
        print(name)
        for key, value in values.items():
            print(f"  {key:28} {value:10.3g}")
    if path:
        write_results(path, {"provenance": provenance(command=command), **found})
