"""`check_references`: the references of terms to entities that do not exist."""

from __future__ import annotations

from embodichain.lab.gym.envs.cfg import EnvCfg, TermCfg
from embodichain.lab.gym.envs.managers.param_types import NamedEntity
from embodichain.lab.gym.envs.managers.scene_entity import references_in
from embodichain.lab.gym.envs.managers.terms.registry import SECTIONS, TERMS, Kind
from embodichain.lab.sim.compiler.names import SUN, Known, pick
from embodichain.utils.errors import Problem
from embodichain.utils.suggest import did_you_mean, listing

__all__ = ["check_references"]


def check_references(cfg: EnvCfg, known: Known, open_scene: bool) -> list[Problem]:
    """Return every reference to an entity, joint, link or control part that does not exist.

    Args:
        cfg: The task.
        known: The declared entities.
        open_scene: Whether Python code may add entities: then an unknown uid is not a mistake.
    """
    problems: list[Problem] = []
    for section, kind in SECTIONS.items():
        for name, term in getattr(cfg, section).items():
            names_light = _names_light(kind, term)
            for path, fields in references_in(f"{section}.{name}.params", term.params):
                if names_light:
                    uid = str(fields.get("uid") or "")
                    problems += _check_light(path, uid, known, open_scene)
                else:
                    _, mistakes = pick(path, fields, known, open_scene)
                    problems += mistakes
    return problems


def _names_light(kind: Kind, term: TermCfg) -> bool:
    """Whether the references of a term name lights, which have no joints and links."""
    if not isinstance(term.func, str):
        return False
    spec = TERMS[kind].get(term.func)
    return spec is not None and NamedEntity in spec.hints().values()


def _check_light(path: str, uid: str, known: Known, open_scene: bool) -> list[Problem]:
    lights = [name for name, entity in known.items() if entity == "light"]
    if uid in lights or (open_scene and uid and uid not in known):
        return []
    if not lights:
        if uid == SUN:  # whether the sun shines is known when the scene is compiled
            return []
        lights = [SUN]
    message = f"no light is called {uid!r}; there are: {listing(lights, uid)}"
    return [Problem(f"{path}.uid", message, did_you_mean(uid, lights).strip())]
