"""Relative links in Markdown and notebooks lead somewhere on GitHub, anchors included."""

import json
import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest

REPO = Path(__file__).parents[2]
DOCS = REPO / "docs"
PAGES = [*REPO.glob("*.md"), *DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]


def slug(heading: str) -> str:
    """The anchor that GitHub makes of a heading."""
    plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
    return re.sub(r"[^\w\- ]", "", plain.strip().lower()).replace(" ", "-")


def prose(path: Path) -> str:
    """Markdown without its code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return re.sub(r"^(```+).*?^\1\s*?$|`[^`\n]*`", "`", text, flags=re.MULTILINE | re.DOTALL)


def anchors(path: Path) -> set[str]:
    text = re.sub(r"^(```+).*?^\1\s*?$", "", path.read_text("utf-8"), flags=re.M | re.S)
    return {slug(heading) for heading in re.findall(r"^#+ (.*)", text, re.MULTILINE)}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(REPO)))
def test_links_lead_somewhere_on_github(path: Path) -> None:
    for address in re.findall(r"\]\(([^)\s]+)\)", prose(path)):
        parts = urlsplit(address)
        if parts.scheme:
            continue
        target = (path.parent / parts.path).resolve() if parts.path else path
        assert target.exists(), address
        if parts.fragment and target.suffix == ".md":
            assert parts.fragment in anchors(target), address
