"""Everything registered that runs in a step: environment classes and terms, by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator

__all__ = ["registered_code"]


def registered_code() -> Iterator[tuple[str, Callable[..., object]]]:
    """Yield environment classes of ours and of plug-ins, with their bases, and every term."""
    from embodichain.config.plugins import load_task_packages
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.managers.registry import KINDS, TERMS
    from embodichain.lab.gym.utils.registration import REGISTERED_ENVS

    load_task_packages()
    seen: set[object] = set(BaseEnv.__mro__)
    for name, spec in REGISTERED_ENVS.items():
        for cls in inspect.getmro(spec.cls) if inspect.isclass(spec.cls) else (spec.cls,):
            if cls not in seen:
                seen.add(cls)
                yield name, cls
    for kind in KINDS:
        for name, term in TERMS[kind].items():
            if term.func not in seen:
                seen.add(term.func)
                yield f"{kind} term {name}", term.func
