"""Notebooks as pages: executed by nbclient, with their outputs, as Markdown and images."""

from __future__ import annotations

import base64
import os
import re
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.exceptions import PluginError
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

TIMEOUT = 120
"""Seconds that a cell may take."""
SKIP = "DOCS_NOTEBOOKS"
"""Environment variable that leaves out the execution if it is 0: for drafts of pages."""
ANSI = re.compile(r"\x1b\[[0-9;]*m")
"""Colours of terminals."""
SHELL = "%%bash\n"
"""First line of a cell that is run by the shell."""
STYLE = re.compile(r"<style scoped>.*?</style>\s*", re.DOTALL)
"""What pandas puts before a table."""
_made: dict[bytes, NotebookPage] = {}


@dataclass
class NotebookPage:
    """A notebook that was executed.

    Attributes:
        markdown: The page.
        images: Name -> PNG or GIF that the page shows, in the same folder.
    """

    markdown: str
    images: dict[str, bytes] = field(default_factory=dict)


def convert(path: Path) -> NotebookPage:
    """Execute a notebook in an empty folder, and write it as a page.

    What was made of a notebook is kept until it changes, so that `mkdocs serve` executes it once.

    Raises:
        PluginError: If a cell raises, or takes longer than `TIMEOUT`; MkDocs prints it.
    """
    source = path.read_bytes()
    if source not in _made:
        notebook = nbformat.reads(source.decode(), as_version=4)
        try:
            if os.environ.get(SKIP) != "0":
                _execute(notebook)
        except (CellExecutionError, CellTimeoutError) as error:
            raise PluginError(f"{path.name}: {ANSI.sub('', str(error))}") from error
        _made[source] = _page(notebook, path.stem)
    return _made[source]


def _execute(notebook: Any) -> None:
    """Run all cells; shell cells find the commands of this interpreter's environment."""
    tools = Path(sys.executable).parent
    environment = {**os.environ, "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=TIMEOUT,
            kernel_name="python3",
            extra_arguments=["--log-level=ERROR"],  # no warning about the local port
            resources={"metadata": {"path": folder}},
        )
        client.execute(env=environment)


def _page(notebook: Any, name: str) -> NotebookPage:
    page = NotebookPage("")
    parts: list[str] = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        elif cell.cell_type == "code":
            language = "bash" if cell.source.startswith(SHELL) else "python"
            parts.append(f"```{language}\n{cell.source.removeprefix(SHELL)}\n```")
            outputs = _merged(cell.outputs)
            parts += _joined([_output(output, page, name) for output in outputs])
    page.markdown = "\n\n".join(part for part in parts if part) + "\n"
    return page


def _merged(outputs: list[Any]) -> list[Any]:
    """Outputs, with the parts of a stream that follow each other as one."""
    found: list[Any] = []
    for output in outputs:
        last = found[-1] if found else {}
        if output.output_type == "stream" and last.get("name") == output.name:
            last.text += output.text
        else:
            found.append(output)
    return found


def _joined(outputs: list[str]) -> list[str]:
    found = [output for output in outputs if output]
    return ['<div class="output" markdown>', *found, "</div>"] if found else []


def _output(output: Any, page: NotebookPage, name: str) -> str:
    """One output; of several forms the richest one that a page can show."""
    if output.output_type == "stream":
        return _text(output.text)
    data = output.get("data", {})
    for kind in ("png", "gif"):
        if f"image/{kind}" in data:
            file = f"{name}_{len(page.images)}.{kind}"
            page.images[file] = base64.b64decode(data[f"image/{kind}"])
            return f"![Output of the cell above]({file})"
    if "text/html" in data:
        return STYLE.sub("", data["text/html"])
    return _text(data.get("text/plain", ""))


def _text(text: str) -> str:
    plain = ANSI.sub("", text).strip("\n")
    return f"```text\n{plain}\n```" if plain.strip() else ""
