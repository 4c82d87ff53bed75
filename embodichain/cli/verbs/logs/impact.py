"""`embodichain impact`: what another MuJoCo, model or YAML does to recorded episodes."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click

from embodichain.cli.terminal.output import print_json, print_table
from embodichain.cli.terminal.process import FAILED, OK
from embodichain.cli.verb import verb
from embodichain.cli.words import log_of
from embodichain.utils.errors import ConfigError

__all__ = ["command"]


@dataclass(frozen=True)
class ImpactOptions:
    """What was typed after `impact`.

    Attributes:
        words: Logs, or their folders, and overrides.
        with_python: An interpreter or a virtual environment that plays the logs.
        trust: Import modules that a task or a log's overrides name.
        quiet: Print nothing.
        json: Print the result as one JSON object.
    """

    words: tuple[str, ...]
    with_python: str | None
    trust: bool
    quiet: bool
    json: bool


@verb(
    "impact",
    ("impact golden/*.mcap", "after a change of a YAML file or of a model"),
    ("impact golden/*.mcap task.physics.dt=0.004", "with a change that is typed"),
    ("impact golden/*.mcap --with-python ../other-mujoco", "in another virtual environment"),
    options=ImpactOptions,
    config_dir=True,
    quiet=True,
)
@click.argument("words", nargs=-1, required=True, metavar="LOG... [KEY=VALUE]...")
@click.option(
    "--with-python",
    metavar="VENV",
    help="Play them with this interpreter, or with that of this virtual environment.",
)
@click.option("--trust", is_flag=True, help="Import modules that a task or a log names.")
def command(options: ImpactOptions) -> int:
    """Play logs again with their actions; print which episodes part, where, and by how much."""
    from embodichain.cli.proof.impact import as_row, impact_elsewhere, impacts_of

    overrides = [word for word in options.words if _is_override(word)]
    logs = [log_of(word) for word in options.words if word not in overrides]
    if not logs:
        raise ConfigError("impact of what? Name logs: embodichain impact LOG... [KEY=VALUE]...")
    impacts: list[dict[str, Any]]
    if options.with_python is not None:
        impacts = impact_elsewhere(Path(options.with_python), logs, overrides, trust=options.trust)
    else:
        impacts = [asdict(impact) for impact in impacts_of(logs, overrides, trust=options.trust)]
    is_same = not any(impact["parted"] or impact["flips"] or impact["reason"] for impact in impacts)
    if options.json:
        print_json({"same": is_same, "logs": impacts})
    elif not options.quiet:
        title = "no episode parts" if is_same else "episodes part from what was recorded"
        print_table(title, [as_row(impact) for impact in impacts])
        notes = dict.fromkeys(f"{i['log']}: {note}" for i in impacts for note in i["notes"])
        sys.stdout.write("".join(f"note: {note}\n" for note in notes))
    return OK if is_same else FAILED


def _is_override(word: str) -> bool:
    """Whether a word is a change to the config, and not a log."""
    return ("=" in word or word.startswith("~")) and not Path(word).exists()
