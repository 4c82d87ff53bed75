"""The history of performance: one JSON row a commit and benchmark, and a page that draws it.

    python -m benchmarks.history --record step_speed startup    # after measuring, at this commit
    python -m benchmarks.history --from-git                     # what earlier commits had measured
    python -m benchmarks.history --page                         # docs/history.html alone

A row of ``benchmarks/history.jsonl`` has the commit that the figures were measured at or committed
with, its date, the benchmark, the machine, and figures: medians that a reader would compare, taken
from the benchmark's result file. Rows are only added. A figure whose meaning changed (start-up was
once measured by the clock, now in CPU time) is another figure.
"""

from __future__ import annotations

import argparse
import html
import json
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = "benchmarks/results"
ROWS = ROOT / "benchmarks" / "history.jsonl"
PAGE = ROOT / "docs" / "history.html"

Figures = dict[str, tuple[float, str]]
"""Name -> value and unit. Of units in `HIGHER` more is better, of others less."""
HIGHER = ("steps/s", "of the floor", "of linear")
_SPEEDS = ("random_reach", "random_reach + MCAP", "push_cube", "floor, 2 threads")
_SIZES = (1, 64, 1024)
_MIB = 2**20


@dataclass(frozen=True)
class Row:
    """A benchmark at a commit.

    Attributes:
        commit: Abbreviated hash; with ``+`` if the package had changes that were not committed.
        date: Of the measurement, ``YYYY-MM-DD``.
        benchmark: Its module.
        machine: As in the result file, without the date.
        figures: See `Figures`.
    """

    commit: str
    date: str
    benchmark: str
    machine: dict[str, Any]
    figures: Figures


def row_of(commit: str, benchmark: str, facts: dict[str, Any]) -> Row:
    """The row of a result file.

    Raises:
        ValueError: No figures are taken from this benchmark, or the file has none of them.
    """
    if benchmark not in FIGURES:
        raise ValueError(f"no figures of {benchmark!r}; there are: {', '.join(FIGURES)}")
    found = FIGURES[benchmark](facts)
    if not found:
        raise ValueError(f"{benchmark}: the result file has none of the figures that are kept")
    machine = {name: value for name, value in facts["machine"].items() if name != "date"}
    if "device" in facts:
        machine["device"] = facts["device"]
    rounded = {name: (float(f"{value:.4g}"), unit) for name, (value, unit) in found.items()}
    return Row(commit, facts["machine"]["date"], benchmark, machine, rounded)


def _step_speed(facts: dict[str, Any]) -> Figures:
    found: Figures = {}
    for result in facts["results"]:
        name, count = result["name"], result["num_envs"]
        if name in _SPEEDS and count in _SIZES:
            found[f"{name}, N={count}"] = median(result["speeds"]), "steps/s"
            if not name.startswith("floor"):
                found[f"{name}, N={count}, ratio"] = median(result["ratios"]), "of the floor"
    return found


def _all_speeds(facts: dict[str, Any]) -> Figures:
    return {
        f"{result['name']}, N={result['num_envs']}": (median(result["speeds"]), "steps/s")
        for result in facts["results"]
    }


def _startup(facts: dict[str, Any]) -> Figures:
    unit = "CPU s" if "cpu_seconds" in facts else "s"
    seconds = facts.get("cpu_seconds") or facts["seconds"]
    return {f"{name}, {unit}": (median(times), unit) for name, times in seconds.items()}


def _log_cost(facts: dict[str, Any]) -> Figures:
    found: Figures = {}
    for result in facts["results"]:
        if result["physics_steps"] != 4:
            continue
        pairs = zip(*(list(_flat(result["seconds"][arm])) for arm in ("plain", "logged")))  # noqa: B905
        name = f"N={result['num_envs']}, {result.get('resets', 'lockstep')} resets"
        found[name] = 100 * median(logged / plain - 1 for plain, logged in pairs), "% of a step"
    return found


def _flat(values: Iterable[Any]) -> Iterator[float]:
    """The numbers of nested lists: several processes had a list each."""
    for value in values:
        if isinstance(value, list):
            yield from _flat(value)
        else:
            yield value


def _memory(facts: dict[str, Any]) -> Figures:
    sizes = facts["bytes"].get("random_reach", facts["bytes"])
    name = "random_reach, N={}"
    return {
        name.format(count): (of["running"] / _MIB, "MiB")
        for count, of in sizes.items()
        if count in ("1", "1024", "16384")
    }


def _train(facts: dict[str, Any]) -> Figures:
    speeds = facts["speed"]["steps_per_second"]
    found: Figures = {arm: (median(values), "env-steps/s") for arm, values in speeds.items()}
    for arm, solved in facts["solve"]["found"].items():
        found[f"{arm}, to 95 %"] = median(one["seconds"] for one in solved), "s"
    return found


def _small_batches(facts: dict[str, Any]) -> Figures:
    return {
        f"reach through {arm}, N={count}": (median(of[key]), "us a step")
        for count, of in facts["sb3"].items()
        for key, arm in (("ours", "SB3VecEnv"), ("dummy", "DummyVecEnv"))
    }


