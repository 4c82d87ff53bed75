"""Kills commands at random (SIGKILL), goes on with them, and says what came (docs/reliability.md).

python scripts/kill_at_random.py                      # 5 kills of each case
python scripts/kill_at_random.py train-sac --times 20 --seed 3
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.helpers.forks import verb_forks
from tests.helpers.kills import KILLS


def main() -> int:
    """Kill the cases that are named; return 1 if something is not as promised."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(KILLS)}; default: all")
    parser.add_argument("--times", type=int, default=5, help="kills of each; default: 5")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    draw = random.Random(options.seed)
    failed = False
    with tempfile.TemporaryDirectory() as folder, verb_forks(Path(folder).resolve()) as forks:
        for name in options.cases or KILLS:
            begun = time.monotonic()
            found = KILLS[name](forks, Path(folder).resolve(), draw, options.times)
            wrong = [what for result in found for what in result.wrong]
            failed = failed or bool(wrong)
            alive = sum(not result.ended for result in found)
            left = sum(result.left for result in found)
            sys.stdout.write(
                f"{name}: {alive} kills of {len(found)} tries, {left} temporary files left "
                f"and removed, {sum(bool(r.wrong) for r in found)} not as promised, "
                f"{time.monotonic() - begun:.0f} s\n"
            )
            sys.stdout.write("".join(f"  {what}\n" for what in wrong))
            sys.stdout.flush()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
