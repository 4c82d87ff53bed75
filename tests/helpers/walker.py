"""A small robot with a floating base, for tests of terms: a trunk, two legs with feet, a rotor."""

from pathlib import Path
from typing import Any

from embodichain.lab.sim.cfg import JointDrivePropertiesCfg, RobotCfg

MJCF = """<mujoco model="walker"><compiler angle="radian"/>
  <worldbody><body name="trunk" pos="0 0 1"><freejoint/>
    <geom type="box" size="0.2 0.1 0.05" mass="4"/>
    <body name="left_leg" pos="0 0.1 0"><joint name="left_hip" axis="0 1 0" range="-1 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      <body name="left_foot" pos="0 0 -0.3"><geom size="0.03" mass="0.1"/></body></body>
    <body name="right_leg" pos="0 -0.1 0"><joint name="right_hip" axis="0 1 0" range="-1 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      <body name="right_foot" pos="0 0 -0.3"><geom size="0.03" mass="0.1"/></body></body>
    <body name="rotor" pos="0 0 0.1"><joint name="spin" axis="0 0 1"/>
      <geom size="0.02" mass="0.1"/></body>
  </body></worldbody></mujoco>"""


def walker(folder: Path, **fields: Any) -> RobotCfg:
    """The robot, uid ``go``, written into a folder and standing 2 m above the floor."""
    path = folder / "walker.xml"
    path.write_text(MJCF)
    drives = JointDrivePropertiesCfg(stiffness=100.0, damping=5.0)
    base: dict[str, Any] = {"uid": "go", "fix_base": False, "drive_pros": drives}
    return RobotCfg(fpath=str(path), init_pos=(0.0, 0.0, 2.0), **{**base, **fields})
