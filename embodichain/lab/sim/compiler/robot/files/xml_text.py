"""XML as robot files have it: what MuJoCo's and ROS's parsers read, in the form that expat reads.

MuJoCo's parser (TinyXML-2) is laxer than the standard. Files in use contain two hyphens in a
comment, lines before ``<?xml``, a lone ``&``, bytes of another encoding, or a second closing tag.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from xml.parsers import expat

__all__ = ["XmlError", "parse_xml", "root_tag"]

_MARKUP = re.compile(
    r"(?P<comment><!--.*?-->)|(?P<data><!\[CDATA\[.*?\]\]>)|(?P<declaration><\?.*?\?>)"
    r"|(?P<doctype><![^>\[]*(?:\[.*?\])?[^>]*>)|(?P<tag></?[A-Za-z_](?:\"[^\"]*\"|'[^']*'|[^>\"'])*>)",
    re.DOTALL,
)
_TAG_NAME = re.compile(r"</?([^\s/>]+)")
_ATTRIBUTE = re.compile(r"([^\s=/>\"']+)\s*=\s*(\"[^\"]*\"|'[^']*')", re.DOTALL)
_LONE_AMPERSAND = re.compile(r"&(?!(?:#\d+|#x[0-9A-Fa-f]+|amp|lt|gt|quot|apos);)")
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
_ENCODING = re.compile(rb"<\?xml[^>]*?encoding\s*=\s*[\"']([A-Za-z0-9._-]+)[\"']")


class XmlError(ValueError):
    """A text that is not XML.

    Attributes:
        line: The line of the mistake, from 1.
    """

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


def root_tag(source: bytes) -> str:
    """Return the tag of the root element; an empty string if the text has no element."""
    for markup in _MARKUP.finditer(_decoded(source)):
        if markup["tag"] is not None:
            return _name_of(markup["tag"])
    return ""


def parse_xml(source: bytes) -> tuple[ET.Element, dict[ET.Element, int]]:
    """Return the root of an XML text, and the line of every element, in document order.

    Tags and attributes keep their namespace prefixes. What follows the root element is ignored.

    Raises:
        XmlError: If it is not well-formed.
    """
    builder = ET.TreeBuilder()
    lines: dict[ET.Element, int] = {}
    parser = expat.ParserCreate("utf-8")
    depth = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(_standard(_decoded(source)).encode(), True)
    except expat.ExpatError as error:
        is_complete = bool(lines) and depth == 0
        if not is_complete:
            raise XmlError(str(error).split(":")[0], error.lineno) from error
    return builder.close(), lines


def _decoded(source: bytes) -> str:
    """Return the text in the encoding that it declares; bytes that do not fit become U+FFFD."""
    if source.startswith((b"\xff\xfe", b"\xfe\xff")):
        return source.decode("utf-16", errors="replace")
    declared = _ENCODING.search(source[:200])
    encoding = declared[1].decode() if declared else "utf-8"
    try:
        text = source.decode(encoding, errors="replace")
    except LookupError:  # unknown to Python; tags and numbers are ASCII
        text = source.decode("utf-8", errors="replace")
    return _CONTROL.sub("", text.removeprefix("\ufeff"))


def _standard(text: str) -> str:
    """Return an XML text without what expat refuses; every element keeps its line."""
    pieces: list[str] = []
    depth = 0
    end = 0
    for markup in _MARKUP.finditer(text):
        between = text[end : markup.start()]
        end = markup.end()
        if depth:
            pieces.append(_LONE_AMPERSAND.sub("&amp;", between))
        else:
            pieces.append(_keep_lines(between))
        if markup["data"] is not None:
            pieces.append(markup[0])
            continue
        tag = markup["tag"]
        if tag is None:  # a comment, a declaration
            pieces.append(_keep_lines(markup[0]))
            continue
        pieces.append(_standard_tag(tag))
        if tag.startswith("</"):
            depth -= 1
        elif not tag.endswith("/>"):
            depth += 1
    pieces.append(text[end:])
    return "".join(pieces)


def _keep_lines(text: str) -> str:
    """Return only the line ends of a text."""
    return "\n" * text.count("\n")


def _name_of(tag: str) -> str:
    name = _TAG_NAME.match(tag)
    return name[1] if name else ""


def _standard_tag(tag: str) -> str:
    """Return a tag in whose attributes ``&`` and ``<`` are escaped."""

    def escape(attribute: re.Match[str]) -> str:
        value = _LONE_AMPERSAND.sub("&amp;", attribute[2]).replace("<", "&lt;")
        return f" {attribute[1]}={value}"

    return _ATTRIBUTE.sub(escape, tag)
