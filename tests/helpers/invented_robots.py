"""Robots that no project has, as text: an arm with a gripper, and a dog with motors.

The tool of the arm is a site whose z axis points to a side; its keyframe is at the end of a range.
"""

_SERVOS = {"waist": 2.9, "shoulder": 1.8, "elbow": 2.6, "wrist1": 2.9, "wrist2": 2.2, "wrist3": 2.9}
_FINGER = """
<body name="finger_{n}" pos="0 0 0.03">
  <joint name="grip_{n}" type="slide" axis="0 {sign} 0" range="0 0.04"/>
  <geom type="box" size="0.01 0.006 0.035" pos="0 {y} 0.035" mass="0.03"/>
</body>
"""
GRIPPER_ARM = f"""<mujoco model="gripper_arm">
  <compiler angle="radian"/>
  <option timestep="0.004"/>
  <default>
    <joint damping="2" armature="0.05"/>
    <position kp="400" kv="40" forcerange="-80 80" ctrllimited="true"/>
  </default>
  <worldbody>
    <body name="base">
      <geom type="cylinder" size="0.06 0.05" pos="0 0 0.05" mass="3"/>
      <body name="turret" pos="0 0 0.1"><joint name="waist" axis="0 0 1" range="-2.9 2.9"/>
        <geom type="cylinder" size="0.05 0.04" pos="0 0 0.04" mass="1"/>
        <body name="upper" pos="0 0 0.08"><joint name="shoulder" axis="0 1 0" range="-1.8 1.8"/>
          <geom type="capsule" fromto="0 0 0.06 0 0 0.24" size="0.03" mass="1"/>
          <body name="fore" pos="0 0 0.3"><joint name="elbow" axis="0 1 0" range="-2.6 2.6"/>
            <geom type="capsule" fromto="0 0 0.06 0 0 0.19" size="0.025" mass="0.8"/>
            <body name="w1" pos="0 0 0.25"><joint name="wrist1" axis="0 0 1" range="-2.9 2.9"/>
              <geom type="capsule" fromto="0 0 0.03 0 0 0.05" size="0.02" mass="0.3"/>
              <body name="w2" pos="0 0 0.05"><joint name="wrist2" axis="0 1 0" range="-2.2 2.2"/>
                <geom type="capsule" fromto="0 0 0.02 0 0 0.04" size="0.02" mass="0.2"/>
                <body name="hand" pos="0 0 0.06">
                  <joint name="wrist3" axis="0 0 1" range="-2.9 2.9"/>
                  <geom type="box" size="0.02 0.06 0.015" pos="0 0 0.015" mass="0.2"/>
                  <camera name="wrist_cam" pos="0.06 0 0.02" euler="3.14159 0 0" fovy="60"/>
                  <site name="tcp" pos="0 0 0.09" euler="0 1.5708 0"/>
                  {_FINGER.format(n="l", sign=1, y=0.006)}
                  {_FINGER.format(n="r", sign=-1, y=-0.006)}
                </body></body></body></body></body></body></body>
  </worldbody>
  <actuator>
    {
    "".join(
        f'<position name="{n}" joint="{n}" ctrlrange="-{most} {most}"/>'
        for n, most in _SERVOS.items()
    )
}
    {
    "".join(
        f'<position name="grip_{n}" joint="grip_{n}" ctrlrange="0 0.04" kp="500" kv="20" '
        'forcerange="-30 30"/>'
        for n in "lr"
    )
}
  </actuator>
  <keyframe><key name="home" qpos="0 0.3 1.2 0 0.9 0 0.04 0.04"/></keyframe>
</mujoco>
"""
"""Six joints, two sliding fingers, position servos, a camera on the wrist; a time step of 4 ms."""

