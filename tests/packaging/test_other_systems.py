"""macOS and Windows: nothing of Linux is imported there, and what is missing is refused by name.

Neither system is at hand: `tests/helpers/other_system.py` takes from Python what Windows lacks.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from embodichain.utils.system import platforms

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

HELPER = Path(__file__).parents[1] / "helpers" / "other_system.py"
COMMANDS = {
    "list": ["list", "tasks"],
    "validate": ["validate", "task=random_reach", "record=none"],
    "with a log": ["validate", "task=random_reach", "viewer=web"],
    "doctor": ["doctor", "--json"],
}


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, HELPER],
        input=json.dumps(list(COMMANDS.values())),
        cwd=tmp_path_factory.mktemp("windows"),
        capture_output=True,
        text=True,
        check=False,
        timeout=290,
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    return {"failed": report["failed"], **dict(zip(COMMANDS, report["results"], strict=True))}


def test_every_module_is_imported(windows: dict[str, Any]) -> None:
    assert windows["failed"] == {}


@pytest.mark.parametrize("command", ["list", "validate"])
def test_commands_work(windows: dict[str, Any], command: str) -> None:
    assert windows[command]["code"] == 0, windows[command]
    assert "random_reach" in windows[command]["out"]


def test_what_cannot_work_is_refused_by_name(windows: dict[str, Any]) -> None:
    refused = windows["with a log"]
    assert refused["code"] == 2
    assert "record: record=mcap does not work on Windows" in refused["err"]
    assert "viewer: viewer=web does not work on Windows" in refused["err"]
    assert "Instead: record=none" in refused["err"]


def test_doctor_names_what_is_missing(windows: dict[str, Any]) -> None:
    checks = {c["part"]: c for c in json.loads(windows["doctor"]["out"])["checks"]}
    assert checks["system"]["state"] == "warn"
    lacking = [limit for limit in platforms.LIMITS if "win32" in limit.systems]
    assert len(lacking) > 5
    for limit in lacking:
        assert checks[limit.feature]["state"] == "missing"
        assert checks[limit.feature]["advice"] == limit.instead


def test_the_page_names_the_same(repo: Path) -> None:
    text = (repo / "docs" / "install.md").read_text(encoding="utf-8")
    for limit in platforms.LIMITS:
        systems = ", ".join(platforms.LIMITED[system] for system in limit.systems)
        assert f"| `{limit.feature}` | {systems} | {limit.reason} | {limit.instead} |" in text
