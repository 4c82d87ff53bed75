"""Values of environment variables that get into a log because its model contains them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco

from embodichain.utils.env_text import env_texts, known_values

__all__ = ["kept_in_model"]

_SHORTEST = 4
"""Shorter values are compared with whole names only, since they may be a part of any name."""


def kept_in_model(tree: Mapping[str, Any], model: mujoco.MjModel) -> Iterator[str]:
    """Yield a sentence for each text of a config whose variable's value is in the model.

    Args:
        tree: A resolved config.
        model: The compiled model, with its names and the paths of its files.
    """
    model_text = model.names + b"\0" + model.paths + b"\0" + bytes(model.text_data)
    model_words = set(model_text.split(b"\0"))
    for path, text in env_texts(tree):
        values = {value for value, name in known_values().items() if name in text.names}
        values.add(text)
        for value in {value.encode() for value in values if value}:
            if value in model_words or (len(value) >= _SHORTEST and value in model_text):
                names = " and ".join(text.names) or "a default of oc.env"
                yield f"{path} holds the value of {names}: it is in the model and so in the log"
                break
