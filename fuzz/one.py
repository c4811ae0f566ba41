"""One reader, fed with inputs that coverage guides (atheris), or mutations without it.

Run by ``fuzz/run.py``; writes its counts to a JSON file every thousand inputs, so that
they are there when a native library takes the process down.
"""

from __future__ import annotations

import json
import os
import random
import re
import sys
import time
import traceback
from pathlib import Path

try:
    import atheris
except ImportError:
    atheris = None

if atheris is not None:
    with atheris.instrument_imports(include=["hybrid"]):
        import readers
else:
    import readers

WORDS = (b"nan", b"1e999", b"-1", b"[", b"{", b"\xff", b"<a>", b"0")
NUMBER = re.compile(rb"-?\d+(\.\d+)?(e-?\d+)?")
NUMBERS = (
    b"0",
    b"-1",
    b"2",
    b"0.5",
    b"1e9",
    b"-1e300",
    b"1e-320",
    b"99999999999",
    b"3",
)
SLOW = 5.0  # s of processor time that no input may take


class Feeder:
    """Gives inputs to a reader and counts what becomes of them."""

    def __init__(self, name: str, runs: int, folder: Path) -> None:
        self.reader, self.runs, self.folder = readers.READERS[name], runs, folder
        self.room = folder / "room"
        self.room.mkdir()
        os.chdir(self.room)  # what a library leaves behind, it leaves here
        self.counts = {"taken": 0, "refused": 0, "inputs": 0, "left": 0}
        self.slowest, self.findings = 0.0, {}

    def __call__(self, data: bytes) -> None:
        """Give one input."""
        path = self.room / self.reader.name
        path.write_bytes(data)
        (self.folder / "last").write_bytes(data)
        start = time.process_time()
        try:
            self.counts[self.reader.outcome(path)] += 1
        except Exception as error:
            self._note(error, data)
        took = time.process_time() - start
        if took > SLOW:
            self._note(TimeoutError(f"{took:.0f} s"), data)
        self.slowest = max(self.slowest, took)
        self.counts["inputs"] += 1
        if self.counts["inputs"] % 1000 == 0 or self.counts["inputs"] >= self.runs:
            self.counts["left"] += len(os.listdir(self.room)) - 1
            self.write()

    def _note(self, error: Exception, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        where = [f"{Path(f.filename).name}:{f.lineno}" for f in frames]
        key = f"{type(error).__name__} at {(where or ['?'])[-1]}"
        if key not in self.findings:
            self.findings[key] = f"{error!r:.200} via {' '.join(where[-4:])}"
            (self.folder / f"finding_{len(self.findings)}").write_bytes(data)

    def write(self) -> None:
        """Write the counts."""
        content = {**self.counts, "slowest": self.slowest, "findings": self.findings}
        (self.folder / "counts.json").write_text(json.dumps(content))


def mutated(data: bytes, rng: random.Random) -> bytes:
    """A few bytes changed, taken away, doubled or put in, or numbers exchanged."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        i, n = rng.randrange(len(changed) + 1), rng.randint(1, 8)
        kind = rng.randrange(8)
        if kind == 0:
            changed[i : i + n] = rng.randbytes(n)
        elif kind == 1:
            del changed[i : i + n]
        elif kind == 2:
            changed[i:i] = changed[max(0, i - 8 * n) : i]
        elif kind == 3:
            changed[i:i] = rng.choice(WORDS)
        elif numbers := list(NUMBER.finditer(changed)):  # the rest stays well-formed
            first, last = rng.choice(numbers).span()
            changed[first:last] = rng.choice(NUMBERS)
    return bytes(changed)


def mixed(data: bytes, longest: int, seed: int) -> bytes:
    """Mutations of ours and of libFuzzer by turns."""
    if seed % 8:
        return mutated(data, random.Random(seed))[:longest]
    return bytes(atheris.Mutate(data, longest))


def main() -> None:
    """Feed a reader: name, inputs, seed, folder."""
    name, runs, seed, folder = sys.argv[1], int(sys.argv[2]), sys.argv[3], sys.argv[4]
    feed, corpus = Feeder(name, runs, Path(folder)), Path(folder) / "corpus"
    corpus.mkdir()
    made = Path(folder) / "made"
    made.mkdir()
    seeds = list(feed.reader.seeds(made))
    for k, data in enumerate(seeds):
        (corpus / f"seed_{k}").write_bytes(data)
    if atheris is None:
        rng = random.Random(int(seed))
        for _ in range(runs):
            feed(mutated(rng.choice(seeds), rng))
        return
    longest = 2 * max(map(len, seeds))
    options = [f"-runs={runs}", f"-seed={seed}", f"-max_len={longest}", "-timeout=60"]
    options += [
        "-rss_limit_mb=4096",
        "-len_control=0",
        "-print_final_stats=1",
        "-close_fd_mask=3",
    ]
    atheris.Setup([sys.argv[0], *options, str(corpus)], feed, custom_mutator=mixed)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
