"""The tree itself: links, changelog, nothing of one machine in it."""

import importlib
import pkgutil
import re
from pathlib import Path

import pytest
import yaml

import embodichain

# Written so that no pattern matches its own source.
REGISTRIES = re.compile(
    r"pypi\.org|pythonhosted\.org|download\.pytorch\.org|npmjs\.(?:org|com)|yarnpkg\.com"
    r"|deb\.debian\.org|archive\.ubuntu\.com|anaconda\.(?:org|com)|crates\.io"
)
MACHINE_PATHS = re.compile(r"(?<![\w.~-])/(?:work|root)/|(?<![\w.~-])/(?:home|Users)/\w|/tmp/\w")


@pytest.fixture(scope="module")
def texts(repo: Path, tracked: dict[str, str]) -> dict[str, str]:
    """Path -> text of every tracked file that is text."""
    found = {}
    for path, mode in tracked.items():
        data = (repo / path).read_bytes() if mode != "120000" else b""
        if b"\0" not in data:
            found[path] = data.decode()
    return found


@pytest.mark.parametrize("link", ["conf", "tasks"])
def test_links_are_committed_as_links(repo: Path, tracked: dict[str, str], link: str) -> None:
    assert tracked[f"embodichain/{link}"] == "120000"
    assert (repo / "embodichain" / link).readlink() == Path("..") / link
    assert (repo / link / "__init__.py").is_file()


def test_package_is_typed(tracked: dict[str, str]) -> None:
    assert "embodichain/py.typed" in tracked


def test_changelog_lists_what_is_unreleased(texts: dict[str, str]) -> None:
    """A commit that makes a release has just moved it under the version's heading."""
    sections = re.split(r"^## ", texts["CHANGELOG.md"], flags=re.MULTILINE)[1:]
    assert sections[0].startswith("[Unreleased]")
    released = sections[1].startswith(f"[{embodichain.__version__}]")
    entries = sections[0] + sections[1] * released
    assert re.search(r"^- \S", entries, re.MULTILINE)


@pytest.mark.parametrize(
    "pattern", [REGISTRIES, MACHINE_PATHS], ids=["registries", "machine paths"]
)
def test_no_file_names_one_machine(texts: dict[str, str], pattern: re.Pattern[str]) -> None:
    hits = [f"{path}: {m[0]}" for path, text in texts.items() for m in pattern.finditer(text)]
    assert hits == []


def test_patterns_find_what_they_are_for() -> None:
    assert REGISTRIES.search("https://" + "pypi" + ".org/simple")
    assert MACHINE_PATHS.search("open('" + "/root" + "/x')")
    assert not MACHINE_PATHS.search("docs/root/x and https://example.com/work/x")


def test_no_name_hides_a_module_of_its_package() -> None:
    """Importing the module would make `from package import name` return the module."""
    found = pkgutil.walk_packages(embodichain.__path__, "embodichain.")
    for name in ["embodichain", *(module.name for module in found if module.ispkg)]:
        package = importlib.import_module(name)
        modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
        assert modules & set(getattr(package, "__all__", ())) == set(), name


def test_configs_are_at_most_100_columns_wide(texts: dict[str, str]) -> None:
    configs = {p: t for p, t in texts.items() if p.startswith("conf/") and p.endswith(".yaml")}
    assert len(configs) > 20
    wide = {p: max(map(len, text.splitlines())) for p, text in configs.items()}
    assert {p: width for p, width in wide.items() if width > 100} == {}


def test_the_citation_is_of_this_version(texts: dict[str, str]) -> None:
    """The keys are those of the Citation File Format 1.2.0."""
    citation = yaml.safe_load(texts["CITATION.cff"])
    assert citation["version"] == embodichain.__version__
    assert citation["license"] == "MIT"
    required = {"cff-version", "message", "title", "authors"}
    optional = {"abstract", "type", "version", "date-released", "license", "keywords"}
    assert required <= set(citation) <= required | optional
    assert all(set(author) == {"name"} for author in citation["authors"])