def _action_cost(facts: dict[str, Any]) -> Figures:
    return {
        f"{term}, N={count}": (median(times), "us")
        for count, of in facts["microseconds"].items()
        for term, times in of.items()
        if term in ("relative_joint_position", "eef_delta_pose", "eef_pose", "parallel_gripper")
    }


def _step_profile(facts: dict[str, Any]) -> Figures:
    parts = ("physics", "observation", "step(), without timers")
    return {
        f"{part}, N={count}": (of[part], "us")
        for count, of in facts["microseconds"].items()
        for part in parts
        if int(count) in _SIZES
    }


def _render(facts: dict[str, Any]) -> Figures:
    found: Figures = {}
    for task, of in facts["tasks"].items():
        for count, pixels, outputs, ours, *_ in of["small"]:
            if outputs == 1 and pixels == 64:
                found[f"{task}, 64 x 64, N={count}"] = ours, "ms a picture"
        for count, milliseconds in of["film"]:
            found[f"{task}, film, {count} at once"] = milliseconds, "ms a frame"
    return found


def _view_cost(facts: dict[str, Any]) -> Figures:
    """By the process's whole time; what was measured in two halves before is their sum."""
    found: Figures = {}
    for task, of in facts["tasks"].items():
        costs = of.get("costs") or of.get("both") or [of["stepping"] + of["writing"]]
        found[task] = median(costs), "ms an update"
    return found


def _log_survival(facts: dict[str, Any]) -> Figures:
    lost = [kill["lost_s"] for kill in facts["kills"]]
    return {"lost by a kill, median": (median(lost), "s"), "lost by a kill, most": (max(lost), "s")}


def _shards(facts: dict[str, Any]) -> Figures:
    found: Figures = {}
    for count, ways in facts["sizes"].items():
        for way, one in ways.items():
            for kind in ("CPU", "wall"):
                name = f"{way}, {count} environments a shard, {kind} time"
                found[name] = one[f"efficiency_{kind.lower()}"], "of linear"
    return found


FIGURES: dict[str, Callable[[dict[str, Any]], Figures]] = {
    "step_speed": _step_speed,
    "step_speed_cuda": _all_speeds,
    "small_batches": _small_batches,
    "step_profile": _step_profile,
    "log_cost": _log_cost,
    "view_cost": _view_cost,
    "log_survival": _log_survival,
    "action_cost": _action_cost,
    "randomization": _all_speeds,
    "render": _render,
    "train": _train,
    "memory": _memory,
    "startup": _startup,
    "shards": _shards,
}
"""Benchmark -> its figures from the facts of a result file, in the order of the page."""


def read(path: Path = ROWS) -> list[Row]:
    """The rows of the file, in their order."""
    if not path.exists():
        return []
    loaded = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    rows = (Row(**row) for row in loaded)
    return [
        Row(**{**vars(r), "figures": {n: (v, u) for n, (v, u) in r.figures.items()}}) for r in rows
    ]


def add(rows: Iterable[Row], path: Path = ROWS) -> list[Row]:
    """Append rows; a commit's row of a benchmark that is there stays as it is.

    Returns:
        The rows that were added.
    """
    there = {(row.commit, row.benchmark) for row in read(path)}
    new = [row for row in rows if (row.commit, row.benchmark) not in there]
    with path.open("a", encoding="utf-8") as stream:
        stream.writelines(json.dumps(asdict(row)) + "\n" for row in new)
    return new


def rows_of_git(root: Path = ROOT) -> Iterator[Row]:
    """A row for every commit that wrote a result file from which figures are taken, oldest first.

    Without merges, which measure nothing.
    """
    log = _git(root, "log", "--reverse", "--no-merges", "--format=%h", "--name-only", "--", RESULTS)
    commit = ""
    for line in filter(None, log.splitlines()):
        if "/" not in line:
            commit = line
            continue
        benchmark = Path(line).stem
        shown = subprocess.run(
            ["git", "-C", root, "show", f"{commit}:{line}"], capture_output=True, check=False
        )
        if shown.returncode == 0 and benchmark in FIGURES:  # else it was removed, or has none
            yield row_of(commit, benchmark, json.loads(shown.stdout))


def _head(root: Path) -> str:
    changed = _git(root, "status", "--porcelain", "--", "embodichain", "conf", "tasks")
    return _git(root, "rev-parse", "--short", "HEAD") + "+" * bool(changed)


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-C", str(root), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


