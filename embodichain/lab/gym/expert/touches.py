"""Contacts of an arm when something goes wrong: `obstacles` names them, `is_touching` finds them.

They are computed anew for the one environment that is asked for (`Engine.data_of`), and only there:
no step needs them while all goes well.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from embodichain.lab.sim.compiler.names import GROUND

if TYPE_CHECKING:
    import mujoco

    from embodichain.lab.sim.engine.api import F64, Engine
else:
    mujoco = lazy_loader.load("mujoco")

__all__ = ["is_touching", "obstacles"]

_MOST_NAMED = 3
"""Contacts that a message names at most, the strongest first."""
_WEAK = 0.5
"""Force in newtons below which a contact stops no arm."""


def obstacles(engine: Engine, env_id: int, robot: Collection[int], held: Collection[int]) -> str:
    """What a robot, or what it holds, touches in an environment, in words.

    Args:
        engine: The engine.
        env_id: The environment.
        robot: Bodies of the robot.
        held: Bodies of what it holds; that they touch the robot is left out.

    Returns:
        For instance ``ur10/link6 touches table with 114 N``: the largest net forces between two
        bodies; or that the robot touches nothing.
    """
    arm_bodies = {*robot, *held}
    net_forces: dict[tuple[str, str], F64] = {}
    for contact in _active_contacts(engine, env_id):
        if contact.is_between(robot, held):
            continue
        name1 = _shown_name(engine.model, contact.body1, contact.geom1)
        name2 = _shown_name(engine.model, contact.body2, contact.geom2)
        # The arm comes first; where both bodies are the arm's, MuJoCo's order stays.
        if contact.body1 in arm_bodies:
            names = (name1, name2)
            force = contact.force
        elif contact.body2 in arm_bodies:
            names = (name2, name1)
            force = -contact.force
        else:
            continue
        net_forces[names] = net_forces.get(names, 0.0) + force
    sizes = {names: float(np.linalg.norm(force)) for names, force in net_forces.items()}
    strongest = sorted((-size, names) for names, size in sizes.items() if size >= _WEAK)
    touches = [f"{a} touches {b} with {-size:.3g} N" for size, (a, b) in strongest[:_MOST_NAMED]]
    return ", ".join(touches) or "the robot touches nothing"


def is_touching(
    engine: Engine, env_id: int, some: Collection[int], others: Collection[int]
) -> bool:
    """Whether some bodies touch others in an environment."""
    return any(contact.is_between(some, others) for contact in _active_contacts(engine, env_id))


@dataclass(frozen=True)
class _Contact:
    """An active contact.

    Attributes:
        body1, body2: MuJoCo ids of its bodies.
        geom1, geom2: Those of its geoms.
        force: (3,) N on the second body, in world axes.
    """

    body1: int
    body2: int
    geom1: int
    geom2: int
    force: F64

    def is_between(self, some: Collection[int], others: Collection[int]) -> bool:
        """Whether one of its bodies is among `some`, and the other among `others`."""
        if self.body1 in some and self.body2 in others:
            return True
        return self.body2 in some and self.body1 in others


def _active_contacts(engine: Engine, env_id: int) -> Iterator[_Contact]:
    """The contacts of an environment that have a force and are between geoms."""
    data = engine.data_of(env_id)
    model = engine.model
    wrench = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        geom1 = int(contact.geom1)
        geom2 = int(contact.geom2)
        is_of_flex = min(geom1, geom2) < 0
        if contact.efc_address < 0 or is_of_flex:
            continue
        mujoco.mj_contactForce(model, data, number, wrench)
        yield _Contact(
            body1=int(model.geom_bodyid[geom1]),
            body2=int(model.geom_bodyid[geom2]),
            geom1=geom1,
            geom2=geom2,
            force=wrench[:3] @ contact.frame.reshape(3, 3),
        )


def _shown_name(model: mujoco.MjModel, body: int, geom: int) -> str:
    """The name of a body; of what is fixed to the world that of the shape."""
    is_world = body == 0
    name = str(model.geom(geom).name if is_world else model.body(body).name)
    if name == GROUND:
        return "the ground"
    if name:
        return name
    return "the world" if is_world else f"body {body}"
