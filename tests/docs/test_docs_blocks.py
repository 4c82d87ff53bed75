"""Every Python and YAML block in README.md and docs/ works as it is written there.

A Python block below ``<!-- from FILE -->`` is a part of that file, which another test runs.
"""

import re
from pathlib import Path

import pytest
import yaml

from embodichain.config import resolve
from embodichain.config.study import check_jobs, resolve_study
from tests.helpers.code_blocks import run_forked

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

REPO = Path(__file__).parents[2]
PAGES = [REPO / "README.md", *sorted((REPO / "docs").rglob("*.md"))]
EXCERPT = re.compile(r"^<!-- from (\S+) -->\n```python\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


VARIATION = re.compile(r"^# @package task\.variations\.(\w+)\n")
FILE = re.compile(
    r"^<!-- (\w+\.(?:py|xml)) -->\n```(?:python|xml)\n(.*?)^```", re.MULTILINE | re.DOTALL
)


def blocks(language, *, with_page=False):
    pattern = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    return [
        pytest.param(*((text, page) if with_page else (text,)), id=f"{page.relative_to(REPO)}-{i}")
        for page in PAGES
        for i, text in enumerate(pattern.findall(EXCERPT.sub("", page.read_text(encoding="utf-8"))))
    ]


ALONE = re.compile(r"^(?!.*outputs/latest)", re.DOTALL)  # the others need a run: test_docs_commands


@pytest.mark.parametrize("code", [code for code in blocks("python") if ALONE.match(code.values[0])])
def test_python_runs(code, tmp_path):
    folder = tmp_path / "block"
    folder.mkdir()
    status, said = run_forked(code, folder)
    assert status == 0, said


def test_a_block_that_fails_shows_its_traceback(tmp_path):
    folder = tmp_path / "block"
    folder.mkdir()
    status, said = run_forked("import torch\n\nraise ValueError('mine')", folder)
    assert status == 1 and 'block.py", line 3' in said and "ValueError: mine" in said


def write_option(folder, group, name, text):
    (folder / group).mkdir(parents=True)
    (folder / group / f"{name}.yaml").write_text(text, encoding="utf-8")


@pytest.mark.parametrize(("text", "page"), blocks("yaml", with_page=True))
def test_yaml_is_a_task(text, page, tmp_path, monkeypatch):
    """A block is a task file, or some of its sections; it may name the page's own files.

    One that begins as a variation does is one, of a shipped task; one with arms is a study.
    """
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    for name, code in FILE.findall(page.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(code, encoding="utf-8")
    assert isinstance(yaml.safe_load(text), dict)
    variation = VARIATION.match(text)
    if variation:
        write_option(tmp_path / "mine", "variation", variation[1], text)
        lines = ["task=push_cube", f"variation={variation[1]}"]
        resolved = resolve(lines, "run", tmp_path / "mine")
        task = resolve(["task=push_cube"], "run").tree["task"]
        for section in yaml.safe_load(text).keys() & {"events", "actions", "observations"}:
            assert resolved.tree["task"][section] != task[section]
        return
    if "arms" in yaml.safe_load(text):
        write_option(tmp_path / "conf", "study", "block", text)
        check_jobs(resolve_study("block"))
        return
    write_option(tmp_path / "mine", "task", "block", text)
    resolved = resolve(["task=block"], "run", tmp_path / "mine")
    assert resolved.task_name == "block"


def test_excerpts_are_in_their_files():
    found = [
        (page, *excerpt)
        for page in PAGES
        for excerpt in EXCERPT.findall(page.read_text(encoding="utf-8"))
    ]
    assert len(found) > 5
    for page, name, code in found:
        text = (REPO / name).read_text(encoding="utf-8")
        same = "".join(code.split()) in "".join(text.split())  # lines break where there is room
        assert same, f"{page.name}: not in {name}:\n{code}"
