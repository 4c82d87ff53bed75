"""Kill commands at random (SIGKILL), go on with them, report the results (docs/reliability.md).

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
    random_moments = random.Random(options.seed)
    has_failed = False
    with tempfile.TemporaryDirectory() as folder, verb_forks(Path(folder).resolve()) as forks:
        place = Path(folder).resolve()
        for name in options.cases or KILLS:
            started = time.monotonic()
            results = KILLS[name](forks, place, random_moments, options.times)
            seconds = time.monotonic() - started
            kills = sum(not result.ended for result in results)
            temporary_files = sum(result.left for result in results)
            wrong_results = [result for result in results if result.wrong]
            has_failed = has_failed or bool(wrong_results)
            sys.stdout.write(
                f"{name}: {kills} kills of {len(results)} tries, {temporary_files} temporary files "
                f"left and removed, {len(wrong_results)} not as promised, {seconds:.0f} s\n"
            )
            for result in wrong_results:
                sys.stdout.write("".join(f"  {fault}\n" for fault in result.wrong))
            sys.stdout.flush()
    return int(has_failed)


if __name__ == "__main__":
    sys.exit(main())
