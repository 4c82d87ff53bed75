"""`scripts/release.py`: what it refuses, and what it writes; test_distributions has the builds."""

import subprocess
from pathlib import Path

import pytest

from scripts import release

pytestmark = pytest.mark.slow

LOG = """\
# Changelog

## [Unreleased]

### Added

- A thing.

## [0.1.0] - 2026-01-01

### Tasks

- One.
"""
SOURCE = '"""The package."""\n\n__version__ = "0.1.0"\n'


CITATION = "cff-version: 1.2.0\nversion: 0.1.0\ntitle: a\n"


class Checkout:
    """A repository with what a release looks at."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "embodichain").mkdir(parents=True)
        self.write("embodichain/__init__.py", SOURCE)
        self.write("CHANGELOG.md", LOG)
        self.write("CITATION.cff", CITATION)
        self.git("init", "-q")
        self.commit()

    def write(self, name: str, text: str) -> None:
        (self.root / name).write_text(text, encoding="utf-8")

    def git(self, *arguments: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        subprocess.run(["git", "-C", self.root, *who, *arguments], check=True)

    def commit(self) -> None:
        self.git("add", "-A")
        self.git("commit", "-q", "-m", "state")

    def run(self, *arguments: str) -> int:
        return release.main([*arguments, "--root", str(self.root)])


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path / "checkout")


def test_unreleased_entries_become_a_dated_section(checkout: Checkout) -> None:
    assert checkout.run("prepare", "0.2.0rc1", "--date", "2026-02-03") == 0
    assert (checkout.root / "CHANGELOG.md").read_text() == LOG.replace(
        "## [Unreleased]\n", "## [Unreleased]\n\n## [0.2.0rc1] - 2026-02-03\n"
    )
    assert release.version_of(checkout.root) == "0.2.0rc1"
    assert (checkout.root / "CITATION.cff").read_text() == (
        "cff-version: 1.2.0\ntitle: a\nversion: 0.2.0rc1\ndate-released: 2026-02-03\n"
    )


def test_they_join_a_section_that_was_never_tagged(checkout: Checkout) -> None:
    assert checkout.run("prepare", "0.1.0", "--date", "2026-02-03") == 0
    text = (checkout.root / "CHANGELOG.md").read_text()
    assert text == (
        "# Changelog\n\n## [Unreleased]\n\n## [0.1.0] - 2026-02-03\n\n"
        "### Added\n\n- A thing.\n\n### Tasks\n\n- One.\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["0.2"], "'0.2' is not MAJOR.MINOR.PATCH"),
        (["0.2.0", "--date", "today"], "'today' is not YYYY-MM-DD"),
        (["0.1.0"], "v0.1.0 is tagged already"),
    ],
)
def test_wrong_versions_are_refused_and_nothing_is_written(
    checkout: Checkout,
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    checkout.git("tag", "v0.1.0")
    assert checkout.run("prepare", *arguments) == 2
    assert message in capsys.readouterr().err
    assert (checkout.root / "CHANGELOG.md").read_text() == LOG


def test_an_empty_release_is_refused(
    checkout: Checkout, capsys: pytest.CaptureFixture[str]
) -> None:
    checkout.write("CHANGELOG.md", LOG.replace("- A thing.\n", ""))
    assert checkout.run("prepare", "0.2.0") == 2
    assert "nothing is listed under '## [Unreleased]'" in capsys.readouterr().err


def test_only_a_clean_commit_is_built(
    checkout: Checkout, capsys: pytest.CaptureFixture[str]
) -> None:
    assert release.check(checkout.root) is None
    checkout.write("new.py", "")
    assert checkout.run("build", "--out", str(checkout.root / "dist")) == 2
    assert capsys.readouterr().err == "error: not committed: new.py\n"
    assert not (checkout.root / "dist").exists()


def test_tag_version_and_heading_agree(checkout: Checkout) -> None:
    with pytest.raises(release.ReleaseError, match=r"not have the tag v0\.1\.0 \(it has: none"):
        release.check(checkout.root, "v0.1.0")
    checkout.git("tag", "v0.1.0")
    assert release.check(checkout.root) == release.check(checkout.root, "v0.1.0") == "v0.1.0"

    checkout.write("CHANGELOG.md", LOG.replace("## [0.1.0] - 2026-01-01", "## [0.1.0]"))
    checkout.commit()
    checkout.git("tag", "-f", "v0.1.0")
    with pytest.raises(release.ReleaseError, match="no dated heading"):
        release.check(checkout.root)

    checkout.write("CITATION.cff", CITATION.replace("0.1.0", "0.0.9"))
    checkout.commit()
    checkout.git("tag", "-f", "v0.1.0")
    with pytest.raises(release.ReleaseError, match=r"CITATION.cff does not have version: 0.1.0"):
        release.check(checkout.root)

    checkout.write("embodichain/__init__.py", SOURCE.replace("0.1.0", "0.1.1"))
    checkout.commit()
    checkout.git("tag", "v0.1.2")
    with pytest.raises(release.ReleaseError, match=r"the tag is v0\.1\.2, .* has 0\.1\.1"):
        release.check(checkout.root)
