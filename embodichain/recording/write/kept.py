"""Values of variables of the environment that a log has, since its model has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco

from embodichain.utils.env_text import env_texts, known_values

__all__ = ["kept_in_model"]

_SHORTEST = 4
"""Shorter values are looked for as whole names, since any name may have them."""


def kept_in_model(tree: Mapping[str, Any], model: mujoco.MjModel) -> Iterator[str]:
    """Yield a sentence for each text of a config whose variable's value is in the model.

    Args:
        tree: A resolved config.
        model: The compiled model: names of what is in it, paths of its files.
    """
    texts = model.names + b"\0" + model.paths + b"\0" + bytes(model.text_data)
    whole = set(texts.split(b"\0"))
    for path, text in env_texts(tree):
        values = {value for value, name in known_values().items() if name in text.names}
        for value in {value.encode() for value in (*values, text) if value}:
            if value in whole or (len(value) >= _SHORTEST and value in texts):
                names = " and ".join(text.names) or "a default of oc.env"
                yield f"{path} holds the value of {names}: it is in the model and so in the log"
                break
