"""Base classes of terms: `Term`, `ActionTerm`, `CommandTerm`; and `Uniform` for their draws."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from embodichain.utils.random import constant

if TYPE_CHECKING:
    import torch

    from embodichain.lab.gym.envs.managers.context import RandomDraws
    from embodichain.lab.sim.compiler.names import NamedBy
    from embodichain.lab.sim.engine.api import EnvIndex
    from embodichain.lab.sim.objects.articulation import Articulation
    from embodichain.utils.array_types import Floats

__all__ = [
    "ActionMeaning",
    "ActionTerm",
    "CommandMarker",
    "CommandTerm",
    "Term",
    "Uniform",
    "finite_limits",
    "joint_units",
]


class Term:
    """Base of terms with a state between calls.

    A term class takes ``(env, **params)`` and is called with the arguments that its manager passes
    to functions of that kind, without the parameters. Subclassing is optional: any class with
    `__call__` works; `reset`, `state_dict` and `load_state_dict` are called if it has them.

    Attributes:
        saved: Names of the attributes that are its state: arrays of constant shape, changed in
            place. Terms with another state extend `state_dict` and `load_state_dict`.
        watches: Whether an event changes nothing, such as one that films: it is called in the last
            step of an episode too.
        comes_first: Whether an event fires before the others of its mode, wherever it is declared.
        reads_images: Whether an observation is an image, whatever the type of its numbers; sensors
            have the same attribute. Values of uint8 in three dimensions are images without it.
        whole_batch: Why it needs all environments in one process; empty if it does not.
            `sim.backend=ray` refuses such terms.
    """

    saved: ClassVar[tuple[str, ...]] = ()
    watches: ClassVar[bool] = False
    comes_first: ClassVar[bool] = False
    reads_images: ClassVar[bool] = False
    whole_batch: ClassVar[str] = ""

    def reset(self, env_ids: EnvIndex | None) -> None:
        """Clear the state of the episode of these environments.

        Args:
            env_ids: (n,) sorted unique int64, or None for all.
        """

    def state_dict(self) -> dict[str, Any]:
        """The state from which the term continues bit for bit (copies)."""
        return {name: getattr(self, name).copy() for name in self.saved}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        for name in self.saved:
            getattr(self, name)[...] = state[name]


_UNLIMITED = 2.0 * np.pi
"""Bound of an action for a joint without a limit, rad (or m): one turn in each direction.

Action spaces must be finite, for learners and for random actions.
"""


def finite_limits(
    limits: ArrayLike, joint_ids: Sequence[int] | NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return (A,) lowest and highest positions, rad or m; unlimited sides get +-`_UNLIMITED`.

    Args:
        limits: (D, 2) joint limits, infinite where there is none.
        joint_ids: The A joints, in the order of the action.
    """
    ranges = np.asarray(limits, np.float64)[np.asarray(joint_ids, np.int64)]
    low, high = np.where(np.isfinite(ranges), ranges, [-_UNLIMITED, _UNLIMITED]).T
    return low, high


@dataclass(frozen=True, slots=True)
class ActionMeaning:
    """What the columns of an action term command, for tables, logs and data sets.

    Attributes:
        quantity: What is commanded, such as ``joint position``: of all columns, or of each.
        mode: ``absolute``, or ``delta``: a change from `reference` in each control step.
        reference: What a delta is added to, ``target`` or ``qpos``.
        frame: The axes of a pose or a motion: ``base``, ``world`` or ``tool``.
        units: The unit of the value: of all columns, or of each.
    """

    quantity: str | tuple[str, ...] = ""
    mode: Literal["", "absolute", "delta"] = ""
    reference: str = ""
    frame: str = ""
    units: str | tuple[str, ...] = ""

    def of(self, part: Literal["quantity", "units"], count: int) -> tuple[str, ...]:
        """A part for each of `count` columns."""
        value = self.quantity if part == "quantity" else self.units
        return (value,) * count if isinstance(value, str) else value


def joint_units(
    asset: Articulation,
    joint_ids: Iterable[int],
    control: Literal["position", "velocity", "effort"] = "position",
) -> tuple[str, ...]:
    """Return the units of joints: rad, rad/s or N m of hinges, and m, m/s or N of slides.

    Args:
        asset: The articulation.
        joint_ids: Indices of its joints.
        control: The quantity.
    """
    unit_of_hinge, unit_of_slide = _UNITS[control]
    model = asset.parsed.model
    units: list[str] = []
    for joint_id in joint_ids:
        name = asset.parsed.joint_names[joint_id]
        is_hinge = int(model.jnt_type[model.joint(name).id]) == _HINGE
        units.append(unit_of_hinge if is_hinge else unit_of_slide)
    return tuple(units)


_HINGE = 3
"""MuJoCo's ``mjJNT_HINGE``; MuJoCo itself is not imported for tables of terms."""
_UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "effort": ("N m", "N")}


