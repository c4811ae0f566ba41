"""What axe-core finds on pages, in light and in dark.

It wants Chromium, and axe-core of npm (``npm install axe-core``).

    python benchmarks/accessibility.py node_modules/axe-core/axe.min.js report.html ...
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory

_RUN = """axe.run().then((found) => {
  const html = (nodes) => nodes.map((node) => node.html);
  const told = found.violations.map((x) => [x.id, x.impact, html(x.nodes)]);
  document.body.textContent = JSON.stringify([told, found.passes.length]);
});"""
_SCHEMES = {"light": 1, "dark": 0}


def audit(axe: Path, page: Path, scheme: str) -> tuple[list[list], int]:
    """Violations (id, impact, elements), and the number of rules that are kept."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("no browser; valid are chromium and google-chrome")
    scripts = f"<script>{axe.read_text('utf-8')}</script><script>{_RUN}</script></body>"
    head, _, tail = page.read_text("utf-8").rpartition("</body>")
    with TemporaryDirectory() as scratch:
        copy = Path(scratch) / "page.html"
        copy.write_text(head + scripts + tail, "utf-8")
        flags = (
            "--headless --no-sandbox --disable-gpu --dump-dom --window-size=1100,900"
        )
        flags += f" --blink-settings=preferredColorScheme={_SCHEMES[scheme]}"
        flags += f" --virtual-time-budget=20000 --user-data-dir={scratch}/profile"
        done = subprocess.run(
            [browser, *flags.split(), copy.as_uri()], capture_output=True, timeout=120
        )
    body = re.search(r"<body[^>]*>(\[.*\])\s*</body>", done.stdout.decode(), re.DOTALL)
    if body is None:
        raise SystemExit(f"{page}: axe did not end\n{done.stderr.decode()[-500:]}")
    return tuple(json.loads(unescape(body[1])))


def main() -> None:
    """Audit all pages, print what was found, and fail if it was anything."""
    axe, *pages = map(Path, sys.argv[1:])
    wrong = 0
    for page in pages:
        for scheme in _SCHEMES:
            violations, kept = audit(axe, page, scheme)
            wrong += len(violations)
            print(f"{page}, {scheme}: {len(violations)} violations, {kept} rules kept")
            for name, impact, nodes in violations:
                print(f"  {name} ({impact}), {len(nodes)} times: {nodes[0][:160]}")
    raise SystemExit(wrong > 0)


if __name__ == "__main__":
    main()
