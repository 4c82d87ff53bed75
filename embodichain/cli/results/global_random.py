"""Finds code that draws from a global random generator, by parsing its source.

The results of such code depend on num_envs, because all environments share the global generators
of torch, numpy and Python.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator

__all__ = ["global_draws", "registered_code"]

_TORCH = {
    "rand",
    "rand_like",
    "randn",
    "randn_like",
    "randint",
    "randint_like",
    "randperm",
    "normal",
    "bernoulli",
    "multinomial",
    "poisson",
}
"""Functions of torch that draw."""
_IN_PLACE = {
    "uniform_",
    "normal_",
    "random_",
    "exponential_",
    "bernoulli_",
    "cauchy_",
    "geometric_",
    "log_normal_",
}
"""Methods of tensors that draw."""
_MODULES = ("np.random", "numpy.random", "random")
"""Modules whose functions draw, but for `_GENERATORS`."""
_GENERATORS = {"default_rng", "Generator", "SeedSequence", "PCG64", "Philox", "Random"}
"""Functions and classes that make a generator."""


def global_draws(code: Callable[..., object]) -> list[str]:
    """Return ``NAME (line N of FILE)`` for each draw from a global generator.

    Args:
        code: A class or function; the bases of a class are not searched.

    Returns:
        The draws; empty also if there is no source (built into the interpreter).
    """
    try:
        lines, first_line = inspect.getsourcelines(code)
        file = inspect.getsourcefile(code)
    except (OSError, TypeError):
        return []
    tree = ast.parse(textwrap.dedent("".join(lines)))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and _is_global(node)]
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    draws: list[str] = []
    for call in calls:
        line = first_line + call.lineno - 1
        draws.append(f"{ast.unparse(call.func)} (line {line} of {file})")
    return draws


def _is_global(call: ast.Call) -> bool:
    """Whether a call draws from a global generator instead of one passed to it."""
    owner, _, name = ast.unparse(call.func).rpartition(".")
    if any(keyword.arg == "generator" for keyword in call.keywords):
        return False
    return (
        name in _IN_PLACE
        or (owner == "torch" and name in _TORCH)
        or (owner in _MODULES and name not in _GENERATORS)
    )


def registered_code() -> Iterator[tuple[str, Callable[..., object]]]:
    """Yield the environment classes of this package and of plug-ins, their bases, and all terms."""
    from embodichain.config.composition.plugins import load_task_packages
    from embodichain.lab.gym.envs.base_env import BaseEnv
    from embodichain.lab.gym.envs.managers.terms.registry import KINDS, TERMS
    from embodichain.lab.gym.utils.registration import REGISTERED_ENVS

    load_task_packages()
    registered: list[tuple[str, Callable[..., object]]] = []
    for name, spec in REGISTERED_ENVS.items():
        classes = [spec.cls]
        if inspect.isclass(spec.cls):
            classes = list(inspect.getmro(spec.cls))
        registered += [(name, cls) for cls in classes]
    for kind in KINDS:
        registered += [(f"{kind} term {name}", term.func) for name, term in TERMS[kind].items()]
    seen: set[object] = set(BaseEnv.__mro__)
    for name, code in registered:
        if code not in seen:
            seen.add(code)
            yield name, code
