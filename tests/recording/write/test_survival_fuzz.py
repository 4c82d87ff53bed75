"""A thousand mutated logs are read; `benchmarks/log_fuzz.py` alone reads twenty thousand."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.log_fuzz import GOOD, OUTCOMES, outcome_of, record
from benchmarks.log_mutations import KINDS, mutate

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
@pytest.mark.parametrize(("state", "count"), [("all", 600), ("keyframes", 400)])
def test_mutated_files_give_data_or_one_clear_error(tmp_path, state, count):
    out = tmp_path / "found.json"
    flags = ["--state", state, "--count", str(count), "--verify-every", "4", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.log_fuzz", *flags],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(out.read_text())
    assert found["bad"] == [], done.stdout + done.stderr
    assert done.returncode == 0
    assert found["memory_mb"] < 1000
    counts = found["outcomes"]
    assert sum(sum(row.values()) for row in counts.values()) == count
    assert all(sum(row[outcome] for outcome in GOOD) == count / 10 for row in counts.values())
    assert counts["cut"]["data"] == counts["lying record length"]["data"] == 0
    assert counts["compression bomb"]["data"] == 0


def test_mutations_are_the_same_every_time_and_change_something(tmp_path):
    data = record(tmp_path / "base.mcap").read_bytes()
    for seed in range(2 * len(KINDS)):
        kind, mutated = mutate(data, seed)
        assert mutate(data, seed) == (kind, mutated)
        if kind not in ("overwritten", "records moved", "forged messages", "forged metadata"):
            assert mutated != data


def test_the_fuzzer_tells_a_traceback_from_a_clear_error(tmp_path, monkeypatch):
    path = record(tmp_path / "base.mcap")
    assert outcome_of(path, everything=True) == ("data", "")
    path.write_bytes(path.read_bytes()[:5000])
    assert outcome_of(path, everything=True)[0] in OUTCOMES[1:3]

    def broken(path):
        raise KeyError("qpos")

    # A reader with a bug, which the fuzzer has to find.
    monkeypatch.setattr("embodichain.recording.inspect", broken)
    outcome, why = outcome_of(path, everything=False)
    assert outcome == "traceback"
    assert "KeyError('qpos')" in why