class ActionTerm(Term):
    """Base of action terms; subclasses take ``(env, **params)``.

    Attributes:
        low: (A,) float32 lower bounds of its slice, finite, or -inf where there are none.
        high: (A,) float32 upper bounds, finite, or inf.
        names: Name of each column, for tables and logs.
        named_by: The entries of the config that name the columns' joints or controls, as written.
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    names: tuple[str, ...] = ()
    named_by: tuple[NamedBy, ...] = ()

    @property
    def action_dim(self) -> int:
        """Width A of its slice."""
        return len(self.low)

    def apply(self, action: torch.Tensor) -> None:
        """Apply the action; called once per control step, before physics.

        Args:
            action: (N, A) float32, finite.
        """
        raise NotImplementedError

    def before_physics(self) -> None:
        """Act before a physics step. The default does nothing.

        If a class overrides it, the physics of a control step is calculated step by step.
        """

    def centre_and_scale(self) -> tuple[Sequence[float | str], Sequence[float | str]]:
        """Centre and scale of each column, for tables: the value is centre + scale x action.

        Words stand for what is not a number; the default is empty words.
        """
        return [""] * self.action_dim, [""] * self.action_dim

    def meaning(self) -> ActionMeaning:
        """What the columns command; data sets say it. The default says nothing."""
        return ActionMeaning()

    def home(self) -> NDArray[np.float64]:
        """(A,) the action that goes to the initial state; policies explore around it."""
        return np.clip(np.zeros(len(self.low)), self.low, self.high)

    def hold(self) -> NDArray[np.float64]:
        """(N, A) or (A,) the action that keeps the present targets."""
        return self.home()

    def metrics(self) -> Mapping[str, Floats]:
        """How the last action was applied: name -> (N,). The default is empty."""
        return {}


@dataclass(frozen=True, slots=True)
class CommandMarker:
    """How viewers draw a command.

    Attributes:
        kind: Meaning of the columns. ``pose``: x, y, z, qw, qx, qy, qz in the frame of the body.
            ``velocity``: forward, left (m/s) and counter-clockwise (rad/s), in its heading frame.
        body: Id of the body.
    """

    kind: Literal["pose", "velocity"]
    body: int


class CommandTerm(Term):
    """Base of commands; subclasses take ``(env, **params)`` and set `names` and `values`.

    Attributes:
        names: Name of each column, for tables and logs.
        values: (N, K) float64, the commands in force. Other terms have views of it: write into it,
            never replace it.
        marker: How viewers draw it, if they can.
    """

    saved: ClassVar[tuple[str, ...]] = ("values",)
    names: tuple[str, ...] = ()
    values: Floats
    marker: CommandMarker | None = None

    def resample(self, env_ids: EnvIndex | None) -> None:
        """Draw new commands by `CommandManager.draw`; do not change other environments.

        Args:
            env_ids: (n,) sorted unique int64, or None for all.
        """
        raise NotImplementedError

    def update(self, env_ids: EnvIndex | None) -> None:
        """Adjust commands to the state, after every step and every draw. The default does nothing.

        Args:
            env_ids: (n,) environments that stepped or drew, or None for all.
        """

    def metrics(self) -> Mapping[str, Floats]:
        """Tracking errors of the commands now: name -> (N,). The default is empty."""
        return {}


class Uniform:
    """Numbers that a term draws uniformly, logged under a name.

    Args:
        name: Name in the log.
        low: Scalar or array, of the shape of one environment's draw.
        high: Likewise; exclusive.
        default: What stands for a draw where an event's `strength` is 0, scalar or array; None if
            `strength` does not act on it.

    Attributes:
        low, high: The bounds, read-only float64.
    """

    def __init__(self, name: str, low: Any, high: Any, default: Any = None) -> None:
        self.name = name
        self.low = constant(low)
        self.high = constant(high)
        self._default = None if default is None else constant(default)

    @classmethod
    def within(
        cls,
        name: str,
        bounds: Sequence[Any] | None,
        degrees: bool = False,
        default: Any = None,
    ) -> Uniform | None:
        """The numbers of a parameter [low, high], or of a box [[...], [...]]; None for None.

        Args:
            name: Name in the log.
            bounds: The parameter; [low, high] is a draw of shape (1,).
            degrees: Whether the bounds are in degrees; draws are in rad.
            default: As of the class, in the unit of draws.
        """
        if bounds is None:
            return None
        low, high = (np.atleast_1d(np.asarray(bound, np.float64)) for bound in bounds)
        if degrees:
            low = np.deg2rad(low)
            high = np.deg2rad(high)
        return cls(name, low, high, default)

    def __call__(self, draws: RandomDraws, env_ids: EnvIndex | None) -> Floats:
        """(n, ...) numbers for the environments given, or for all. Do not write into it."""
        shape = self.low.shape
        if self._default is None:
            return draws.draw(self.name, shape, self.low, self.high, env_ids)
        return draws.draw(self.name, shape, self.low, self.high, env_ids, default=self._default)
