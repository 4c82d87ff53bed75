"""Hooks of MkDocs: pages read the same on GitHub and on the site.

Markdown in docs/ links to files of the repository with relative paths, as GitHub needs them. The
site has what such links name: Markdown as pages, everything else as a file below ``repository/``.
Notebooks are executed and become pages.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import notebook_pages
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify

REPO = Path(__file__).parents[2]
DOCS = REPO / "docs"
ROOT_PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
"""Markdown in the root of the repository that is a page of the site, under the same name."""
REPOSITORY = "repository"
"""Folder of the site with files from outside of docs/ that pages link to."""
UNLISTED = "How to"
"""Section of the navigation that pages are appended to which mkdocs.yml does not name."""
LINK = re.compile(r"(?P<before>\]\()(?P<path>(?!\w+:)[^)#\s]+)(?P<anchor>#[^)\s]*)?(?=\))")
CODE = re.compile(r"^(?P<fence>```+|~~~+).*?^(?P=fence)\s*$|`[^`\n]+`", re.MULTILINE | re.DOTALL)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Make the anchors of headings those of GitHub."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add pages and files from outside of docs/, and complete the navigation."""
    for source in ROOT_PAGES:
        text = (REPO / source).read_text(encoding="utf-8")
        files.append(File.generated(config, source, content=_from_root(text)))
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        files.remove(file)
        made = notebook_pages.convert(Path(str(file.abs_src_path)))
        page = posixpath.splitext(file.src_uri)[0]
        files.append(File.generated(config, f"{page}.md", content=made.markdown))
        for name, data in made.images.items():
            folder = posixpath.dirname(file.src_uri)
            files.append(File.generated(config, posixpath.join(folder, name), content=data))
    for target in sorted(_linked_outside(files)):
        path = REPO / target
        uri = f"{REPOSITORY}/{target}"
        files.append(File.generated(config, uri, abs_src_path=str(path)))
    _complete(config, files)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links to what the site has of the repository."""
    return _outside_code(markdown, lambda text: LINK.sub(_resolve(page.file.src_uri), text))


def _outside_code(text: str, change: Any) -> str:
    """Text with a change to all but fenced blocks and code spans."""
    kept: list[str] = []
    start = 0
    for match in CODE.finditer(text):
        # Code spans may be the text of a link: they are kept, the brackets around them changed.
        kept += [change(text[start : match.start()]), match[0]]
        start = match.end()
    return "".join([*kept, change(text[start:])])


def _resolve(uri: str) -> Any:
    """A replacement of links in the page at `uri`."""

    def replace(match: re.Match[str]) -> str:
        path = match["path"]
        target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(uri), path))
        if path.endswith(".ipynb"):
            path = f"{path.removesuffix('.ipynb')}.md"
        elif not target.startswith("docs/"):
            absolute = "index.md" if target == "README.md" else target
            if absolute not in ("index.md", *ROOT_PAGES):
                absolute = f"{REPOSITORY}/{target}"
            path = posixpath.relpath(absolute, posixpath.dirname(uri) or ".")
        return f"{match['before']}{path}{match['anchor'] or ''}"

    return replace


def _from_root(text: str) -> str:
    """Markdown of the repository's root, with links as from docs/."""

    def replace(match: re.Match[str]) -> str:
        path = posixpath.relpath(match["path"], "docs")
        return f"{match['before']}{path}{match['anchor'] or ''}"

    return _outside_code(text, lambda part: LINK.sub(replace, part))


def _linked_outside(files: Files) -> set[str]:
    """Files of the repository, outside of docs/, that pages link to; paths from its root."""
    found = set()
    for file in files.documentation_pages():
        folder = posixpath.join("docs", posixpath.dirname(file.src_uri))
        text = CODE.sub("`", file.content_string)
        for match in LINK.finditer(text):
            target = posixpath.normpath(posixpath.join(folder, match["path"]))
            outside = not target.startswith("docs/") and not target.startswith("..")
            if outside and not target.endswith(".md") and (REPO / target).is_file():
                found.add(target)
    return found


def _complete(config: MkDocsConfig, files: Files) -> None:
    """Append pages that the navigation does not name to a section of it."""
    listed = set(_pages(config.nav))
    rest = [f.src_uri for f in files.documentation_pages() if f.src_uri not in listed]
    section = next(item[UNLISTED] for item in config.nav or () if UNLISTED in item)
    section += sorted(rest)


def _pages(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    items = nav.values() if isinstance(nav, dict) else nav
    return [page for item in items for page in _pages(item)]