_LEG = """
<body name="{n}_shoulder" pos="{x} {y} 0">
  <joint name="{n}_abduct" axis="1 0 0" range="-0.8 0.8"/>
  <geom type="capsule" fromto="0 0 0 0 {w} 0" size="0.03" mass="0.5"/>
  <body name="{n}_upper" pos="0 {w} 0">
    <joint name="{n}_swing" axis="0 1 0" range="-1.5 2.5"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.8"/>
    <body name="{n}_lower" pos="0 0 -0.2">
      <joint name="{n}_bend" axis="0 1 0" range="-2.6 -0.4"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.18" size="0.014" mass="0.2"/>
      <geom name="{n}_pad" type="sphere" pos="0 0 -0.2" size="0.022" mass="0.05"/>
    </body>
  </body>
</body>
"""
_LEGS = {
    "left_front": (0.2, 0.06, 0.08),
    "right_front": (0.2, -0.06, -0.08),
    "left_hind": (-0.2, 0.06, 0.08),
    "right_hind": (-0.2, -0.06, -0.08),
}
_JOINTS = ("abduct", "swing", "bend")
MOTOR_DOG = f"""<mujoco model="dog">
  <compiler angle="radian"/>
  <option timestep="0.005"/>
  <default><joint damping="0.2" armature="0.01"/></default>
  <worldbody>
    <body name="body" pos="0 0 0.4">
      <freejoint/>
      <geom type="box" size="0.25 0.09 0.06" mass="7"/>
      {"".join(_LEG.format(n=n, x=x, y=y, w=w) for n, (x, y, w) in _LEGS.items())}
    </body>
  </worldbody>
  <actuator>
    {
    "".join(f'<motor joint="{n}_{j}" gear="1" ctrlrange="-30 30"/>' for n in _LEGS for j in _JOINTS)
}
  </actuator>
</mujoco>
"""
"""Four legs of three joints, which motors move, with no pose to stand in and no name for feet."""

PLIERS = """<mujoco model="pliers">
  <compiler angle="radian"/>
  <default>
    <joint damping="2" armature="0.05"/>
    <position kp="300" kv="30" forcerange="-60 60" inheritrange="1"/>
  </default>
  <worldbody>
    <body name="stand">
      <geom type="cylinder" size="0.06 0.05" pos="0 0 0.05" mass="3"/>
      <body name="a" pos="0 0 0.15"><joint name="a" axis="0 0 1" range="-2.9 2.9"/>
        <geom type="cylinder" size="0.04 0.03" mass="1"/>
        <body name="b" pos="0 0 0.05"><joint name="b" axis="0 1 0" range="-1.8 1.8"/>
          <geom type="capsule" fromto="0 0 0.05 0 0 0.23" size="0.025" mass="1"/>
          <body name="c" pos="0 0 0.28"><joint name="c" axis="0 1 0" range="-2.5 2.5"/>
            <geom type="capsule" fromto="0 0 0.05 0 0 0.2" size="0.02" mass="0.6"/>
            <body name="d" pos="0 0 0.25"><joint name="d" axis="0 1 0" range="-2.2 2.2"/>
              <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.02" mass="0.2"/>
              <body name="e" pos="0 0 0.05"><joint name="e" axis="0 0 1" range="-2.9 2.9"/>
                <geom type="box" size="0.02 0.05 0.01" mass="0.1"/>
                <body name="p" pos="0 0.035 0.01">
                  <joint name="p" axis="1 0 0" range="-0.5 0.35" damping="0.5"/>
                  <geom type="box" size="0.01 0.005 0.04" pos="0 -0.01 0.04" mass="0.03"/>
                </body>
                <body name="q" pos="0 -0.035 0.01">
                  <joint name="q" axis="-1 0 0" range="-0.5 0.35" damping="0.5"/>
                  <geom type="box" size="0.01 0.005 0.04" pos="0 0.01 0.04" mass="0.03"/>
                </body>
              </body></body></body></body></body></body>
  </worldbody>
  <actuator>
    <position joint="a"/><position joint="b"/><position joint="c"/><position joint="d"/>
    <position joint="e"/><position joint="p" kp="20" kv="1" forcerange="-3 3"/>
    <position joint="q" kp="20" kv="1" forcerange="-3 3"/>
  </actuator>
</mujoco>
"""
"""Five joints, two hinged fingers; nothing is called tool or finger."""
