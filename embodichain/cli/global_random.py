"""Finds code that draws from a global random generator, by reading its source.

Such code stands outside the promise that environment i makes the same bytes whatever num_envs is:
torch's, numpy's and Python's global generators are shared by all environments. Runs nothing.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator

__all__ = ["global_draws", "registered_code"]

_TORCH = {
    *("rand", "rand_like", "randn", "randn_like", "randint", "randint_like", "randperm"),
    *("normal", "bernoulli", "multinomial", "poisson"),
}
_IN_PLACE = {
    *("uniform_", "normal_", "random_", "exponential_", "bernoulli_", "cauchy_", "geometric_"),
    "log_normal_",
}
_OWN_GENERATOR = {"default_rng", "Generator", "SeedSequence", "PCG64", "Philox", "Random"}


def global_draws(thing: Callable[..., object]) -> list[str]:
    """Return ``NAME (line N of FILE)`` for each draw from a global generator.

    Args:
        thing: A class or function; of a class the body is read, not its bases.

    Returns:
        Empty also when there is no source to read (built in the interpreter).
    """
    try:
        lines, first = inspect.getsourcelines(thing)
        file = inspect.getsourcefile(thing)
    except (OSError, TypeError):
        return []
    tree = ast.parse(textwrap.dedent("".join(lines)))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and _is_global(node)]
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    return [
        f"{ast.unparse(call.func)} (line {first + call.lineno - 1} of {file})" for call in calls
    ]


def _is_global(call: ast.Call) -> bool:
    """Whether a call draws from a generator that nobody passed."""
    if any(keyword.arg == "generator" for keyword in call.keywords):
        return False
    owner, _, name = ast.unparse(call.func).rpartition(".")
    if name in _IN_PLACE:
        return True
    if owner == "torch":
        return name in _TORCH
    if owner in ("np.random", "numpy.random", "random"):
        return name not in _OWN_GENERATOR
    return False


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
