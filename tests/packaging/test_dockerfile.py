"""The Dockerfile, read by `scripts/dockerfile_steps.py`, and what its build context contains.

Whole builds need Docker, or root, a network and minutes: docs/releases.md says what was tried.
"""

import re
from pathlib import Path

import pytest

from scripts import dockerfile_steps
from scripts.dockerfile_steps import Step


@pytest.fixture(scope="module")
def steps(repo: Path) -> list[Step]:
    return dockerfile_steps.steps((repo / "Dockerfile").read_text(encoding="utf-8"))


def test_the_image_runs_the_command_as_a_user(steps: list[Step]) -> None:
    last = steps[max(i for i, step in enumerate(steps) if step.word == "FROM") :]
    words = [step.word for step in last]
    assert '["embodichain"]' in [step.text for step in last if step.word == "ENTRYPOINT"]
    (user,) = [step.text for step in last if step.word == "USER"]
    assert user != "root"
    assert f" {user} " in "".join(step.text for step in last if step.word == "RUN")  # it is made
    assert words.index("USER") > max(i for i, word in enumerate(words) if word == "RUN")


def test_both_stages_are_the_same_slim_debian(steps: list[Step]) -> None:
    bases = [step.text.split()[0] for step in steps if step.word == "FROM"]
    assert len(bases) == 2
    (base,) = set(bases)
    assert re.fullmatch(r"debian:12-slim@sha256:[0-9a-f]{64}", base)


def test_the_image_has_what_the_makefiles_system_has(steps: list[Step], repo: Path) -> None:
    script = (repo / "scripts" / "system_deps.sh").read_text()
    (listed,) = re.findall(r"for package in (.*) \$more", script)
    installs = [s.text for s in steps if s.word == "RUN" and "apt-get install" in s.text]
    assert set(listed.split()) <= set(installs[-1].split())


def test_every_package_has_a_hash_but_our_own(steps: list[Step]) -> None:
    locked = [s.text for s in steps if s.word == "RUN" and "/pins/scripts/locked.py" in s.text]
    assert [text.partition("locked.py ")[2] for text in locked] == [
        "install --only build,setuptools",
        'install --extra "$EXTRAS" --torch-index "$TORCH_INDEX"',
    ]
    (pip,) = [s.text for s in steps if s.word == "RUN" and "pip install" in s.text]
    assert " --no-deps /dist/*.whl && " in pip
    assert pip.endswith("pip check")  # the wheel misses nothing that is not in locked.txt


def test_the_context_is_what_the_wheel_is_made_of(repo: Path, tracked: dict[str, str]) -> None:
    ignored = (repo / ".dockerignore").read_text(encoding="utf-8")
    found = {path.as_posix() for path in dockerfile_steps.context(repo, ignored)}
    folders = ("embodichain/", "conf/", "tasks/")
    wanted = {path for path in tracked if path.startswith(folders)}
    assert wanted <= found
    files = {path for path in found if not path.startswith(folders)}
    assert files == {
        *("pyproject.toml", "locked.txt", "MANIFEST.in", "scripts/locked.py"),
        *("README.md", "CHANGELOG.md", "LICENSE"),
    }
    assert not any("__pycache__" in path for path in found)


def test_an_unknown_instruction_is_named() -> None:
    assert dockerfile_steps.steps("# a\n\nRUN make  it\n") == [Step("RUN", "make  it", 3)]
    with pytest.raises(ValueError, match="line 2: 'HEALTHCHECK' is not known here"):
        dockerfile_steps.steps("FROM a\nHEALTHCHECK NONE\n")


def test_steps_cannot_write_to_this_machine(tmp_path: Path) -> None:
    """An installation script inside would regenerate, say, this machine's certificates."""
    shown = tmp_path / "shown"
    mounts = dockerfile_steps.mounts(tmp_path / "root", [shown])
    place = f"{tmp_path}/root{shown}"
    assert mounts[-2:] == [f"mount --bind {shown} {place}", f"mount -o remount,bind,ro {place}"]
    bound = {line.split()[2] for line in mounts if line.startswith("mount --bind")}
    assert bound - {str(shown)} == {"/dev/null", "/dev/zero", "/dev/random", "/dev/urandom"}
