"""`WebView`: shows a running environment on MuJoCo Studio's page.

Without a browser, the cost per step is the test of a flag.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from embodichain.lab.gym.envs.observers import StepObserver, StepRecord
from embodichain.lab.sim.engine.api import Write
from embodichain.recording.viewers.page.teleop_status import PageOperator, TeleopStatus
from embodichain.recording.viewers.page.web_page import LOOKS, Facts, PageOptions, WebPage
from embodichain.utils.array_types import EnvIds, host_ids
from embodichain.utils.number_text import result_number, signed_number

if TYPE_CHECKING:
    from embodichain.lab.gym.envs.observers import ObservedEnv
    from embodichain.lab.gym.teleop import Teleop

__all__ = ["PageOptions", "WebView"]

_INTERVAL = 1.0 / 60.0
"""Least seconds between two states, if steps run as fast as possible."""
_FACTS_INTERVAL = 1.0 / 20.0
"""Likewise, between two texts next to the picture."""


class WebView(StepObserver):
    """Serves a page that shows one environment, with buttons for pause, step and reset.

    Attach it with `env.add_observer`; closing the environment closes it.

    Args:
        env: The environment.
        options: Address of the page, and its initial state.
        stopped: Whether the run was stopped, which ends a pause.
        teleop: The policy of a person who moves the robot on this page, bound to `env`.

    Attributes:
        url: Address of the page, with its token.
        url_once: An address that opens the page once, for a browser's command line.
        address: The address without a token, for logs.

    Raises:
        ConfigError: If the address cannot be listened on, or `options.access` does not fit it.
    """

    def __init__(
        self,
        env: ObservedEnv,
        options: PageOptions | None = None,
        *,
        stopped: Callable[[], bool] = lambda: False,
        teleop: Teleop | None = None,
    ) -> None:
        options = replace(options or PageOptions(), teleop=teleop is not None)
        self._teleop: TeleopStatus | None = None
        if teleop is not None:
            self._teleop = TeleopStatus(env, teleop)
        self._env_id = options.env_id
        model = env.sim.engine.model_of(self._env_id)
        self._page = WebPage(model, options, num_envs=env.num_envs, stopped=stopped)
        self.url = self._page.url
        self.url_once = self._page.url_once
        self.address = self._page.address
        self._has_new_look = False
        # When state and facts are due, in seconds of the monotonic clock.
        self._next_state = 0.0
        self._next_facts = 0.0
        self._step: StepRecord | None = None
        if teleop is not None:
            teleop.operator = PageOperator(self._page, lambda: self._show(env))

    @property
    def watched(self) -> bool:
        """Whether a browser has the page open."""
        return self._page.watched

    def refresh(self, env: ObservedEnv) -> None:
        """Show the present state again, of the environment that is now chosen."""
        if self._page.watched:
            self._show(env, with_facts=self._page.env_id != self._env_id)

    def finish(self) -> None:
        """Say in the panel that the run is over; its controls of the run are disabled."""
        self._page.finish()

    def on_write(self, env: ObservedEnv, write: Write) -> None:
        """Note if the appearance of the shown environment changes."""
        if write.op != "model" or write.field not in LOOKS:
            return
        if write.env_ids is None or self._env_id in host_ids(write.env_ids):
            self._has_new_look = True

    def on_reset(self, env: ObservedEnv, env_ids: EnvIds) -> None:
        """Show the new episode's first state at once."""
        if self._teleop is not None:
            self._teleop.begin()
        if self._page.watched and self._page.env_id in env_ids:
            self._show(env)

    def on_step(self, env: ObservedEnv, step: StepRecord) -> None:
        """Apply the controls; show the new state if a picture is due."""
        page = self._page
        if self._teleop is not None:
            self._teleop.note(step)
        if not page.watched:
            return
        reset_env = page.take_reset()
        if reset_env is not None:
            env.truncate(np.array([reset_env]))
        self._step = step
        now = time.monotonic()
        if not page.fast or now >= self._next_state:
            self._next_state = now + _INTERVAL
            with_facts = now >= self._next_facts
            if with_facts:
                self._next_facts = now + _FACTS_INTERVAL
            self._show(env, with_facts)
        page.pace(env.step_dt, lambda: self._show(env))

    def on_close(self, env: ObservedEnv) -> None:
        """Close the page."""
        self._page.close()

    def _show(self, env: ObservedEnv, with_facts: bool = True) -> None:
        """Send the current state of the chosen environment."""
        env_id = self._page.env_id
        if env_id != self._env_id or self._has_new_look:
            self._env_id = env_id
            self._has_new_look = False
            self._page.show_model(env.sim.engine.model_of(env_id))
        facts = None
        if with_facts and self._step is not None:
            facts = _facts(env, self._step, env_id)
        engine = env.sim.engine
        commands = [command.of_env(env_id) for command in engine.commands]
        self._page.show(engine.rows[env_id], facts, commands)
        if self._teleop is not None:
            self._page.tell(self._teleop.status())


def _facts(env: ObservedEnv, step: StepRecord, i: int) -> Facts:
    """The text that the page shows next to the picture."""
    info = step.info
    weights = env.reward_manager.weights
    rewards = {
        name: value * weights.get(name, 1.0) for name, value in _row(info["rewards"], i).items()
    }
    sums = _row(info["episode_sums"], i)
    episode_reward = sum(sums.values())
    lines = [
        ("episode", str(int(step.episode_ids[i]))),
        (
            "reward",
            f"{signed_number(step.reward[i])}, {signed_number(episode_reward)} in this episode",
        ),
    ]
    for name, value in _row(info["metrics"], i).items():
        lines.append((name, result_number(value)))
    return Facts(
        step=step.control_step - 1,
        seconds=info["elapsed_steps"].numpy().item(i) * env.step_dt,
        lines=tuple(lines),
        rewards=rewards,
        sums=sums,
    )


def _row(values: Mapping[str, Any], i: int) -> dict[str, float]:
    """One environment's values from (N,) tensors."""
    return {name: tensor.numpy(force=True).item(i) for name, tensor in values.items()}
