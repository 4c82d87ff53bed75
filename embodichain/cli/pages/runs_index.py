"""`page_of_runs`: the page of a folder of runs, to sort, search and compare them.

The table is whole without the script, which sorts it, searches it, and draws the comparison of two
runs from the data that is in the page.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from embodichain.cli.pages.headline import Result, headline
from embodichain.cli.pages.page import render_page
from embodichain.cli.pages.run_page import fact_rows
from embodichain.cli.pages.run_record import (
    EVALUATION,
    RunRecord,
    named_damage,
    read_json,
    read_record,
)
from embodichain.cli.pages.thumbnails import Thumbnail, Thumbnails
from embodichain.cli.terminal.output import to_json
from embodichain.config.composition.locate import display_path
from embodichain.config.run_folder import CONFIG, STUDY, SUMMARY, SWEEP, whole_run
from embodichain.utils.errors import ConfigError

__all__ = ["page_of_runs", "runs_in", "studies_in"]

_REPORT = "report.html"
_RUN_FILES = ("overrides.yaml", "versions.json", SUMMARY, EVALUATION)
"""One of these is beside the config of a run; a `config.yaml` alone may be anything."""
_MOST_POINTS = 120
"""Points of a curve for the comparison."""
_IGNORED_KEYS = frozenset({"output_dir", "quiet", "json", "traceback"})
"""Keys of a config that change nothing of a run."""
_HIDDEN_WORDS = ("-", "json=", "quiet=", "task=")
"""How words of a command begin that are not shown: the task has its own place."""


@dataclass(frozen=True, slots=True)
class Compared:
    """What two runs are compared by.

    Attributes:
        config: Key path and value of each leaf of the config.
        results: Names and values.
        curves: Title -> ``x``, ``y`` and ``label`` of the x-axis.
    """

    config: Sequence[tuple[str, str]] = ()
    results: Sequence[tuple[str, str]] = ()
    curves: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class IndexRow:
    """A run in the table.

    Attributes:
        record: The run; None if its files are damaged.
        name: Its folder below that of the index.
        link: Address of its report; empty if it has none.
        whole: ``study`` or ``sweep``, what it is a job of; empty if that has no page.
        whole_link: Address of that page.
        about: What was typed, without the task.
        begun: When it began; empty if damaged.
        problem: What is damaged.
        results: Name -> result of `headline`.
        thumbnail: Its picture, if there is one.
        compared: What it is compared by.
    """

    record: RunRecord | None
    name: str
    link: str
    whole: str = ""
    whole_link: str = ""
    about: str = ""
    begun: str = ""
    problem: str = ""
    results: Mapping[str, Result] = field(default_factory=dict)
    thumbnail: Thumbnail | None = None
    compared: Compared | None = None


@dataclass(frozen=True, slots=True)
class StudyRow:
    """A study above the table.

    Attributes:
        name: Its folder below that of the index.
        link: Address of its report; empty if it has none.
        description: What it says about itself.
    """

    name: str
    link: str
    description: str


def runs_in(folder: Path) -> Iterator[Path]:
    """Yield the folders of runs below a folder, those of the jobs of sweeps too.

    Links are not followed, and folders in a run's are not searched.
    """
    for place, names, files in os.walk(folder):
        if CONFIG in files and any(name in files for name in _RUN_FILES):
            names.clear()
            yield Path(place)
        else:
            names[:] = sorted(name for name in names if not name.startswith("."))


def studies_in(folder: Path) -> Iterator[Path]:
    """Yield the folders of studies below a folder, or the folder itself."""
    for place, names, files in os.walk(folder):
        if STUDY in files or CONFIG in files:
            names.clear()
        names[:] = sorted(name for name in names if not name.startswith("."))
        if STUDY in files:
            yield Path(place)


def page_of_runs(folder: Path, out: Path, say: Callable[[str], None]) -> str:
    """Return the index of a folder of runs as HTML; the newest run is the first.

    Pictures that are drawn for it stay in the runs' folders, for the next time.

    Args:
        folder: The folder.
        out: Where the page will be; it links to the reports of runs from there.
        say: Called with a line if pictures have to be drawn, a second each.

    Raises:
        ConfigError: There is no run.
    """
    thumbnails = Thumbnails(say)
    rows = []
    for run in runs_in(folder):
        try:
            with named_damage(run):
                rows.append(_row(read_record(run), folder, out, thumbnails))
        except ConfigError as error:
            rows.append(_damaged_row(run, folder, out, error))
    studies = [_study_row(study, folder, out) for study in studies_in(folder)]
    if not rows:
        raise ConfigError(f"{folder} has no run: there is no {CONFIG} of one in it or below")
    rows.sort(key=lambda row: row.begun, reverse=True)
    is_sweep = (folder / SWEEP).is_file()
    name = folder.resolve().name
    shown_folder = display_path(folder)
    context = {
        "title": f"{'sweep' if is_sweep else 'runs'} {name}",
        "heading": "Sweep" if is_sweep else "Runs",
        "folder": name if shown_folder == "." else shown_folder,
        "studies": studies,
        "rows": rows,
        "columns": _columns(rows),
        "notes": thumbnails.notes,
        "data": _json_element(_data_of(rows)),
    }
    return render_page("runs_index.html.tmpl", context, script="runs_index.js")


def _columns(rows: Sequence[IndexRow]) -> list[str]:
    """The results that any run has, in the order of the headline."""
    names: dict[str, None] = {}
    for row in rows:
        names |= dict.fromkeys(row.results)
    return [name for name in ("success", "return", "length") if name in names]


def _row(record: RunRecord, folder: Path, out: Path, thumbnails: Thumbnails) -> IndexRow:
    words = [word for word in record.command[2:] if not word.startswith(_HIDDEN_WORDS)]
    # In one column are the success of an evaluation and that of a training, its yield too.
    results: dict[str, Result] = {}
    for result in headline(record):
        name = "success" if "success" in result.name or result.name == "yield" else result.name
        results.setdefault(name, result)
    whole, whole_link = _whole_link(record.folder, folder, out)
    return IndexRow(
        record=record,
        name=_name(record.folder, folder),
        link=_link(record.folder, out),
        whole=whole,
        whole_link=whole_link,
        about=" ".join(words),
        begun=f"{record.begun:%Y-%m-%d %H:%M:%S}",
        results=results,
        thumbnail=thumbnails.of(record),
        compared=_compared(record),
    )


def _damaged_row(run: Path, folder: Path, out: Path, error: ConfigError) -> IndexRow:
    return IndexRow(record=None, name=_name(run, folder), link=_link(run, out), problem=str(error))


def _name(run: Path, folder: Path) -> str:
    return str(run.relative_to(folder)) if run != folder else run.name


def _study_row(study: Path, folder: Path, out: Path) -> StudyRow:
    config = read_json(study / STUDY).get("config") or {}
    description = str(config.get("description") or "")
    return StudyRow(name=_name(study, folder), link=_link(study, out), description=description)


def _whole_link(run: Path, folder: Path, out: Path) -> tuple[str, str]:
    """What a run is a job of, and the address of its page; empty if this page is that."""
    whole = whole_run(run)
    link = "" if whole in (run, folder) else _link(whole, out)
    if not link:
        return "", ""
    return ("study" if (whole / STUDY).is_file() else "sweep"), link


def _link(run: Path, out: Path) -> str:
    """The address of the report of a run or a sweep, relative to the page; empty without one."""
    report = run / _REPORT
    if not report.is_file():
        return ""
    relative = os.path.relpath(report.resolve(), out.absolute().parent.resolve())
    # A name with a colon would be an address of its own without the dot.
    return f"./{quote(os.fsencode(relative).replace(os.sep.encode(), b'/'))}"


# -- the data of the comparison --------------------------------------------------------------------


def _compared(record: RunRecord) -> Compared:
    evaluation = record.evaluation or record.summary.get("eval") or {}
    rows = [("kind", record.kind), ("status", record.status)]
    rows += [(result.name, _in_words(result)) for result in headline(record)]
    for name in ("metrics", "rewards"):
        values = evaluation.get(name) or record.summary.get(name) or {}
        rows += fact_rows((f"{name[:-1]} {term}", value) for term, value in values.items())
    return Compared(config=sorted(_flat(record.config)), results=rows, curves=_curves(record))


def _in_words(result: Result) -> str:
    return "; ".join([result.text, *result.about])


def _flat(tree: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Key path and value of each leaf of a config."""
    if isinstance(tree, dict) and tree:
        for key, value in tree.items():
            if path or key not in _IGNORED_KEYS:
                yield from _flat(value, f"{path}.{key}" if path else str(key))
    else:
        yield path, tree if isinstance(tree, str) else json.dumps(tree, default=str)


