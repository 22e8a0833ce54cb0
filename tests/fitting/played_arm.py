"""An arm with play between motor and link, and logs of it that know the motors' side alone."""

from __future__ import annotations

import mujoco
import numpy as np

from cmbrl.data.transitions import Transitions

ARM = """<mujoco><compiler angle="radian"/><option timestep=".0025" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="a" axis="0 1 0" damping=".1" armature=".01"/>
<geom name="upper" type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".4" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -.3"><joint name="b" axis="0 1 0" damping=".05" armature=".005" range="-2 2"/>
<geom name="fore" type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".25" contype="0" conaffinity="0"/>
</body></body>
</worldbody><actuator><motor joint="a" ctrlrange="-2 2"/><motor joint="b" ctrlrange="-1 1"/></actuator></mujoco>"""


def recorded(played: str, rows: int, seed: int = 0) -> tuple[Transitions, np.ndarray]:
    """``rows`` at 100 Hz under random torques, of the joints a and b of ``played``; and the play (rows, 2) [rad]."""
    model = mujoco.MjModel.from_xml_string(played)
    data, draw = mujoco.MjData(model), np.random.default_rng(seed)
    told = [model.joint(name).qposadr[0] for name in ("a", "b")]
    hidden = [model.joint(f"{name}_play").qposadr[0] for name in ("a", "b")]
    states, commands, play = [], [], []
    for k in range(rows + 1):
        if k % 4 == 0:
            data.ctrl[:] = draw.uniform(-1, 1, 2) * [2.0, 1.0]
        states.append((data.qpos[told].copy(), data.qvel[told].copy()))
        commands.append(data.ctrl.copy())
        play.append(data.qpos[hidden].copy())
        mujoco.mj_step(model, data, nstep=4)
    q, v = (np.array(part) for part in zip(*states, strict=True))
    log = Transitions(
        q=q[:-1], v=v[:-1], u=np.array(commands[:-1]), q_next=q[1:], v_next=v[1:], dt=0.01,
        episode=np.zeros(rows), joint_names=("a", "b"),
    )  # fmt: skip
    return log, np.array(play[:-1])
