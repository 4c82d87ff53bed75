"""Every Python and YAML block in README.md and docs/ works as it is written there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from embodichain.config import resolve

REPO = Path(__file__).parents[2]
PAGES = [REPO / "README.md", *sorted((REPO / "docs").glob("*.md"))]


def blocks(language):
    pattern = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    return [
        pytest.param(text, id=f"{page.name}-{i}")
        for page in PAGES
        for i, text in enumerate(pattern.findall(page.read_text(encoding="utf-8")))
    ]


@pytest.mark.parametrize("code", blocks("python"))
def test_python_runs(code, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("text", blocks("yaml"))
def test_yaml_is_a_task(text, tmp_path):
    """A block is a task file, or some of its sections."""
    assert isinstance(yaml.safe_load(text), dict)
    folder = tmp_path / "mine" / "task"
    folder.mkdir(parents=True)
    (folder / "block.yaml").write_text(text, encoding="utf-8")
    resolved = resolve(["task=block"], "run", tmp_path / "mine")
    assert resolved.task_name == "block"
