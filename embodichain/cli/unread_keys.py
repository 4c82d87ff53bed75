"""Keys that a verb does not read: given on its command line, they are refused."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from embodichain.config.locate import COMMAND_LINE
from embodichain.utils.errors import ConfigError, Problem

__all__ = ["refuse_unread", "unread_keys"]

_OF_TRAINING = ("algo", "total_timesteps", "checkpoint", "wandb", "dataset")
_NOT_TRAINED = "`{verb}` does not read it: a policy is played, not trained"
_OF_COLLECTING = "`{verb}` does not read it, `collect` does"
_UNREAD: Mapping[str, Mapping[str, str]] = {
    "run": {
        **dict.fromkeys(_OF_TRAINING, _NOT_TRAINED),
        "eval": "`run` does not read it: it is of `train`; what a run plays is {last}={value}",
        "collect": _OF_COLLECTING,
    },
    "eval": {
        **dict.fromkeys((*_OF_TRAINING, "resume"), _NOT_TRAINED),
        "eval": "it is of `train`, for the evaluation at its end; give {last}={value} alone",
        "collect": _OF_COLLECTING,
        "max_steps": "`eval` does not read it: an evaluation ends after `episodes`",
        "policy": "`eval` does not read it: name the policy alone, `embodichain eval POLICY`",
    },
    "play": {
        **dict.fromkeys((*_OF_TRAINING, "resume"), _NOT_TRAINED),
        "eval": "it is of `train`, for the evaluation at its end; give {last}={value} alone",
        "collect": _OF_COLLECTING,
        "policy": "`play` does not read it: name the policy alone, `embodichain play POLICY`",
    },
    "train": {
        "max_steps": "`train` does not read it: it ends after total_timesteps",
        "episodes": "`train` does not read it: it ends after total_timesteps; the evaluation at its"
        " end has eval.episodes={value}",
        "collect": _OF_COLLECTING,
    },
}
"""Verb -> root key, and why it has no effect."""


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
