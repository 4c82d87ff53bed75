"""Every mistake of the table gives its exact report: place, key path, what is allowed."""

from pathlib import Path

import pytest

from embodichain.config import compose, list_options, resolve, validate
from embodichain.lab.gym.envs.managers.terms.registry import TERMS
from embodichain.lab.gym.utils.registration import REGISTERED_ENVS
from embodichain.utils.errors import ConfigError
from tests.config.checks.bad_configs import BAD, Bad
from tests.config.conftest import WriteTask


def expected(case: Bad) -> list[str]:
    values = {
        "{cwd}": str(Path.cwd()),
        "{tasks}": ", ".join(list_options("task")),
        "{first_tasks}": "cart_pole, cart_pole_swing_up, clutter_pick, "
        f"... ({len(list_options('task'))} in all: `embodichain list tasks`)",
        "{rewards}": "within_distance, within_orientation, within_pose, "
        f"... ({len(TERMS['reward'])} in all: `embodichain list terms`)",
        "{classes}": ", ".join(sorted(REGISTERED_ENVS)) or "none",
    }
    lines = list(case.says)
    for name, value in values.items():
        lines = [line.replace(name, value) for line in lines]
    return lines


@pytest.mark.parametrize("name", BAD)
def test_report(name: str, write_task: WriteTask) -> None:
    case = BAD[name]
    write_task(case.old, case.new)
    Path("broken.urdf").write_text('<robot name="x"><link name="a"></robot>')
    lines = [*([f"task={case.task}"] if case.task else []), *case.overrides]

    found = [str(problem) for problem in validate(compose(lines, case.verb), case.verb)]

    wanted = expected(case)
    if wanted[0].endswith("..."):
        assert found[0].startswith(wanted[0].removesuffix("..."))
        found, wanted = found[1:], wanted[1:]
    assert found == wanted


def test_there_are_enough() -> None:
    assert len(BAD) >= 30


def test_the_good_task_is_good(write_task: WriteTask) -> None:
    write_task()
    assert validate(compose(["task=mine"])) == []


def test_resolve_raises_all_of_it_at_once(write_task: WriteTask) -> None:
    case = BAD["several at once"]
    write_task(case.old, case.new)
    with pytest.raises(ConfigError) as error:
        resolve(["task=mine", *case.overrides])
    assert str(error.value).splitlines() == expected(case)
