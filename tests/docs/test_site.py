"""The documentation site is built without a warning, complete, and works in a browser, offline."""

import fcntl
import functools
import http.server
import importlib
import json
import os
import re
import subprocess
import sys
import threading
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import unquote, urlsplit

import pytest
from mkdocs.config import load_config
from mkdocs.structure.files import File, Files

from embodichain.compat.unavailable import CLASSES
from tests.helpers.browser import chromium, needs_chromium

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow, pytest.mark.timeout(900)]

REPO = Path(__file__).parents[2]
DOCS = REPO / "docs"
SOURCES = [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]
PACKAGES = (
    "embodichain.learning",
    "embodichain.recording",
    "embodichain.lab.gym.envs",
    "embodichain.lab.sim",
    "embodichain.lab.sim.objects",
    "embodichain.lab.sim.sensors",
)
"""Packages whose public names the API reference has."""
NOT_DESCRIBED = {"AnySensorCfg", "EmbodiedEnv", *CLASSES}
"""A union, EmbodiChain's name of `BaseEnv`, and what raises an error."""


class Html(HTMLParser):
    """What a page links to, what it loads, its anchors, and its text outside of code."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.ids: set[str] = set()
        self.text: list[str] = []
        self._code = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids |= {value for key in ("id", "name") if (value := found.get(key))}
        self._code += tag in ("code", "pre", "script", "style")
        if tag == "a" and (address := found.get("href")):
            self.links.append(address)
        elif tag in ("img", "script", "link", "source", "iframe"):
            self.loaded += [value for key in ("src", "href") if (value := found.get(key))]

    def handle_endtag(self, tag: str) -> None:
        self._code -= tag in ("code", "pre", "script", "style")

    def handle_data(self, data: str) -> None:
        if not self._code:
            self.text.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site as `make docs` builds it, notebooks executed; and its pages.

    Workers of pytest-xdist share it: the first one builds it, the others wait.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    with open(f"{folder}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            build(folder)
    pages = {
        path.relative_to(folder).as_posix(): Html(path.read_text(encoding="utf-8"))
        for path in folder.rglob("*.html")
    }
    return SimpleNamespace(folder=folder, pages=pages)


def build(folder: Path) -> None:
    unfinished = folder.with_suffix(".new")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    done = subprocess.run(
        [*command, "-f", str(DOCS / "site" / "mkdocs.yml"), "-d", str(unfinished)],
        cwd=REPO,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr, done.stderr
    unfinished.rename(folder)


def test_every_page_is_in_the_navigation(site) -> None:
    expected = {path.relative_to(DOCS).with_suffix(".html").as_posix() for path in SOURCES}
    expected |= {"CHANGELOG.html", "CONTRIBUTING.html", "SECURITY.html"}
    made = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.html")}
    assert expected == site.pages.keys() - {"404.html"} - made
    linked = {urlsplit(link).path for link in Html(_nav(site.folder / "index.html")).links}
    assert expected - linked == set()


def _nav(page: Path) -> str:
    pattern = r'<nav class="md-nav md-nav--primary.*?</nav>\s*</div>'
    found = re.search(pattern, page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[0]


def test_links_and_anchors_lead_somewhere(site) -> None:
    broken = []
    for name, page in site.pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme in ("http", "https", "mailto") or name == "404.html":
                continue
            target = (site.folder / name).parent / unquote(parts.path) if parts.path else None
            path = (target or site.folder / name).resolve()
            inside = path.relative_to(site.folder.resolve()).as_posix()
            if not path.is_file():
                broken.append(f"{name}: {link}")
                continue
            ids = site.pages[inside].ids if inside in site.pages else set()
            if ids and parts.fragment and unquote(parts.fragment) not in ids:
                broken.append(f"{name}: {link}")
    assert broken == []


def test_pages_load_nothing_from_other_hosts(site) -> None:
    for name, page in site.pages.items():
        for address in page.loaded:
            assert not urlsplit(address).netloc, f"{name}: {address}"
            if name != "404.html":
                file = (site.folder / name).parent / unquote(urlsplit(address).path)
                assert file.is_file(), f"{name}: {address}"


def test_markdown_is_rendered(site) -> None:
    """Python-Markdown and GitHub agree on it: no table, list or fence is left as text."""
    left = re.compile(r"^\s*\|.*\|\s*$|^\s*```|\]\([\w./#-]+\)|^\s*[*-] \w", re.MULTILINE)
    for name, page in site.pages.items():
        assert left.findall("".join(page.text)) == [], name


def test_notebooks_show_what_they_computed(site) -> None:
    for path in DOCS.rglob("*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") for cell in cells), "outputs are made by the build"
        text = (site.folder / path.relative_to(DOCS).with_suffix(".html")).read_text("utf-8")
        assert "are identical to the bit" in text  # printed by `verify`
        assert '<table border="1" class="dataframe">' in text
        assert len(re.findall(rf'<img [^>]*src="{path.stem}_\d+\.png"', text)) >= 2
    training = (site.folder / "notebooks" / "training.html").read_text("utf-8")
    assert re.search(r'<img [^>]*src="training_\d+\.gif"', training)


@pytest.mark.parametrize("package", PACKAGES)
def test_api_reference_has_what_users_import(site, package: str) -> None:
    names = set(importlib.import_module(package).__all__) - NOT_DESCRIBED
    api = set().union(*(page.ids for name, page in site.pages.items() if name.startswith("api/")))
    found = {anchor.rpartition(".")[2] for anchor in api if anchor.startswith("embodichain.")}
    assert names - found == set()


def test_raw_figures_are_beside_the_page_of_performance(site) -> None:
    linked = [link for link in site.pages["performance.html"].links if link.endswith(".json")]
    assert len(linked) > 5
    for link in linked:
        assert json.loads((site.folder / link).read_text(encoding="utf-8"))


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None: ...


@needs_chromium
def test_pages_in_a_browser(site) -> None:
    """No error on the console, no request to another host, and the search finds a page."""
    handler = functools.partial(Quiet, directory=str(site.folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    origin = f"http://127.0.0.1:{server.server_port}/"
    requests: list[str] = []
    errors: list[str] = []

    def watch(page) -> None:
        page.on("request", lambda request: requests.append(request.url))
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: errors.append(str(error)))

    try:
        with chromium(watch) as visit:
            page = visit(f"{origin}index.html", 1200, 800)
            for name in ("tutorials/basic-environment", "terms", "api/scenes", "architecture"):
                page.goto(f"{origin}{name}.html")
                assert page.locator("h1").inner_text(timeout=60_000)
                width = page.evaluate("document.documentElement.scrollWidth")
                assert width <= 1200, f"{name} is wider than the window"
            page.fill(".md-search__input", "operational_space", timeout=60_000)
            result = page.locator(".md-search-result__item a").first
            result.wait_for(state="visible", timeout=200_000)
            assert "/terms.html" in result.get_attribute("href")
    finally:
        server.shutdown()
    assert errors == []
    assert [url for url in requests if not url.startswith((origin, "data:"))] == []
    assert f"{origin}search/search_index.json" in requests


@needs_chromium
@pytest.mark.parametrize("width", [1400, 400])
def test_the_search_works_in_pages_opened_from_disk(site, width: int) -> None:
    failures: list[str] = []

    def watch(page) -> None:
        page.on("pageerror", lambda error: failures.append(str(error)))
        page.on("requestfailed", lambda request: failures.append(request.url))

    with chromium(watch) as visit:
        page = visit((site.folder / "tasks" / "reach.html").as_uri(), width, 900)
        if width == 400:  # the field is behind an icon
            page.click("label.md-header__button[for=__search]", timeout=60_000)
        else:
            page.click(".md-search__input", timeout=60_000)
        page.fill(".md-search__input", "operational_space", timeout=60_000)
        page.press(".md-search__input", "Space")  # the field may have been filled before it listens
        result = page.locator(".md-search-result__item a").first
        result.wait_for(timeout=60_000)
        address = result.get_attribute("href")
    assert address.startswith("file:") and address.partition("?")[0].endswith(".html")
    assert failures == []


def test_a_page_without_a_place_is_appended_to_the_guides(monkeypatch, tmp_path) -> None:
    monkeypatch.syspath_prepend(DOCS / "site")
    hooks = importlib.import_module("hooks")
    try:
        config = load_config(str(DOCS / "site" / "mkdocs.yml"), site_dir=str(tmp_path))
        uris = ("cli.md", "new/page.md")
        files = [File(uri, str(DOCS), str(tmp_path), use_directory_urls=False) for uri in uris]
        # The hook that MkDocs calls in `on_files`, without a site to build.
        hooks._complete(config, Files(files))
    finally:
        for name in ("hooks", "notebook_pages"):
            sys.modules.pop(name, None)
    guides = next(section["How to"] for section in config.nav if "How to" in section)
    assert guides[-1] == "new/page.md"
    assert "cli.md" not in guides
