"""Contacts of an arm when something goes wrong: `obstacles` names them, `is_touching` finds them.

They are computed anew for the one environment that is asked for (`Engine.data_of`), and only there:
no step needs them while all goes well.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
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

_NAMED = 3
"""Contacts that a message names at most, the strongest first."""
_WEAK = 0.5
"""Force in newtons below which a contact stops no arm."""


def obstacles(engine: Engine, row: int, robot: Collection[int], held: Collection[int]) -> str:
    """What a robot, or what it holds, touches in an environment, in words.

    Args:
        engine: The engine.
        row: The environment.
        robot: Bodies of the robot.
        held: Bodies of what it holds; that they touch the robot is left out.

    Returns:
        For instance ``ur10/link6 touches table with 114 N``: the largest net forces between two
        bodies; or that nothing is touched.
    """
    mine = {*robot, *held}
    nets: dict[tuple[str, str], F64] = {}
    for bodies, geoms, force in _contacts(engine, row):
        first, second = (body in mine for body in bodies)
        grip = any(a in robot and b in held for a, b in (bodies, bodies[::-1]))
        if grip or not (first or second):
            continue
        names = tuple(_name(engine.model, *one) for one in zip(bodies, geoms, strict=True))
        if not first:
            names, force = names[::-1], -force
        nets[names[0], names[1]] = nets.get((names[0], names[1]), 0.0) + force
    sizes = {names: float(np.linalg.norm(force)) for names, force in nets.items()}
    strongest = sorted((-size, names) for names, size in sizes.items() if size >= _WEAK)[:_NAMED]
    said = [f"{a} touches {b} with {-size:.3g} N" for size, (a, b) in strongest]
    return ", ".join(said) or "nothing is touched"


def is_touching(engine: Engine, row: int, some: Collection[int], others: Collection[int]) -> bool:
    """Whether some bodies touch others in an environment."""
    pairs = (bodies for bodies, _, _ in _contacts(engine, row))
    return any((a in some and b in others) or (b in some and a in others) for a, b in pairs)


def _contacts(engine: Engine, row: int) -> Iterator[tuple[tuple[int, int], tuple[int, int], F64]]:
    """Bodies, geoms and force, (3,) N on the second in world axes, of each active contact."""
    data = engine.data_of(row)
    model = engine.model
    wrench = np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        geoms = int(contact.geom1), int(contact.geom2)
        if contact.efc_address < 0 or min(geoms) < 0:
            continue
        mujoco.mj_contactForce(model, data, number, wrench)
        bodies = int(model.geom_bodyid[geoms[0]]), int(model.geom_bodyid[geoms[1]])
        yield bodies, geoms, wrench[:3] @ contact.frame.reshape(3, 3)


def _name(model: mujoco.MjModel, body: int, geom: int) -> str:
    """The name of a body; of what is fixed to the world that of the shape."""
    name = str(model.body(body).name if body else model.geom(geom).name)
    if name == GROUND:
        return "the ground"
    return name or ("the world" if body == 0 else f"body {body}")
