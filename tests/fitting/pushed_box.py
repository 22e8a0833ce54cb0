"""A box that a robot pushes across a table, in MuJoCo: its corners touch and leave."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.data.transitions import Transitions

ANGLES = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 10.0, 10.0, 10.0])  # of the pusher's two, the box's three and its turns
PUSHER = """<mujoco><option timestep=".002" integrator="implicitfast"/><worldbody><geom type="plane" size="1 1 .1"
friction="{floor}"/><body name="pusher" pos="0 0 .03"><joint name="x" type="slide" axis="1 0 0" damping="2"/><joint
name="y" type="slide" axis="0 1 0" damping="2"/><geom type="sphere" size=".02" mass=".3" friction=".3"/></body><body
name="box" pos=".1 0 .03"><freejoint/><geom type="box" size=".04 .05 .03" mass="{mass}" friction="{floor}"/></body>
</worldbody><actuator><position joint="x" kp="200" kv="10"/><position joint="y" kp="200" kv="10"/></actuator>
</mujoco>"""


def pushes(episodes: int, steps: int, noise: float = 0.0) -> Transitions:
    """A box in MuJoCo that is heavier and slides more easily than its file says, pushed across a table.

    ``noise`` of positions [m]; that of angles is ten times as large [rad], that of velocities fifty times.
    """
    model = mujoco.MjModel.from_xml_string(PUSHER.format(floor=0.35, mass=0.7))
    data, draw = mujoco.MjData(model), np.random.default_rng(1)
    q, v, u = [], [], []
    for _ in range(episodes):
        mujoco.mj_resetData(model, data)
        turn = 0.5 * draw.uniform(-0.5, 0.5)
        data.qpos[2:4] = 0.1 + draw.uniform(-0.02, 0.02), draw.uniform(-0.03, 0.03)
        data.qpos[5:9] = np.cos(turn), 0.0, 0.0, np.sin(turn)
        mujoco.mj_step(model, data, nstep=100)
        speed = np.array([draw.uniform(0.1, 0.4), draw.uniform(-0.1, 0.1)])
        for k in range(steps + 1):
            data.ctrl[:] = speed * 0.02 * k + np.array([0.0, 0.02 * np.sin(0.1 * k)])
            q.append(data.qpos.copy())
            mujoco.mj_integratePos(model, q[-1], noise * draw.normal(size=8) * ANGLES, 1.0)
            v.append(data.qvel + 50.0 * noise * draw.normal(size=8))
            u.append(data.ctrl.copy())
            mujoco.mj_step(model, data, nstep=10)
    ends = np.arange(1, episodes + 1) * (steps + 1) - 1
    rows = np.setdiff1d(np.arange(len(q)), ends)
    q, v, u = (np.array(x) for x in (q, v, u))
    return Transitions(
        q=q[rows],
        v=v[rows],
        u=u[rows],
        q_next=q[rows + 1],
        v_next=v[rows + 1],
        dt=0.02,
        episode=np.repeat(np.arange(episodes), steps),
    )
