"""Lets every call on a file fail once, in each verb, and says what came (docs/reliability.md).

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
        chosen = partial(_kinds, len(errors))
    elif options.most is not None:
        chosen = partial(_evenly, options.most)
    failed = False
    with tempfile.TemporaryDirectory() as folder, verb_forks(Path(folder).resolve()) as forks:
        place = Path(folder).resolve()
        for name in options.cases or CASES:
            begun = time.monotonic()
            how = {"stays": options.stays, "report": _report}
            calls, found = tried(CASES[name], forks, place, chosen, errors, **how)
            wrong = [result for result in found if result.wrong]
            failed = failed or bool(wrong)
            codes = Counter(r.ended.code for r in found if r.ended.failed)
            said = ", ".join(f"{times} with code {code}" for code, times in codes.items())
            said += f", {len(found) - codes.total()} not reached"
            seconds = time.monotonic() - begun
            sys.stdout.write(
                f"{name}: {len(calls)} calls, {len(found)} tries ({said}), {len(wrong)} not as "
                f"promised, {seconds:.0f} s\n"
            )
            sys.stdout.flush()
    return int(failed)


def _evenly(most: int, calls: list[str]) -> list[int]:
    return sampled(len(calls), most)


def _kinds(times: int, calls: list[str]) -> list[int]:
    return [n for n in kinds(calls) for _ in range(times)]


def _report(result: Tried) -> None:
    if result.wrong:
        error = errno.errorcode[result.number]
        ended = result.ended
        sys.stdout.write(
            f"  call {result.n} ({ended.failed}) {error}, code {ended.code}: "
            f"{'; '.join(result.wrong)}\n"
        )
        sys.stdout.write("".join(f"    {line}\n" for line in ended.err.splitlines()[-_LINES:]))
        sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
