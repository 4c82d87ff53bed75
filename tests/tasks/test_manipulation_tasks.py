"""Tasks with a gripper: scripted motions solve them, through the actions that a policy has.

What this shows is the physics: a grasp does not slip, a drawer opens, a button yields.
"""

import numpy as np
import pytest
import torch

import embodichain

pytestmark = [pytest.mark.unmeasured, pytest.mark.slow]

N = 8
TOOL = "gripper/tcp"
X, Y, Z = np.eye(3)


class Operator:
    """Moves the tools of all environments at once, at most 2 cm and 0.1 rad a control step."""

    def __init__(self, task, seed):
        self.env = embodichain.make(task, num_envs=N, overrides=[f"seed={seed}"])
        self.env.reset()
        self.robots = list(self.env.sim.robots.values())
        self.arm = 0  # the robot that moves
        self.grips = [1.0] * len(self.robots)
        self.successes = []
        self.width = self.env.single_action_space.shape[0] // len(self.robots)

    @property
    def at(self):
        return self.tool()[:, :3, 3]

    def tool(self):
        return self.robots[self.arm].get_link_pose(TOOL, to_matrix=True).numpy().astype(float)

    def step(self, move=0.0, turn=0.0):
        action = np.zeros((N, len(self.robots), self.width), np.float32)
        action[:, self.arm, :3] = np.asarray(move) / 0.02
        if self.width == 7:
            action[:, self.arm, 5] = np.asarray(turn) / 0.1
        action[:, :, -1] = self.grips
        *_, terminated, truncated, info = self.env.step(torch.from_numpy(action.reshape(N, -1)))
        assert not (terminated | truncated | info["diverged"]).any()
        self.successes.append(info["metrics"]["success"].numpy() > 0)

    def wait(self, steps):
        for _ in range(steps):
            self.step()

    def hold(self, grip, steps=15):
        self.grips[self.arm] = grip
        self.wait(steps)

    def go(self, to, speed=1.0):
        """Moves to positions (N, 3), m, in straight lines; corrects at the end what is missing."""
        for _ in range(2):
            way = to - self.at
            count = int(np.ceil(np.linalg.norm(way, axis=1).max() / (0.02 * speed)))
            for _ in range(count):
                self.step(way / count)
            self.wait(4)

    def align(self, pose):
        """Turns about the vertical, so that the fingers are parallel to faces of a cube."""
        matrix = self.tool()
        have = np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])
        want = np.arctan2(pose[:, 1, 0], pose[:, 0, 0])
        angle = (want - have + np.pi / 4) % (np.pi / 2) - np.pi / 4
        for _ in range(8):
            self.step(turn=angle / 8)

    def pose(self, uid):
        return self.env.sim.get_rigid_object(uid).get_local_pose(to_matrix=True).numpy()


@pytest.fixture
def operator():
    made = []

    def build(task, seed):
        made.append(Operator(task, seed))
        return made[-1]

    yield build
    for one in made:
        one.env.close()


def put(operator, uid, height):
    """Grasps the cube, and puts its middle `height` metres above that of another object."""
    cube = operator.pose("cube")
    start, up = cube[:, :3, 3], np.array([0, 0, 0.12])
    operator.go(start + up)
    operator.align(cube)
    operator.go(start, speed=0.5)
    operator.hold(-1.0)
    offset = operator.pose("cube")[:, :3, 3] - operator.at
    operator.go(start + up, speed=0.5)
    goal = operator.pose(uid)[:, :3, 3] + height * Z - offset
    operator.go(goal + up, speed=0.7)
    slip = operator.pose("cube")[:, :3, 3] - operator.at - offset
    operator.go(goal + 0.001 * Z, speed=0.4)
    assert not operator.successes[-1].any()  # held, not released
    operator.hold(1.0)
    operator.go(goal + up)
    operator.wait(5)
    return slip


PLACES = pytest.mark.parametrize(
    ("task", "uid", "height"), [("pick_place", "stand", 0.045), ("stack_cubes", "base", 0.05)]
)


@PLACES
def test_success_is_a_released_cube_2_cm_beside_the_middle_at_most(operator, task, uid, height):
    run = operator(task, seed=5)
    beside = np.zeros((N, 3))
    beside[:6, :2] = [[0, 0], [0.019, 0], [0.021, 0], [0, -0.019], [0.015, 0.015], [0.013, 0.013]]
    pose = run.env.sim.get_rigid_object(uid).get_local_pose()
    pose[:, :3] += torch.from_numpy(beside + height * Z).float()
    pose[6, 2] += 0.1  # falls
    pose[7, :3] = torch.tensor([0.65, 0.0, 0.725])  # on the table
    run.env.sim.get_rigid_object("cube").set_local_pose(pose)
    run.step()
    wanted = [True, True, False, True, False, True, False, False]
    assert run.successes[-1].tolist() == wanted
    run.hold(-1.0)
    assert not run.successes[-1].any()  # the gripper is closed
    run.hold(1.0)
    wanted[6] = True  # it has landed
    assert run.successes[-1].tolist() == wanted


