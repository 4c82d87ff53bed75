"""Small MJCF robots with actuators of their own, as text.

The arm has the numbers of MuJoCo Menagerie's UR5e (gains, efforts, masses, key pose), the hand the
structure of its Robotiq 2F-85: one tendon actuator, passive linkages with springs, loop closures.
"""

from __future__ import annotations

_SIZES = {"size3": (2000, 400, 150), "size1": (500, 100, 28)}
_ARM = (
    ("shoulder_pan", "size3", "0 0 1", "0 0 0.163", 3.7, 0.0102675),
    ("shoulder_lift", "size3", "0 1 0", "0 0.138 0", 8.393, 0.133886),
    ("elbow", "size3", "0 1 0", "0 -0.131 0.425", 2.275, 0.0312168),
    ("wrist_1", "size1", "0 1 0", "0 0 0.392", 1.219, 0.0025599),
    ("wrist_2", "size1", "0 0 1", "0 0.127 0", 1.219, 0.0025599),
    ("wrist_3", "size1", "0 1 0", "0 0 0.1", 0.1889, 0.000132134),
)
UR5E_HOME = [-1.5708, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]


def _links() -> str:
    opened = "".join(
        f'<body name="{name}_link" pos="{pos}">'
        f'<inertial mass="{mass}" pos="0 0 0.1" diaginertia="{inertia} {inertia} {inertia}"/>'
        f'<joint name="{name}_joint" class="{size}" axis="{axis}"/>'
        for name, size, axis, pos, mass, inertia in _ARM
    )
    return f'{opened}<site name="tool" pos="0 0.1 0"/>' + "</body>" * len(_ARM)


UR5E = f"""<mujoco model="ur5e">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <default class="ur5e"><joint range="-6.28319 6.28319" armature="0.1"/>
      <general gaintype="fixed" biastype="affine" ctrlrange="-6.2831 6.2831"/>
      {
    "".join(
        f'<default class="{size}"><general gainprm="{kp}" biasprm="0 -{kp} -{kv}" '
        f'forcerange="-{most} {most}"/></default>'
        for size, (kp, kv, most) in _SIZES.items()
    )
}
    </default>
  </default>
  <worldbody>
    <body name="base" childclass="ur5e">
      <inertial mass="4" pos="0 0 0" diaginertia="0.004 0.004 0.007"/>{_links()}
    </body>
  </worldbody>
  <actuator>
    {
    "".join(
        f'<general class="{size}" name="{name}" joint="{name}_joint"/>' for name, size, *_ in _ARM
    )
}
  </actuator>
  <sensor><actuatorfrc name="elbow_effort" actuator="elbow"/></sensor>
  <keyframe>
    <key name="home" qpos="{" ".join(map(str, UR5E_HOME))}" ctrl="{" ".join(map(str, UR5E_HOME))}"/>
  </keyframe>
</mujoco>
"""

_SIDE = """<body name="{side}_driver" pos="{x} 0 0.05">
  <joint name="{side}_driver_joint" axis="0 {sign} 0" range="0 0.8" armature="0.005" damping="0.1"/>
  <geom type="capsule" fromto="0 0 0 {x} 0 0.03" size="0.005" mass="0.02" contype="0"/>
  <body name="{side}_coupler" pos="{x} 0 0.03">
    <joint name="{side}_coupler_joint" axis="0 {sign} 0" range="-1.57 1.57" armature="0.001"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.004" mass="0.01" contype="0"/>
  </body>
</body>
<body name="{side}_spring_link" pos="{x} 0 0.01">
  <joint name="{side}_spring_joint" axis="0 {sign} 0" range="-0.3 0.8" armature="0.001"
    stiffness="0.05" springref="2.62" damping="0.00125"/>
  <geom type="capsule" fromto="0 0 0 {x} 0 0.04" size="0.004" mass="0.02" contype="0"/>
  <body name="{side}_follower" pos="{x} 0 0.04">
    <joint name="{side}_follower_joint" axis="0 {sign} 0" range="-0.9 0.9" armature="0.001"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.07" size="0.004" mass="0.02" contype="0"/>
  </body>
</body>"""

