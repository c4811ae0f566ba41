"""Speed and memory of reading large logs, beside the plain library of each format.

Logs of seven joints (position, speed, torque) as Parquet and as an MCAP bag, and the
same bag with camera images in it. Payload is eight bytes for each number of the
recording. Each run is a process of its own; time is its processor time without the
imports, memory its peak. The plain reader of a bag is rosbags, message by message.

    python benchmarks/reading.py --samples 1000000 --out reports/benchmarks/reading
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL"):  # read when numpy loads
    os.environ[f"{_name}_NUM_THREADS"] = "1"

# ruff: noqa: E402
import argparse
import json
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.files import write_json
from hybrid.recording import Recording, read, write

JOINTS = tuple(f"joint{k + 1}" for k in range(7))


def made(folder: Path, samples: int) -> dict[str, Path]:
    """The logs, by name, each with a small one beside it."""
    found = {}
    for name, count in (("small", 2000), ("log", samples)):
        rng = np.random.default_rng(0)
        q = np.cumsum(rng.normal(size=(count, 7)), axis=0) * 1e-3
        t = np.arange(count) / 1000
        log = Recording(t=t, q=q, v=q + 1, tau=q + 2, joints=JOINTS)
        write(log, folder / f"{name}.parquet")
        found["Parquet"] = folder / f"{name}.parquet"
        for kind, image in (("MCAP", 0), ("MCAP, images", 500_000)):
            if name == "small" and image:
                continue
            path = bag(folder / f"{name}_{image}_bag", log, image)
            (file,) = path.glob("*.mcap")
            found[kind] = folder / f"{name}_{image}" / f"{name}.mcap"
            found[kind].parent.mkdir()
            file.rename(found[kind])
    for kind in ("MCAP", "MCAP, images"):
        (found[kind].parent / "small.mcap").hardlink_to(
            folder / "small_0" / "small.mcap"
        )
    return found


def bag(path: Path, log: Recording, image: int) -> Path:
    """An MCAP bag, with 2000 images of some bytes among the joint states."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    every = max(1, len(log.t) // 2000)
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, state = store.types, "sensor_msgs/msg/JointState"
    picture, pixels = "sensor_msgs/msg/CompressedImage", np.zeros(image, np.uint8)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", state, typestore=store)
        camera = writer.add_connection("/camera", picture, typestore=store)
        for k in range(len(log.t)):
            stamp = 1_700_000_000_000_000_000 + k * 1_000_000
            at = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
            head = types["std_msgs/msg/Header"](at, "")
            message = types[state](head, list(JOINTS), log.q[k], log.v[k], log.tau[k])
            raw = bytes(store.serialize_cdr(message, state))
            writer.write(joints, stamp, raw)
            if image and k % every == 0:
                raw = bytes(store.serialize_cdr(
                    types[picture](head, "jpeg", pixels), picture))  # fmt: skip
                writer.write(camera, stamp, raw)
    return path


def plain_bag(path: Path) -> object:
    """What rosbags alone takes to give the same numbers."""
    from rosbags.highlevel import AnyReader

    rows = []
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/joint_states"]
        for c, _, raw in reader.messages(connections=wanted):
            x: Any = reader.deserialize(raw, c.msgtype)
            rows.append(np.concatenate([x.position, x.velocity, x.effort]))
    return np.array(rows)


def plain_parquet(path: Path) -> object:
    """What pyarrow alone takes to give the same numbers."""
    from pyarrow import parquet

    table = parquet.read_table(path)
    return [column.to_numpy() for column in table.columns]


def ours(path: Path) -> object:
    """What hybrid takes."""
    return read(path, joints=JOINTS)


def measure(reader: str, path: Path) -> dict[str, float]:
    """Processor time and memory of one reader on one log, in this process."""
    readers: dict[str, Callable[[Path], object]] = {
        "hybrid": ours, "Parquet": plain_parquet, "MCAP": plain_bag}  # fmt: skip
    warnings.simplefilter("ignore")
    readers[reader](path.parent / f"small{path.suffix}")  # imports, tables of types
    before = peak()
    start = time.process_time()
    readers[reader](path)
    seconds = time.process_time() - start
    return {"cpu_seconds": seconds, "mebibytes": peak() - before}


def peak() -> float:
    """Most memory that this process has held, [MiB] (Linux)."""
    text = Path("/proc/self/status").read_text()
    (line,) = (x for x in text.splitlines() if x.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def main() -> None:
    """Make the logs, measure each reader on each, write what came out."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--out", type=Path, default=Path("out/reading"))
    parser.add_argument("--measure", nargs=2, metavar=("READER", "FILE"))
    args = parser.parse_args()
    if args.measure:
        print(json.dumps(measure(args.measure[0], Path(args.measure[1]))))
        return
    payload, runs = args.samples * 22 * 8 / 1e6, []
    with tempfile.TemporaryDirectory() as folder:
        for name, path in made(Path(folder), args.samples).items():
            size = path.stat().st_size / 1e6
            for reader in ("hybrid", name.split(",")[0]):
                command = [sys.executable, __file__, "--measure", reader, str(path)]
                done = subprocess.run(command, capture_output=True, text=True)
                run = {"log": name, "reader": reader, "megabytes": size}
                run |= json.loads(done.stdout)
                run["payload_mb_per_s"] = payload / run["cpu_seconds"]
                runs.append(run)
                print(" ".join(f"{k}={x:.4g}" if isinstance(x, float) else f"{k}={x}"
                               for k, x in run.items()))  # fmt: skip
    args.out.mkdir(parents=True, exist_ok=True)
    content = {"samples": args.samples, "payload_megabytes": payload, "runs": runs}
    write_json(args.out / "reading.json", content)


if __name__ == "__main__":
    main()