@PLACES
def test_a_cube_is_put_on_something(operator, task, uid, height):
    run = operator(task, seed=3)
    slip = put(run, uid, height)
    assert np.abs(slip).max() < 0.003  # the grasp does not slip
    assert run.successes[-1].sum() >= 7
    above = run.pose("cube")[:, :3, 3] - run.pose(uid)[:, :3, 3]
    done = run.successes[-1]
    assert np.abs(above[done, :2]).max() < 0.02 and np.abs(above[done, 2] - height).max() < 0.002


def test_the_peg_is_put_into_the_hole(operator):
    run = operator("peg_in_hole", seed=3)
    block = run.env.sim.get_articulation("block")
    hole = block.get_link_pose("hole", to_matrix=True).numpy()
    peg = run.pose("peg")
    start = peg[:, :3, 3] + 0.03 * Z
    run.go(start + 0.12 * Z)
    run.align(peg)
    run.go(start, speed=0.5)
    run.hold(-1.0)
    run.go(start + 0.12 * Z, speed=0.5)
    run.align(hole)
    for height in (0.08, 0.055, 0.03, 0.002):
        way = hole[:, :3, 3] + height * Z - run.pose("peg")[:, :3, 3]
        run.go(run.at + way, speed=0.5)
    assert not run.successes[-1].any()  # in the hole, but not released
    run.hold(1.0)
    run.go(run.at + 0.1 * Z)
    assert run.successes[-1].sum() >= 7
    inside = run.pose("peg")[:, :3, 3] - hole[:, :3, 3]
    assert np.abs(inside[run.successes[-1]]).max() < 0.002  # 1 mm of play on each side


def test_the_bar_is_handed_over(operator):
    run = operator("hand_over", seed=3)

    def grasp(along):
        bar = run.pose("bar")
        end = bar[:, :3, 3] + along * bar[:, :3, 1]
        run.go(end + 0.12 * Z)
        run.align(bar)
        run.go(end, speed=0.5)
        run.hold(-1.0)

    grasp(-0.15)
    middle = np.array([0.65, 0.0, 0.45]) - run.pose("bar")[:, :3, 3]
    run.go(run.at + middle[:, 2:] * Z, speed=0.5)
    run.go(run.at + middle * [1, 1, 0], speed=0.5)
    run.arm = 1
    grasp(0.15)
    assert not np.any(run.successes)  # the right arm has not let go
    run.arm = 0
    run.hold(1.0)
    run.go(run.at + 0.1 * Z)
    assert run.successes[-1].sum() >= 7
    run.arm = 1
    run.go(run.at + (0.1 * Y + 0.05 * Z), speed=0.5)
    run.wait(10)
    assert run.successes[-1].sum() >= 7  # it carries the bar away


def test_the_button_is_pressed_and_comes_back(operator):
    run = operator("press_button", seed=3)
    button = run.env.sim.get_articulation("button")
    cap = button.get_link_pose("cap", to_matrix=True).numpy()[:, :3, 3]
    assert np.ptp(cap[:, 0]) > 0.05 and np.ptp(cap[:, 1]) > 0.1  # placed anew everywhere
    run.hold(-1.0, 20)
    run.go(cap + 0.06 * Z)
    assert not np.any(run.successes)
    assert np.abs(button.get_qpos().numpy()).max() < 1e-4  # at rest at 0
    run.go(cap + (0.0205 - 0.004) * Z, speed=0.3)  # the tips are 20.5 mm below the tool
    assert not run.successes[-1].any()  # 4 mm are not enough
    assert button.get_qpos().numpy() == pytest.approx(0.004, abs=0.002)
    run.go(cap + (0.0205 - 0.0105) * Z, speed=0.3)
    assert run.successes[-1].sum() >= 7
    run.go(cap + 0.06 * Z)
    assert run.successes[-1].sum() >= 7  # once is enough
    assert np.abs(button.get_qpos().numpy()).max() < 1e-3


def test_the_drawer_is_opened_by_its_handle(operator):
    run = operator("open_drawer", seed=3)
    cabinet = run.env.sim.get_articulation("cabinet")
    upper, lower = (cabinet.parsed.joint_names.index(name) for name in ("upper", "lower"))
    handle = cabinet.get_link_pose("upper_handle", to_matrix=True).numpy()[:, :3, 3]
    assert np.ptp(handle[:, 1]) > 0.1
    run.go(handle - 0.08 * X)
    run.go(handle + 0.005 * X, speed=0.5)
    assert cabinet.get_qpos().numpy().max() < 0.001
    run.hold(-1.0)
    run.go(run.at - 0.12 * X, speed=0.5)
    assert not run.successes[-1].any()  # 12 cm are not enough
    run.go(run.at - 0.06 * X, speed=0.5)
    assert run.successes[-1].sum() >= 7
    opened = cabinet.get_qpos().numpy()
    assert opened[:, upper][run.successes[-1]].min() >= 0.15
    assert np.abs(opened[:, lower]).max() < 1e-3
    run.hold(1.0)
    run.go(run.at - 0.05 * X)
    assert run.successes[-1].sum() >= 7  # it stays open
