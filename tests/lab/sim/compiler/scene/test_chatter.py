"""Limited drives that chatter, on plain MuJoCo: what `chatter` predicts is what is simulated."""

import mujoco
import numpy as np
import pytest

from embodichain.lab.sim.cfg import (
    JointDrivePropertiesCfg,
    PhysicsCfg,
    RobotCfg,
    SimulationManagerCfg,
)
from embodichain.lab.sim.compiler.robot.articulation import parse_articulation
from embodichain.lab.sim.compiler.robot.drives.chatter import PhysicsStep
from embodichain.lab.sim.compiler.robot.drives.drive_changes import DriveChange
from tests.lab.sim.compiler.helpers import UR10, scene_of, write

PANDA = "panda_description/urdf/panda.urdf"

ONE_JOINT = """<mujoco>
  <worldbody>
    <body name="link">
      <joint name="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
    </body>
  </worldbody>
</mujoco>"""


def one_joint(tmp_path, inertia: float, **drives) -> RobotCfg:
    """A hinge with this inertia and a limited drive, with the gains of a URDF's by default."""
    path = write(tmp_path / "one.xml", ONE_JOINT.format(inertia=inertia))
    pros = JointDrivePropertiesCfg(**{"stiffness": 1e4, "damping": 1e3, **drives})
    return RobotCfg(uid="one", fpath=path, drive_pros=pros)


def physics(dt: float, integrator: str = "implicitfast") -> SimulationManagerCfg:
    config = PhysicsCfg(gravity=(0, 0, 0), integrator=integrator)
    return SimulationManagerCfg(physics_dt=dt, physics_config=config, ground_plane=False)


def last_speed(model: mujoco.MjModel, dofs, starts, seconds: float = 5.0) -> float:
    """The largest speed of these joints at the end, over several initial (qpos, qvel)."""
    worst = 0.0
    for qpos, qvel in starts:
        data = mujoco.MjData(model)
        data.qpos[model.jnt_qposadr[model.dof_jntid[dofs]]] = qpos
        data.qvel[dofs] = qvel
        for _ in range(round(seconds / model.opt.timestep)):
            mujoco.mj_step(model, data)
        for _ in range(4):
            mujoco.mj_step(model, data)
            worst = max(worst, float(np.abs(data.qvel[dofs]).max()))
    return worst


@pytest.mark.parametrize("dt", [0.002, 0.01])
@pytest.mark.parametrize(("stiffness", "damping"), [(1e4, 1e3), (500.0, 50.0), (25.0, 0.5)])
@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
def test_the_cycle_of_two_steps_lives_just_below_the_bound_only(
    tmp_path, dt, stiffness, damping, integrator
):
    # By hand: q = -+ dt v / 2 at +-v with v = dt effort / 2 M is a cycle if the force is clipped.
    effort, bound = 12.0, 0.5 * dt * damping + 0.25 * dt**2 * stiffness

    def jitter(inertia: float) -> float:
        cfg = one_joint(
            tmp_path,
            inertia,
            stiffness=stiffness,
            damping=damping,
            max_effort=effort,
            armature=0.0,
        )
        model = scene_of({"one": cfg}, sim=physics(dt, integrator)).model
        speed = dt * effort / (2 * inertia)
        return last_speed(model, [0], [(-dt * speed / 2, -speed), (0.0, 3 * speed)]) / speed

    assert jitter(0.97 * bound) == pytest.approx(1.0, rel=1e-3)  # it goes on for ever
    assert jitter(1.03 * bound) < 1e-6


def test_the_least_armature_is_added_and_the_joint_is_quiet(tmp_path, caplog):
    # bound = 0.0025 x 1e3 + 0.25 x 0.005^2 x 1e4 = 2.5625; of it the link has 0.002
    cfg = one_joint(tmp_path, 0.002, max_effort=12.0)
    parsed = parse_articulation("one", cfg, PhysicsStep(0.005))
    assert parsed.added_armature.tolist() == [2.6]  # 2.5605, up to two digits
    scene = scene_of({"one": cfg}, sim=physics(0.005))
    assert scene.model.dof_armature.tolist() == [2.6]
    assert scene.model.dof_M0[0] == pytest.approx(2.602)
    assert last_speed(scene.model, [0], [(1.0, 0.0), (0.0, 0.05)]) < 1e-6
    assert (
        "drive_pros.armature is raised: limited drives would chatter at a time step of 0.005 s; "
        "enough is {hinge: 2.6}" in caplog.text
    )
    plain = scene_of({"one": one_joint(tmp_path, 0.002, max_effort=12.0, armature=0.0)})
    plain.model.opt.timestep, plain.model.opt.gravity[:] = 0.005, 0
    assert last_speed(plain.model, [0], [(1.0, 0.0)]) > 10.0


