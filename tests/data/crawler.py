"""A simulated robot of four legs that stands on a floor and shifts its weight."""

from __future__ import annotations

import mujoco
import numpy as np

DT = 0.004
CRAWLER = """<mujoco model="crawler"><option timestep="0.004" integrator="implicitfast"/>
<default><geom friction="1.5"/><joint damping=".5" armature=".01"/></default>
<worldbody><geom name="floor" type="plane" size="9 9 .1"/>
<body name="base" pos="0 0 .23"><freejoint name="root"/>
  <geom name="trunk" type="box" size=".15 .1 .03" mass="{mass}" contype="0" conaffinity="0"/>{legs}</body></worldbody>
<actuator>{motors}</actuator></mujoco>"""
LEG = """<body name="{n}" pos="{x} {y} 0"><joint name="{n}_roll" axis="1 0 0"/><joint name="{n}_pitch" axis="0 1 0"/>
<geom type="capsule" size=".015" fromto="0 0 0 0 0 -.18" mass=".3" contype="0" conaffinity="0"/>
<geom name="{n}_foot" size=".025" pos="0 0 -.2" mass=".05"/></body>"""
CORNERS = (("fl", 0.13, 0.09), ("fr", 0.13, -0.09), ("rl", -0.13, 0.09), ("rr", -0.13, -0.09))
JOINTS = tuple(f"{n}_{j}" for n, _, _ in CORNERS for j in ("roll", "pitch"))


def crawler(mass: float) -> str:
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, x, y in CORNERS)
    motors = "".join(f'<position name="m_{j}" joint="{j}" kp="100" kv="3"/>' for j in JOINTS)
    return CRAWLER.format(mass=mass, legs=legs, motors=motors)


def simulate(mass: float, seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q (T, 15), v (T, 14) before each target (T, 8)."""
    model = mujoco.MjModel.from_xml_string(crawler(mass))
    data, draw, rows = mujoco.MjData(model), np.random.default_rng(0), round(seconds / DT)
    time = DT * np.arange(rows)
    target = np.zeros((rows, 8))
    for joint in range(8):
        for tone in draw.uniform(0.4, 1.5, size=3):
            target[:, joint] += 0.05 * np.sin(2 * np.pi * tone * time + draw.uniform(0, 6.3)) * np.minimum(1.0, time)
    q, v = np.zeros((rows, model.nq)), np.zeros((rows, model.nv))
    for row in range(rows):
        q[row], v[row] = data.qpos, data.qvel
        data.ctrl = target[row]
        mujoco.mj_step(model, data)
    return q, v, target