HAND = f"""<mujoco model="hand">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="base">
      <geom size="0.02" mass="0.5" contype="0"/>
      {_SIDE.format(side="right", x="0.03", sign="1")}
      {_SIDE.format(side="left", x="-0.03", sign="-1")}
    </body>
  </worldbody>
  <tendon>
    <fixed name="split">
      <joint joint="right_driver_joint" coef="0.5"/><joint joint="left_driver_joint" coef="0.5"/>
    </fixed>
  </tendon>
  <equality>
    <connect name="right_loop" anchor="0 0 0.04" body1="right_coupler" body2="right_follower"/>
    <connect name="left_loop" anchor="0 0 0.04" body1="left_coupler" body2="left_follower"/>
    <joint joint1="right_driver_joint" joint2="left_driver_joint" polycoef="0 1 0 0 0"
      solref="0.005 1"/>
  </equality>
  <actuator>
    <general name="fingers" tendon="split" biastype="affine" forcerange="-5 5" ctrlrange="0 255"
      gainprm="0.3137255 0 0" biasprm="0 -100 -10"/>
  </actuator>
</mujoco>
"""

ZOO = """<mujoco model="zoo">
  <compiler angle="radian" autolimits="true"/>
  <default>
    <position kp="7"/>
    <default class="strong"><position kp="40" dampratio="1" forcerange="-9 11"/></default>
  </default>
  <worldbody>
    <body name="base">
      <geom size="0.1"/>
      <body name="a" pos="0.3 0 0" gravcomp="1">
        <joint name="servoed" axis="0 1 0" range="-1 2" actuatorgravcomp="true"
          actuatorfrcrange="-6 6" damping="0.3 0.02" frictionloss="0.1"/>
        <geom size="0.05"/>
        <body name="b" pos="0.2 0 0">
          <joint name="geared" axis="0 1 0" range="-2 2" armature="0.01"/>
          <geom size="0.05"/>
          <body name="c" pos="0.2 0 0">
            <joint name="spun" axis="1 0 0"/>
            <geom size="0.05"/>
            <site name="tip" pos="0 0 0.1"/>
            <body name="d" pos="0.1 0 0">
              <joint name="socket" type="ball"/>
              <geom size="0.03"/>
              <body name="e" pos="0.1 0 0">
                <joint name="paired" axis="0 1 0" range="-1 1"/>
                <joint name="lagging" axis="0 0 1" range="-1 1"/>
                <joint name="pushed" type="slide" axis="0 0 1" range="-0.1 0.1" stiffness="30"/>
                <geom size="0.03"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="sum" range="-3 3" stiffness="0.5" damping="0.2" frictionloss="0.05" armature="0.1">
      <joint joint="servoed" coef="1"/><joint joint="geared" coef="-0.5"/>
    </fixed>
  </tendon>
  <equality>
    <joint name="linked" joint1="pushed" joint2="geared" polycoef="0 0.01 0.02 0 0" active="false"/>
  </equality>
  <actuator>
    <position name="servo" class="strong" joint="servoed" inheritrange="0.9"/>
    <position name="geared_servo" joint="geared" gear="3" kv="0.5" armature="0.002" damping="0.01"/>
    <velocity name="wheel" joint="spun" kv="2" gear="-2" ctrlrange="-5 5"/>
    <orientation name="wrist" joint="socket" kp="3" kv="0.2" input="quat"/>
    <position name="hold" joint="paired" kp="20"/>
    <velocity name="brake" joint="paired" kv="1.5"/>
    <position name="lag" joint="lagging" kp="15" kv="1" timeconst="0.05"/>
    <pid name="pid" joint="pushed" kp="200" kv="10" ki="5" imax="1"/>
    <intvelocity name="walk" joint="geared" kp="2" actrange="-1 1"/>
    <motor name="pull" tendon="sum" ctrlrange="-1 1" gear="4" delay="0.02" nsample="4"/>
    <cylinder name="piston" joint="pushed" timeconst="0.1" area="2" ctrlrange="0 1"/>
    <general name="jet" site="tip" gear="0 0 1 0 0 0" dyntype="integrator" actlimited="true"
      actrange="-2 2" ctrlrange="-1 1" actearly="true"/>
    <damper name="drag" joint="spun" kv="0.4" ctrlrange="0 1"/>
    <adhesion name="grip" body="e" gain="2" ctrlrange="0 1"/>
    <dcmotor name="dc" joint="spun" motorconst="0.05" resistance="2"/>
    <muscle name="muscle" tendon="sum" ctrlrange="0 1" lengthrange="-3 3" force="20"/>
  </actuator>
</mujoco>
"""
"""Every kind of actuator, and every field of joints, tendons and equalities that a file may set."""

ROBOTS = {"ur5e": UR5E, "hand": HAND, "zoo": ZOO}
