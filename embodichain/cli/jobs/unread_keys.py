"""Keys that a verb does not read: on its command line, they are refused."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from embodichain.config.composition.locate import COMMAND_LINE
from embodichain.utils.errors import ConfigError, Problem

if TYPE_CHECKING:
    from embodichain.config.keys.schema import JobVerb


__all__ = ["refuse_unread", "unread_keys", "verb_of_keys"]

_TRAINING = dict.fromkeys(
    ("algo", "total_timesteps", "checkpoint", "wandb", "dataset"),
    "`{verb}` does not read it: a policy is played, not trained",
)
_COLLECTION = {"collect": "`{verb}` does not read it, `collect` does"}
_RESUMPTION = {"resume": "`{verb}` does not read it: only `train` and `collect` resume a run"}
_POLICY = {
    "policy": "`{verb}` does not read it: name the policy alone, `embodichain {verb} POLICY`"
}
_START_PICTURE = {"scene_png": "`{verb}` does not read it: only `run` and `play` draw the start"}
_EVALUATION = {
    "eval": "`{verb}` does not read it: it belongs to `train`, for the evaluation at its end"
}
_EVALUATION_OF_PLAYERS = {
    "eval": "it belongs to `train`, for the evaluation at its end; give {last}={value} alone"
}
"""The same for verbs that play episodes themselves, where ``eval.episodes=9`` is ``episodes=9``."""
_RUN = {
    "episodes": "`{verb}` does not read it: it plays no episodes",
    "max_steps": "`{verb}` does not read it: it plays no episodes",
    "record": "`{verb}` does not read it: it writes no log",
    "video": "`{verb}` does not read it: it makes no film",
    **_START_PICTURE,
}
_UNREAD: Mapping[str, Mapping[str, str]] = {
    "run": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        "eval": "`run` does not read it: it belongs to `train`; for a run, give {last}={value}"
        " alone",
    },
    "eval": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_POLICY,
        **_START_PICTURE,
        **_EVALUATION_OF_PLAYERS,
        "max_steps": "`eval` does not read it: an evaluation ends after `episodes`",
    },
    "play": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_POLICY,
        **_EVALUATION_OF_PLAYERS,
    },
    "train": {
        **_COLLECTION,
        **_START_PICTURE,
        "max_steps": "`train` does not read it: it ends after total_timesteps",
        "trust": "`train` does not read it: the files that it reads run no code",
        "episodes": "`train` does not read it: it ends after total_timesteps; the evaluation at its"
        " end has eval.episodes={value}",
        "policy": "`train` does not read it: it learns one, with algo=NAME; resume=RUN continues a"
        " training",
    },
    "collect": {
        **_TRAINING,
        **_START_PICTURE,
        **_EVALUATION,
    },
    "demo": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_EVALUATION,
    },
    "demo --web": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_EVALUATION,
        **dict.fromkeys(
            ("record", "video", "scene_png", "max_steps"),
            "a page does not read it, `embodichain demo --film` does",
        ),
    },
    "bench": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_EVALUATION,
        **_RUN,
        **dict.fromkeys(
            ("episodes", "max_steps"),
            "`bench` does not read it: it measures --rounds of a third of a second",
        ),
        "viewer": "`bench` does not read it: it shows nothing",
    },
    "render": {
        **_TRAINING,
        **_COLLECTION,
        **_RESUMPTION,
        **_EVALUATION,
        **_RUN,
        **dict.fromkeys(
            ("episodes", "max_steps"),
            "`render` does not read it: it draws after --step control steps",
        ),
        "viewer": "`render` does not read it: it writes a picture",
    },
    "export policy": {
        **dict.fromkeys(_TRAINING, "`{verb}` does not read it: the policy is trained already"),
        **_COLLECTION,
        **_RESUMPTION,
        **_EVALUATION,
        **_RUN,
        "policy": "`{verb}` does not read it: name the training alone, `embodichain {verb} RUN`",
        "viewer": "`{verb}` does not read it: it writes a file",
        **dict.fromkeys(
            ("num_envs", "seed"),
            "`{verb}` does not read it: a file of a policy has none",
        ),
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
    for line in lines:
        key = line.lstrip("+~").partition("=")[0]
        group = key.partition("@")[0]
        if group == "algo":
            return "train"
    return "run"


def unread_keys(verb: str, lines: Sequence[str]) -> list[Problem]:
    """Return a mistake for each key that has no effect on a verb.

    Args:
        verb: The verb.
        lines: Overrides as typed.
    """
    reasons = _UNREAD.get(verb, {})
    problems: list[Problem] = []
    for line in lines:
        key, _, value = line.lstrip("+~").partition("=")
        root_key = re.split(r"[./@]", key)[0]
        reason = reasons.get(root_key)
        if reason is not None:
            last = key.rpartition(".")[2]
            message = reason.format(verb=verb, last=last, value=value)
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
