"""Let every call on a file fail once, in each verb; report the results (docs/reliability.md).

python scripts/fail_every_call.py              # all calls of all cases
python scripts/fail_every_call.py run train --most 50
python scripts/fail_every_call.py run --kinds  # one call of each kind: what is done to which file
python scripts/fail_every_call.py run --stays  # the disk stays full
"""

from __future__ import annotations

import argparse
import errno
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.helpers.faults import CASES, Tried, kinds, sampled, tried
from tests.helpers.forks import verb_forks

_LINES = 8
"""Lines of stderr that are shown where something is not as promised."""


def main() -> int:
    """Try the cases that are named; return 1 if something is not as promised."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; default: all")
    parser.add_argument("--most", type=int, help="calls of each case; default: all")
    parser.add_argument("--kinds", action="store_true", help="one call of each kind, each error")
    parser.add_argument("--stays", action="store_true", help="all later writes fail too")
    parser.add_argument("--error", choices=("EIO", "ENOSPC"), action="append", default=[])
    options = parser.parse_args()
    errors = [getattr(errno, name) for name in options.error or ("EIO", "ENOSPC")]
    chosen: Callable[[list[str]], list[int]] | None = None
    if options.kinds:
        chosen = partial(_choose_kinds, len(errors))
    elif options.most is not None:
        chosen = partial(_choose_evenly, options.most)
    has_failed = False
    with tempfile.TemporaryDirectory() as folder, verb_forks(Path(folder).resolve()) as forks:
        place = Path(folder).resolve()
        for name in options.cases or CASES:
            started = time.monotonic()
            calls, results = tried(
                CASES[name],
                forks,
                place,
                chosen,
                errors,
                stays=options.stays,
                report=_report,
            )
            seconds = time.monotonic() - started
            wrong_results = [result for result in results if result.wrong]
            has_failed = has_failed or bool(wrong_results)
            codes = Counter(result.ended.code for result in results if result.ended.failed)
            endings = [f"{times} with code {code}" for code, times in codes.items()]
            endings.append(f"{len(results) - codes.total()} not reached")
            sys.stdout.write(
                f"{name}: {len(calls)} calls, {len(results)} tries ({', '.join(endings)}), "
                f"{len(wrong_results)} not as promised, {seconds:.0f} s\n"
            )
            sys.stdout.flush()
    return int(has_failed)


def _choose_evenly(most: int, calls: list[str]) -> list[int]:
    """Return the numbers of at most so many calls, evenly spread."""
    return sampled(len(calls), most)


def _choose_kinds(times: int, calls: list[str]) -> list[int]:
    """Return the number of the first call of each kind, so many times."""
    return [n for n in kinds(calls) for _ in range(times)]


def _report(result: Tried) -> None:
    """Print a result that is not as promised."""
    if not result.wrong:
        return
    error = errno.errorcode[result.number]
    ended = result.ended
    faults = "; ".join(result.wrong)
    sys.stdout.write(f"  call {result.n} ({ended.failed}) {error}, code {ended.code}: {faults}\n")
    for line in ended.err.splitlines()[-_LINES:]:
        sys.stdout.write(f"    {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
