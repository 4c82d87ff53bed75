"""A scene as an MJCF file: furniture, a cup, a door with a servo, a marker, a camera, a lamp."""

__all__ = ["KITCHEN"]

KITCHEN = """<mujoco model="kitchen">
  <compiler angle="degree"/>
  <option timestep="0.003" gravity="0 0 -3"/>
  <visual><headlight ambient=".2 .2 .2"/></visual>
  <default><geom friction="0.9"/></default>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="1 .8 .6" rgb2=".2 .3 .5"
             width="64" height="64"/>
    <texture name="tiles" type="2d" builtin="checker" rgb1=".8 .8 .8" rgb2=".4 .3 .3"
             width="64" height="64"/>
    <material name="tiles" texture="tiles" texrepeat="8 8"/>
  </asset>
  <worldbody>
    <light name="lamp" pos="0 0 3" dir="0 0 -1"/>
    <camera name="overview" pos="0 -2.5 1.6" xyaxes="1 0 0 0 0.5 1" fovy="50"/>
    <geom name="floor" type="plane" size="3 3 .1" material="tiles"/>
    <body name="counter" pos="0 0.5 0.4">
      <geom name="top" type="box" size=".6 .3 .4" rgba=".5 .4 .3 1"/>
    </body>
    <body name="cup" pos="0 0.4 0.86">
      <joint name="cup_free" type="free" damping="0.02"/>
      <geom name="cup" type="cylinder" size=".04 .06" rgba=".9 .2 .2 1"/>
    </body>
    <body name="cupboard" pos="0.4 0.7 1.4">
      <geom type="box" size=".2 .1 .2" rgba=".7 .7 .6 1"/>
      <body name="door" pos="-.2 -.11 0">
        <joint name="hinge" axis="0 0 1" range="-120 0" damping="0.1"/>
        <geom name="door" type="box" pos=".2 0 0" size=".2 .01 .2" mass="1" rgba=".4 .6 .7 1"/>
      </body>
    </body>
    <body name="hand" mocap="true" pos="-.5 0 1">
      <geom size=".03" contype="0" conaffinity="0" rgba="0 1 0 .7"/>
    </body>
  </worldbody>
  <actuator><position name="opener" joint="hinge" kp="5" ctrlrange="-2 0"/></actuator>
  <sensor><jointpos name="angle" joint="hinge"/></sensor>
  <keyframe>
    <key name="closed" ctrl="0"/>
    <key name="home" qpos="0.1 0.4 0.86 1 0 0 0 -1" ctrl="-1"/>
  </keyframe>
</mujoco>
"""
