"""Robots whose feet are geoms and whose tool is a site, as in most files of others."""

QUADRUPED = """
<mujoco model="quad">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="trunk" pos="0 0 0.32">
      <freejoint/>
      <geom name="torso" type="box" size="0.2 0.1 0.05" mass="6"/>
      <site name="imu" pos="0.03 -0.02 0.06" quat="0.8 0.1 -0.2 0.5"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
LEG = """
<body name="{n}_thigh" pos="{x} {y} 0">
  <joint name="{n}_hip" axis="0 1 0" range="-2 2" damping="0.2"/>
  <geom name="{n}_upper" type="capsule" fromto="0 0 0 -0.05 0 -0.15" size="0.02" mass="0.5"/>
  <body name="{n}_calf" pos="-0.05 0 -0.15">
    <joint name="{n}_knee" axis="0 1 0" range="-2 2" damping="0.2"/>
    <geom name="{n}_lower" type="capsule" fromto="0 0 0 0.05 0 -0.13" size="0.015" mass="0.2"/>
    <geom name="{n}" type="sphere" pos="0.05 0.01 -0.15" size="0.022" mass="0.05"
      quat="0.9 0.3 0.1 -0.2"/>
    <site name="{n}_foot" pos="0.05 0.01 -0.172" quat="0.7 -0.1 0.3 0.2"/>
  </body>
</body>
"""
LEGS = {"FR": (0.15, -0.1), "FL": (0.15, 0.1), "RR": (-0.15, -0.1), "RL": (-0.15, 0.1)}


def quadruped() -> str:
    """Four legs; the feet are the geoms FR, FL, RR, RL, and sites on the same calves."""
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, (x, y) in LEGS.items())
    joints = [f"{n}_{joint}" for n in LEGS for joint in ("hip", "knee")]
    motors = "".join(f'<position joint="{j}" kp="40" kv="1"/>' for j in joints)
    return QUADRUPED.format(legs=legs, motors=motors)


ARM = """
<mujoco model="arm">
  <compiler angle="radian"/>
  <worldbody>
    <body name="base">
      <geom type="cylinder" size="0.05 0.04" mass="2"/>
      <body name="l1" pos="0 0 0.1">
        <joint name="j1" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.03" mass="1"/>
        <body name="l2" pos="0 0 0.2">
          <joint name="j2" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
          <body name="l3" pos="0.3 0 0" quat="0.9 0.1 0.2 0.1">
            <joint name="j3" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.025" mass="0.5"/>
            <body name="hand" pos="0.2 0 0">
              <joint name="j4" axis="1 0 0"/>
              <joint name="j5" axis="0 1 0"/>
              <joint name="j6" axis="0 0 1"/>
              <geom name="palm" type="box" size="0.02 0.04 0.02" pos="0.02 0 0" mass="0.2"/>
              <site name="tcp" pos="0.08 0.01 -0.02" quat="0.7 0.1 0.7 -0.1"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
"""Six joints; the tool is the site `tcp`."""

WORLD = """
<mujoco model="room">
  <worldbody>
    <body name="crate" pos="0.5 0.3 0.2" euler="0 0 30">
      <freejoint/>
      <geom name="front" type="box" size="0.1 0.05 0.05" pos="0.02 0 0" mass="1"/>
      <geom name="back" type="box" size="0.02 0.05 0.09" pos="-0.1 0 0.03" mass="0.5"/>
      <site name="handle" pos="-0.12 0 0.1" euler="10 20 30"/>
    </body>
    <body name="shelf" pos="-1 0 0">
      <geom name="board" type="box" size="0.1 0.1 0.01"/>
      <site name="slot" pos="0 0 0.02"/>
    </body>
  </worldbody>
</mujoco>
"""
