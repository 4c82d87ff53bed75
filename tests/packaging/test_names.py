"""No public name disappears unnoticed: `scripts/names.py` and its list."""

import re
from pathlib import Path

import pytest

from scripts import names

pytestmark = pytest.mark.slow

LOG = """
## [Unreleased]

### Changed

- `choice task=reach` is `reach_near`.

### Removed

- `--quiet` of `run`, `Log.frames`; use `--silent`.

### Fixed

- `sim.threads` was ignored.

## [0.1.0] - 2026-01-01

### Removed

- `sim.old`.
"""


@pytest.mark.unmeasured
def test_no_name_is_gone_that_the_changelog_does_not_name(repo: Path) -> None:
    """After a removal: an entry in CHANGELOG.md, then `make names`."""
    old = names.LIST.read_text(encoding="utf-8").splitlines()
    now = names.all_names()
    changelog = (repo / "CHANGELOG.md").read_text(encoding="utf-8")
    assert names.unannounced(old, now, changelog) == []
    assert len(old) > 3000
    for line in (
        "python embodichain.make(task, num_envs=, overrides=, *, render_mode=, config_dir=)",
        "option replay --verify",
        "key task.rewards.*.weight",
        "key sim.num_threads",
        "choice task=random_reach",
        "term rewards distance(*, to, from=)",
        "verb run",
    ):
        kind = line.partition("(")[0]
        assert any(name == line or name.startswith(f"{kind}(") for name in now), line


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("python a.f(x)", "python a.g(x)", "is gone"),
        ("python a.f(x)", "python a.f", "is not called any more"),
        ("python a.f(x, y=)", "python a.f(x)", "has no parameter 'y' any more"),
        ("python a.f(x=)", "python a.f(x)", "needs 'x' now"),
        ("python a.f(x)", "python a.f(x, y)", "needs 'y' now"),
        ("python a.f(x)", "python a.f(x, *, y)", "needs 'y' now"),
        ("python a.f(x, y)", "python a.f(y, x)", "has other positional parameters, or another ord"),
        ("python a.f(x)", "python a.f(*, x)", "has other positional parameters, or another order"),
        ("python a.f(x)", "python a.f(y=, x=)", "has other positional parameters, or another ord"),
        ("python a.f(x)", "python a.f(x, y=, *, z=)", ""),
        ("python a.f(x, *, z=)", "python a.f(x, z=)", ""),
        ("python a.f(x, *, z=)", "python a.f(x, **more)", ""),
        ("python a.f(x)", "python a.f(*args, **more)", ""),
        ("python a.f()", "python a.f()", ""),
        ("key sim.a", "key sim.a", ""),
        ("term rewards d(*, to)", "term rewards d(*, from=, to)", ""),
        ("term rewards d(*, to)", "term rewards d(*, to_entity)", "has no parameter 'to' any more"),
    ],
)
def test_breaks(old: str, new: str, why: str) -> None:
    found = names.breaks([old], [new, "verb added"])
    assert [*found] == ([re.sub(r"\(.*", "", old)] if why else [])
    assert all(text.startswith(why) for text in found.values())


def test_the_changelog_announces_in_its_unreleased_part_only() -> None:
    assert names.announced(LOG) == {
        *("choice task=reach", "reach_near", "--quiet", "run", "Log.frames", "--silent")
    }
    old = [
        "choice task=reach",
        "option run --quiet",
        "key sim.threads",
        "key sim.old",
        "python embodichain.recording.Log.frames(x)",
    ]
    assert names.unannounced(old, ["verb run"], LOG) == [
        "key sim.threads is gone",
        "key sim.old is gone",
        "python embodichain.recording.Log.frames is gone",
    ]


def test_a_malformed_list_is_an_error() -> None:
    with pytest.raises(ValueError, match="not a line of the list: ''"):
        names.breaks([""], [])


def test_what_the_docs_import_is_public(repo: Path) -> None:
    texts = [path.read_text(encoding="utf-8") for path in (repo / "docs").glob("*.md")]
    imported = re.findall(r"^from (embodichain[\w.]*) import ([^\n#(]+)$", "\n".join(texts), re.M)
    listed = names.LIST.read_text(encoding="utf-8")
    public = set(re.findall(r"^python (embodichain[\w.]*)", listed, re.M))
    wanted = {f"{m}.{n.split(' as ')[0].strip()}" for m, ns in imported for n in ns.split(",")}
    assert len(wanted) > 10
    assert wanted - public == set()
