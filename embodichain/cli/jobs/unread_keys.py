"""Keys that a verb does not read: given on its command line, they are refused."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.keys.schema import JobVerb


__all__ = ["refuse_unread", "unread_keys", "verb_of_keys"]

_PLAYED = dict.fromkeys(
    ("algo", "total_timesteps", "checkpoint", "wandb", "dataset"),
    "`{verb}` does not read it: a policy is played, not trained",
)
_COLLECT = {"collect": "`{verb}` does not read it, `collect` does"}
_RESUME = {"resume": "`{verb}` does not read it: `train` and `collect` go on where they stopped"}
_POLICY = {
    "policy": "`{verb}` does not read it: name the policy alone, `embodichain {verb} POLICY`"
}
_SCENE = {"scene_png": "`{verb}` does not read it: only `run` and `play` draw the start"}
_ENDS = {
    "eval": "it is of `train`, for the evaluation at its end; give {last}={value} alone",
}
_NO_EVAL = {"eval": "`{verb}` does not read it: it is of `train`, for the evaluation at its end"}
_NO_RUN = {
    **dict.fromkeys(("episodes", "max_steps"), "`{verb}` does not read it: it plays no episodes"),
    "record": "`{verb}` does not read it: it writes no log",
    "video": "`{verb}` does not read it: it makes no film",
    **_SCENE,
}
_UNREAD: Mapping[str, Mapping[str, str]] = {
    "run": {
        **(_PLAYED | _COLLECT | _RESUME),
        "eval": "`run` does not read it: it is of `train`; what a run plays is {last}={value}",
    },
    "eval": {
        **(_PLAYED | _COLLECT | _RESUME | _POLICY | _SCENE | _ENDS),
        "max_steps": "`eval` does not read it: an evaluation ends after `episodes`",
    },
    "play": _PLAYED | _COLLECT | _RESUME | _POLICY | _ENDS,
    "train": {
        **(_COLLECT | _SCENE),
        "max_steps": "`train` does not read it: it ends after total_timesteps",
        "trust": "`train` does not read it: what it reads runs no code",
        "episodes": "`train` does not read it: it ends after total_timesteps; the evaluation at its"
        " end has eval.episodes={value}",
        "policy": "`train` does not read it: it learns one, with algo=NAME; resume=RUN goes on with"
        " a training",
    },
    "collect": _PLAYED | _SCENE | _NO_EVAL,
    "demo": _PLAYED | _COLLECT | _RESUME | _NO_EVAL,
    "demo --web": {
        **dict.fromkeys(
            ("record", "video", "scene_png", "max_steps"),
            "a page does not read it, `embodichain demo --film` does",
        ),
    },
    "bench": {
        **(_PLAYED | _COLLECT | _RESUME | _NO_EVAL | _NO_RUN),
        **dict.fromkeys(
            ("episodes", "max_steps"),
            "`bench` does not read it: it measures --rounds of a third of a second",
        ),
    },
    "render": {
        **(_PLAYED | _COLLECT | _RESUME | _NO_EVAL | _NO_RUN),
        **dict.fromkeys(
            ("episodes", "max_steps"),
            "`render` does not read it: it draws after --step control steps",
        ),
        "viewer": "`render` does not read it: it writes a picture",
    },
    "export policy": {
        **dict.fromkeys(_PLAYED, "`{verb}` does not read it: the policy is trained already"),
        **(_COLLECT | _RESUME | _NO_EVAL | _NO_RUN),
        "policy": "`{verb}` does not read it: name the training alone, `embodichain {verb} RUN`",
        "viewer": "`{verb}` does not read it: it writes a file",
    },
}
"""Verb -> root key, and why it has no effect."""


def verb_of_keys(lines: Sequence[str]) -> JobVerb:
    """The verb whose config has the keys of `validate` or `show`, which take those of any job.

    Args:
        lines: Overrides as typed.

    Returns:
        ``train`` if an algorithm is chosen (``algo=sac``), which only its config can; else ``run``.
    """
    chosen = any(line.lstrip("+~").partition("=")[0].partition("@")[0] == "algo" for line in lines)
    return "train" if chosen else "run"


def unread_keys(verb: str, lines: Sequence[str]) -> list[Problem]:
    """Return a mistake for each key that has no effect on a verb.

    Args:
        verb: The verb.
        lines: Overrides as typed.
    """
    unread, problems = _UNREAD.get(verb, {}), []
    for line in lines:
        key, _, value = line.lstrip("+~").partition("=")
        why = unread.get(re.split(r"[./@]", key)[0])
        if why is not None:
            last = key.rpartition(".")[2]
            message = why.format(verb=verb, last=last, value=value)
            problems.append(Problem(key, message, source=COMMAND_LINE))
    return problems


def refuse_unread(verb: str, lines: Sequence[str]) -> None:
    """Refuse keys that have no effect on a verb; see `unread_keys`.

    Raises:
        ConfigError: Lists all such keys.
    """
    problems = unread_keys(verb, lines)
    if problems:
        raise ConfigError(problems)