_WIDTH, _HEIGHT, _PAD = 300, 110, 8
_COLOURS = ("#1f77b4", "#d95f02", "#1b9e77", "#7570b3", "#e7298a")
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1020px; margin: 2em auto; padding: 0 1em; }
.charts { display: flex; flex-wrap: wrap; gap: 14px; }
figure { margin: 0; width: 310px; }
figcaption { font-size: 13px; }
svg { border: 1px solid #8886; border-radius: 4px; }
small, .note { color: #777; }
ul { list-style: none; padding: 0; }
"""


def page(rows: list[Row]) -> str:
    """The page: a chart for every figure, a colour for every machine. It needs no other file."""
    machines = list(dict.fromkeys(_machine(row) for row in rows))
    parts = [
        "<!doctype html>\n<html lang='en'>\n<meta charset='utf-8'>",
        "<title>embodichain: history of performance</title>",
        f"<style>{_STYLE}</style>",
        "<h1>History of performance</h1>",
        "<p>Medians at the commits that measured them, from <code>benchmarks/history.jsonl</code>. "
        "The machines were shared with other work: a point is worth its machine's load (in its "
        "tooltip) as much as its value, and a ratio to the bare simulation, measured in the same "
        "minute, more than a speed. Charts begin at zero; &#9650; more is better, "
        "&#9660; less is.</p>",
        "<ul>",
        *(
            f"<li><span style='color:{_COLOURS[i % len(_COLOURS)]}'>&#9679;</span> "
            f"{html.escape(machine)}</li>"
            for i, machine in enumerate(machines)
        ),
        "</ul>",
    ]
    for benchmark in FIGURES:
        of = [row for row in rows if row.benchmark == benchmark]
        if not of:
            continue
        names = dict.fromkeys(name for row in of for name in row.figures)
        first, last = of[0], of[-1]
        parts.append(f"<h2 id='{benchmark}'>{benchmark}</h2>")
        parts.append(
            f"<p class='note'>{len(of)} commits, {first.commit} ({first.date}) to "
            f"{last.commit} ({last.date})</p>\n<div class='charts'>"
        )
        parts += [_chart(name, of, machines) for name in names]
        parts.append("</div>")
    return "\n".join(parts) + "\n</html>\n"


def _machine(row: Row) -> str:
    of = row.machine
    device = f"{of['device']} with " if "device" in of else ""
    cores = f"{of['cores']} cores of {of['processor']}"
    return f"{device}{cores}, {of['memory_gib']} GiB, {of['system']}"


def _written(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:g}"


def _chart(name: str, rows: list[Row], machines: list[str]) -> str:
    """One figure: points in the order of the commits, joined where the machine is the same."""
    points = [(i, row, *row.figures[name]) for i, row in enumerate(rows) if name in row.figures]
    top = max(max(value for *_, value, _ in points), 1e-12)
    least = min(0.0, *(value for *_, value, _ in points))
    wide = max(len(rows) - 1, 1)

    def place(i: int, value: float) -> tuple[str, str]:
        x = _PAD + i / wide * (_WIDTH - 2 * _PAD)
        y = _PAD + (top - value) / (top - least) * (_HEIGHT - 2 * _PAD)
        return f"{x:.1f}", f"{y:.1f}"

    drawn = []
    for number, machine in enumerate(machines):
        own = [point for point in points if _machine(point[1]) == machine]
        colour = _COLOURS[number % len(_COLOURS)]
        line = " ".join(",".join(place(i, value)) for i, _, value, _ in own)
        drawn.append(f"<polyline points='{line}' fill='none' stroke='{colour}' opacity='.5'/>")
        for i, row, value, unit in own:
            x, y = place(i, value)
            at = f"{row.commit} {row.date}, load {row.machine['load_at_start']}"
            said = f"{_written(value)} {unit}: {at}"
            drawn.append(
                f"<circle cx='{x}' cy='{y}' r='3' fill='{colour}'>"
                f"<title>{html.escape(said)}</title></circle>"
            )
    value, unit = points[-1][2:]
    mark = "&#9650;" if unit in HIGHER or unit.endswith("steps/s") else "&#9660;"
    return (
        f"<figure><figcaption>{html.escape(name)} <small>{mark}</small><br>"
        f"<b>{_written(value)}</b> {html.escape(unit)}</figcaption>"
        f"<svg width='{_WIDTH}' height='{_HEIGHT}' role='img' "
        f"aria-label='{html.escape(name, quote=True)}'>{''.join(drawn)}</svg></figure>"
    )


def main(arguments: list[str] | None = None) -> None:
    """Add rows, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--record", nargs="+", default=[], metavar="BENCHMARK")
    parser.add_argument("--commit", help="of the figures; default: HEAD")
    parser.add_argument("--from-git", action="store_true")
    parser.add_argument("--page", action="store_true", help="add nothing")
    parser.add_argument("--rows", type=Path, default=ROWS)
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    if options.from_git:
        rows += rows_of_git()
    if options.record:
        commit = options.commit or _head(ROOT)
        for name in options.record:
            facts = json.loads((ROOT / RESULTS / f"{name}.json").read_text(encoding="utf-8"))
            rows.append(row_of(commit, name, facts))
    if not rows and not options.page:
        parser.error("give --record, --from-git or --page")
    for row in add(rows, options.rows) if rows else []:
        print(f"{row.commit} {row.date} {row.benchmark}: {len(row.figures)} figures")
    options.out.write_text(page(read(options.rows)), encoding="utf-8")
    print(options.out)


if __name__ == "__main__":
    main()