def test_armature_that_the_user_gave_stays_and_a_note_says_what_would_do(tmp_path):
    cfg = one_joint(tmp_path, 0.002, max_effort=12.0, armature=0.5)
    parsed = parse_articulation("one", cfg, PhysicsStep(0.005))
    assert parsed.armature.tolist() == [0.5] and not parsed.added_armature.any()
    (note,) = [n for n in parsed.notes if "armature" in n]
    assert "armature is too small" in note and "{hinge: 2.6}" in note
    enough = one_joint(tmp_path, 0.002, max_effort=12.0, armature=2.6)
    assert not parse_articulation("one", enough, PhysicsStep(0.005)).notes


def test_without_a_limit_nothing_is_added(tmp_path):
    cfg = one_joint(tmp_path, 0.002)
    assert not parse_articulation("one", cfg, PhysicsStep(0.005)).added_armature.any()
    # Euler and RK4 take the damper of an actuator explicitly, limited or not.
    assert parse_articulation("one", cfg, PhysicsStep(0.005, "Euler")).added_armature[0] == 2.6


@pytest.mark.parametrize(
    ("change", "added"),
    [
        (DriveChange("damping", None, (0.5, 2.0), "scale"), 5.1),  # 5.0625 - 0.002
        (DriveChange("stiffness", ("hin.*",), (0.0, 4e4), "add"), 2.9),  # 2.5 + 0.3125
        (DriveChange("stiffness", ("other",), (0.0, 4e4), "add"), 2.6),
        (DriveChange("strength", None, {"hinge": (0.8, 1.2)}), 3.1),  # 1.2 x 2.5625
        (DriveChange("mass", None, (0.5, 1.0), "scale"), 2.6),
        (DriveChange("max_effort", None, (5.0, 9.0)), 2.6),
    ],
)
def test_the_worst_that_events_may_draw_counts(tmp_path, change, added):
    cfg = one_joint(tmp_path, 0.002, max_effort=12.0)
    parsed = parse_articulation("one", cfg, PhysicsStep(0.005), [change])
    assert parsed.added_armature.tolist() == [added]


def test_a_lighter_link_and_a_limit_that_an_event_sets_count(tmp_path):
    heavy = one_joint(tmp_path, 3.0, max_effort=12.0)
    assert not parse_articulation("one", heavy, PhysicsStep(0.005)).added_armature.any()
    half = DriveChange("mass", None, (0.5, 1.0), "scale")
    lighter = parse_articulation("one", heavy, PhysicsStep(0.005), [half])
    assert lighter.added_armature.tolist() == [1.1]  # 2.5625 - 1.5
    limits = DriveChange("max_effort", None, (5.0, 9.0))
    free = one_joint(tmp_path, 0.002)
    assert parse_articulation("one", free, PhysicsStep(0.005), [limits]).added_armature[0] == 2.6


def test_joints_that_chatter_together_are_found():
    # A Panda's joints, each with the armature that its own inertia lacks, still chatter together.
    drives = {"stiffness": 400, "damping": 40, "max_effort": "file"}
    cfg = RobotCfg(uid="panda", fpath=PANDA, drive_pros=JointDrivePropertiesCfg(**drives))
    model = scene_of({"panda": cfg}, sim=physics(0.005)).model
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    dofs = np.arange(7)
    data = mujoco.MjData(model)
    home = np.array(parse_articulation("panda", cfg).init_qpos[:7])
    random = np.random.default_rng(0)
    limit = model.actuator_forcerange[:7, 1]

    def shaken() -> float:
        """Speed left after both phases of the cycle of two steps, with random signs."""
        data.qpos[:7] = home
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        inertia = inertia[:7, :7]
        starts = []
        for _ in range(12):
            speed = np.linalg.solve(inertia, random.choice([-1, 1], 7) * limit)
            speed *= 0.5 * model.opt.timestep
            starts.append((home + 0.5 * model.opt.timestep * speed, speed))
        return last_speed(model, dofs, starts, 3.0)

    keep = model.actuator_biasprm.copy()
    data.ctrl[:] = 0
    model.actuator_biasprm[:7, 0] = model.actuator_gainprm[:7, 0] * home  # targets at home
    assert shaken() < 1e-3
    own = np.full(7, np.inf)
    for _ in range(300):
        data.qpos[:7] = random.uniform(model.jnt_range[:7, 0], model.jnt_range[:7, 1])
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        own = np.minimum(own, np.diag(inertia)[:7] - model.dof_armature[:7])
    need = 0.0025 * 40 + 0.25 * 0.005**2 * 400
    model.dof_armature[:7] = np.maximum(0.0, need - own)
    assert shaken() > 1.0
    assert (keep[:7, 2] == -40).all()


def test_nothing_depends_on_chance_or_on_other_robots():
    cfg = RobotCfg(uid="a", fpath=UR10, drive_pros=JointDrivePropertiesCfg(max_effort="file"))
    first = parse_articulation("a", cfg, PhysicsStep())
    again = parse_articulation("b", cfg, PhysicsStep())
    assert first.added_armature.tolist() == again.added_armature.tolist()
    assert (first.added_armature > 0).all()
