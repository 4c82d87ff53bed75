"""`render_page`: a page as one file, with its style and perhaps a script inside.

Its Content-Security-Policy allows this style and this script by their hashes, pictures and films
that are in the page, and nothing else: a name of a run that contains HTML can do nothing, even if
it were not escaped.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["data_url", "render_page"]

_PACKAGE = "embodichain.cli.pages"


def render_page(template: str, context: Mapping[str, Any], *, script: str | None = None) -> str:
    """Return a page as HTML.

    Args:
        template: Name of a template of this folder, which extends `page.html.tmpl`.
        context: Its variables; text is escaped, `Markup` is not.
        script: Name of a script of this folder; None allows none.
    """
    style = _read("page.css")
    source = None if script is None else _read(script)
    page = _templates().get_template(template)
    text = page.render(
        context,
        policy=_policy(style, source),
        style=Markup(style),
        script=None if source is None else Markup(source),
    )
    # Names of files may have bytes that are not UTF-8.
    return text.encode("utf-8", errors="replace").decode("utf-8")


def data_url(content: bytes, kind: str) -> str:
    """Return the address of some content, such as ``image/png``, that is in the page itself."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _policy(style: str, script: str | None) -> str:
    rules = [
        "default-src 'none'",
        f"style-src {_hash(style)}",
        "img-src data:",
        "media-src data:",
        "base-uri 'none'",
        "form-action 'none'",
    ]
    if script is not None:
        rules.append(f"script-src {_hash(script)}")
    return "; ".join(rules)


def _hash(text: str) -> str:
    """The source expression that allows an element with this text and no other."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _read(name: str) -> str:
    """A file of this folder; browsers hash lines that end in a line feed only."""
    text = (resources.files(_PACKAGE) / name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")


@cache
def _templates() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        autoescape=True,
        loader=FunctionLoader(_read),
        lstrip_blocks=True,
        trim_blocks=True,
        undefined=StrictUndefined,
    )
