"""`CopiedEnv`: an environment with arrays on a device, as observers see it: copies on the host."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from embodichain.lab.gym.envs.managers.value_managers import TermRows
from embodichain.lab.gym.envs.observers import EngineRelay, EventRecord, StepObserver, StepRecord
from embodichain.lab.sim.engine.warp.copied_engine import CopiedEngine
from embodichain.utils.tensor_mapping import TensorMapping

if TYPE_CHECKING:
    from embodichain.lab.sim.engine.api import EnvIndex

__all__ = ["CopiedEnv"]

Arrays = Mapping[str, NDArray[Any]]


class _StandIn:
    """Stands for an object: it has some attributes of its own, and passes on all others.

    Args:
        owner: The object.
        **attributes: Those of its own.
    """

    def __init__(self, owner: Any, **attributes: Any) -> None:
        self.__dict__.update(attributes, _owner=owner)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the object."""
        return getattr(self.__dict__["_owner"], name)


class CopiedEnv(_StandIn):
    """What observers use of an environment (`ObservedEnv`), with arrays of the host.

    Its arrays are those of the last copy, one or two control steps late. It has no sensors, and its
    steps have no observations: they are not copied.

    Args:
        env: The environment.
        catch_up: Waits for the device, and reports everything up to now.

    Attributes:
        observers: The observers.
        engine: The engine of `sim`, which is otherwise that of the environment.
        control_step: Control steps that were copied.
        termination_manager, reward_manager, command_manager: Those of the environment, with values
            and weights of the last copy.
    """

    num_envs: int
    control_step: int

    def __init__(self, env: Any, catch_up: Callable[[], None]) -> None:
        self.engine = CopiedEngine(env.sim.engine)
        self._commands: dict[str, NDArray[np.float64]] = {}
        terms: dict[str, Any] = {}
        for name, term in env.command_manager.terms.items():
            values = term.instance.values.host().astype(np.float64)
            self._commands[name] = values
            terms[name] = _StandIn(term, instance=_StandIn(term.instance, values=values))
        super().__init__(
            env,
            sim=_StandIn(env.sim, engine=self.engine, sensors={}),
            command_manager=_StandIn(env.command_manager, terms=terms),
            reward_manager=_StandIn(env.reward_manager),
            termination_manager=_StandIn(env.termination_manager, values={}),
            control_step=int(env.control_step),
            catch_up=catch_up,
            observers=list[StepObserver](),
        )
        # With the attributes of the environment it is an `ObservedEnv`; a type checker sees none.
        self._as_observed: Any = self
        self.engine.listeners.append(EngineRelay(self._as_observed))

    def put_commands(self, values: Arrays) -> None:
        """Set the commands in force, name -> (N, K)."""
        for name, command in values.items():
            self._commands[name][...] = command

    def event(self, term: str, mode: str, mask: NDArray[np.bool_] | None, drawn: Arrays) -> None:
        """Report that a term fired.

        Args:
            term: The term.
            mode: The mode.
            mask: (N,) environments in which it fired; None is all.
            drawn: Its draws, (N, ...) each.
        """
        ids = None if mask is None or mask.all() else np.flatnonzero(mask)
        if ids is not None and not len(ids):
            return
        where: Any = slice(None) if ids is None else ids
        values = {name: array[where].astype(np.float64) for name, array in drawn.items()}
        record = EventRecord(term=term, mode=mode, env_ids=ids, drawn=values)
        for observer in self.observers:
            observer.on_event(self._as_observed, record)

    def reset(self, env_ids: EnvIndex) -> None:
        """Report that environments (n,) were reset."""
        if len(env_ids):
            for observer in self.observers:
                observer.on_reset(self._as_observed, env_ids)

    def step(
        self,
        results: Arrays,
        info: Arrays,
        groups: Mapping[str, tuple[tuple[str, ...], NDArray[Any]]],
        weights: Mapping[str, float],
    ) -> None:
        """Report the end of a control step.

        Args:
            results: ``action``, ``reward``, ``terminated``, ``truncated``, ``episode_ids``.
            info: Entries (N,) of ``info``.
            groups: ``rewards``, ``episode_sums``, ``metrics`` and ``terminations``: names, and
                their values (K, N).
            weights: The weights of the reward terms in it.
        """
        self.control_step += 1
        self.reward_manager.weights = weights
        values: dict[str, Any] = {}
        for key, (names, rows) in groups.items():
            values[key] = TermRows(names, rows) if names else {}
        self.termination_manager.values = values.pop("terminations")
        record = StepRecord(
            control_step=self.control_step,
            action=results["action"].astype(np.float64),
            reward=results["reward"],
            terminated=results["terminated"],
            truncated=results["truncated"],
            info={**info, **values},
            obs=TensorMapping({}),
            episode_ids=results["episode_ids"],
        )
        for observer in self.observers:
            observer.on_step(self._as_observed, record)

    def close(self) -> None:
        """Report that the environment closes, even if an observer raises."""
        with ExitStack() as stack:  # the last callback first
            for observer in reversed(self.observers):
                stack.callback(observer.on_close, self._as_observed)