def _data_of(rows: Sequence[IndexRow]) -> dict[str, Any]:
    """What the script compares.

    Configs are long and mostly alike: each of their lines is in the data once, and runs have its
    number.
    """
    numbers: dict[tuple[str, str], int] = {}
    runs = []
    for row in rows:
        compared = row.compared or Compared()
        config = [numbers.setdefault(line, len(numbers)) for line in compared.config]
        runs.append({"config": config, "results": compared.results, "curves": compared.curves})
    return {"lines": list(numbers), "runs": runs}


def _curves(record: RunRecord) -> dict[str, dict[str, Any]]:
    """Learning curves, and returns of an evaluation's episodes in order, as lists of numbers."""
    from embodichain.learning.evaluation.comparison import PROGRESS, RETURN, SUCCESS, read_curves

    curves = {}
    learned = read_curves(record.folder / PROGRESS)
    for name, title in {SUCCESS: "success rate", RETURN: "mean return"}.items():
        if name in learned:
            curve = learned[name]
            curves[title] = _points(curve.steps, curve.values, "environment steps")
    returns = (record.evaluation.get("per_episode") or {}).get("return") or []
    if len(returns) > 1:
        shares = np.linspace(0.0, 100.0, len(returns))
        title = "returns of evaluated episodes, in order"
        curves[title] = _points(shares, np.sort(returns), "percent of episodes")
    return curves


def _points(x: Any, y: Any, x_label: str) -> dict[str, Any]:
    is_finite = np.isfinite(x) & np.isfinite(y)
    x = np.asarray(x, np.float64)[is_finite]
    y = np.asarray(y, np.float64)[is_finite]
    chosen = np.linspace(0, len(x) - 1, min(len(x), _MOST_POINTS)).round().astype(np.int64)
    return {
        "x": [float(f"{value:.6g}") for value in x[chosen]],
        "y": [float(f"{value:.6g}") for value in y[chosen]],
        "label": x_label,
    }


def _json_element(value: Mapping[str, Any]) -> Markup:
    """JSON for an element of HTML, which no text in it can end."""
    text = to_json(value)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
