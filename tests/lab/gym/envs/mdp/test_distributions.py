"""Every distribution x operation x sign of the compiled value, 1,000 draws against its formula.

Seeds are fixed; bounds are at five standard errors.
"""

import numpy as np
import pytest

import embodichain
from embodichain.lab.gym.envs.mdp._model_fields import Values
from embodichain.lab.gym.envs.mdp.events.randomize import DrawnField, FieldDraw

N = 1000
COMPILED = (-9.81, 0.0, 2.5)
RANGES = {"add": (0.5, 3.0), "scale": (0.8, 1.3), "abs": (0.5, 3.0)}
MIXED = {"add": (-2.0, 1.0), "scale": (-0.5, 1.5), "abs": (-2.0, 1.0)}


def moments(distribution, low, high):
    """Mean and standard deviation of the number drawn, by the definition."""
    if distribution == "uniform":
        return (low + high) / 2, (high - low) / np.sqrt(12)
    if distribution == "gaussian":  # clipped at three standard deviations: 1.3 % less spread
        return (low + high) / 2, 0.9866 * (high - low) / 6
    width = np.log(high / low)
    mean = (high - low) / width
    return mean, np.sqrt((high**2 - low**2) / (2 * width) - mean**2)


def check(values, distribution, operation, compiled, low, high):
    ends = {"add": [compiled + low, compiled + high], "abs": [low, high]}
    ends["scale"] = [compiled * low, compiled * high]
    least, most = sorted(ends[operation])
    tiny = 1e-9 * max(1.0, abs(least), abs(most))
    assert values.min() >= least - tiny and values.max() <= most + tiny
    mean, std = moments(distribution, low, high)
    shift = {"add": compiled, "scale": 0.0, "abs": 0.0}[operation]
    factor = compiled if operation == "scale" else 1.0
    assert values.mean() == pytest.approx(shift + factor * mean, abs=5 * std * abs(factor) / N**0.5)
    assert values.std() == pytest.approx(std * abs(factor), rel=5 * (3 / (4 * N)) ** 0.5)
    if factor:
        # A normal number beyond three standard deviations is at a bound: 0.27 % of them.
        assert len(np.unique(values)) > 0.98 * N


@pytest.fixture(scope="module")
def env():
    with_many = embodichain.make("cart_pole", num_envs=N, seed=3)
    yield with_many
    with_many.close()


@pytest.mark.parametrize("operation", ["add", "scale", "abs"])
@pytest.mark.parametrize("distribution", ["uniform", "log_uniform", "gaussian"])
@pytest.mark.parametrize("compiled", COMPILED)
def test_a_thousand_draws_follow_the_formula(env, distribution, operation, compiled):
    given = [RANGES[operation]]
    given += [MIXED[operation]] if distribution != "log_uniform" else []
    for low, high in given:
        values = Values(["it"], np.array([compiled]), lambda ids: lambda drawn, ids: None)
        field = DrawnField("it", [low, high], operation, values)
        (drawn,) = FieldDraw({"it": field}, distribution)(env, None)
        check(drawn[:, 0], distribution, operation, compiled, low, high)


FIELDS = {
    "gravity": ("opt.gravity", 2, -9.81, "{gravity: [[1, 1, 0.8], [1, 1, 1.2]]"),
    "randomize_physics_scene_gravity": (
        *("opt.gravity", 2, -9.81),
        "{gravity_range: [[1, 1, 0.8], [1, 1, 1.2]]",
    ),
    "lower_limit": (
        *("jnt_range", 0, None),
        "{of: {uid: cart_pole, joint_names: [slider_to_cart]}, lower_limit: [0.8, 1.2]",
    ),
    "randomize_joint_parameters": (
        *("jnt_range", 0, None),
        "{of: {uid: cart_pole, joint_names: [slider_to_cart]}, lower_limit_range: [0.8, 1.2]",
    ),
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("distribution", ["uniform", "log_uniform", "gaussian"])
def test_a_negative_field_of_a_task_is_drawn_by_its_formula(name, distribution):
    field, column, compiled, params = FIELDS[name]
    func = name if name.startswith("randomize_") else "randomize"
    event = f"{{func: {func}, mode: reset, params: {params}, operation: scale, "
    event += f"distribution: {distribution}}}}}"
    env = embodichain.make(
        "cart_pole", num_envs=N, seed=3, overrides=[f"+task.events.vary={event}"]
    )
    env.reset()
    if compiled is None:
        compiled = float(env.sim.engine.model.jnt_range.reshape(-1)[column])
    assert compiled < 0
    rows = np.asarray(env.sim.engine.model_field(field)).reshape(N, -1)
    check(rows[:, column], distribution, "scale", compiled, 0.8, 1.2)
    env.close()
