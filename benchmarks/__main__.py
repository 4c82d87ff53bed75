"""Everything at once: `python -m benchmarks` measures, and writes docs/performance.md anew.

It also adds the figures to the history (`benchmarks.history`).

With `--page` only the page is written, from the figures in `benchmarks/results/`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks import (
    action_cost,
    history,
    log_cost,
    memory,
    randomization,
    render,
    small_batches,
    startup,
    step_profile,
    step_speed,
    train,
)

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "performance.md"
REPORTS = {
    "step_speed": step_speed.report,
    "small_batches": small_batches.report,
    "log_cost": log_cost.report,
    "step_profile": step_profile.report,
    "action_cost": action_cost.report,
    "randomization": randomization.report,
    "render": render.report,
    "train": train.report,
    "memory": memory.report,
    "startup": startup.report,
}


def main() -> None:
    """Measure each in a process of its own, then fill the page's tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", action="store_true", help="measure nothing")
    if not parser.parse_args().page:
        for name in REPORTS:
            out = ["--out", str(RESULTS / f"{name}.json")]
            subprocess.run([sys.executable, "-m", f"benchmarks.{name}", *out], check=True, cwd=ROOT)
        history.main(["--record", *REPORTS])
    found = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in REPORTS}
    text = PAGE.read_text(encoding="utf-8")
    text = filled(text, "machine", machine_line(found["step_speed"]["machine"]))
    for name, report in REPORTS.items():
        text = filled(text, name, report(found[name]))
    PAGE.write_text(text, encoding="utf-8")


def filled(text: str, name: str, content: str) -> str:
    """Replace the text between the marks of a name.

    Raises:
        ValueError: If a mark is missing.
    """
    begin, end = f"<!-- {name} -->\n", f"\n<!-- /{name} -->"
    head, _, rest = text.partition(begin)
    _, mark, tail = rest.partition(end)
    if not mark:
        raise ValueError(f"no place for {name!r}: it is between {begin!r} and {end!r}")
    return head + begin + content + end + tail


def machine_line(machine: dict[str, Any]) -> str:
    """What the figures were measured on, as a sentence."""
    packages = ", ".join(f"{name} {version}" for name, version in machine["packages"].items())
    return (
        f"Measured {machine['date']} on {machine['cores']} cores of {machine['processor']}, "
        f"{machine['memory_gib']} GiB, {machine['system']}, Python {machine['python']}, {packages}."
    )


if __name__ == "__main__":
    main()
