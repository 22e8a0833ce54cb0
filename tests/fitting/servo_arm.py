"""An arm of one link under a servo with a controller of its own, for laws that a file's servo does not have."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from cmbrl.data.position_log import PositionLog
from cmbrl.fitting import Budget

DT, H, KP, KD = 0.01, 0.002, 60.0, 6.0
DOWN, AHEAD = "0 0 -.4", ".4 0 0"  # where the link points at 0
QUICK = Budget(polish_rows=1000, polish_iterations=8, fold_iterations=2, search_rows=400, starts=1, draws=8)


def arm(mass: float, end: str = DOWN) -> str:
    """The file of an arm whose link ends at ``end``."""
    return f"""<mujoco><option timestep="{H}" integrator="implicitfast"/><worldbody><body pos="0 0 1">
<joint name="a" axis="0 1 0" armature=".1" damping=".5"/>
<geom type="capsule" size=".03" fromto="0 0 0 {end}" mass="{mass}"/></body></worldbody>
<actuator><position name="servo" joint="a" kp="{KP}" kv="{KD}"/></actuator></mujoco>"""


def recorded(text: str, control: Callable[[float, float, float], float], rows: int, begun: int = 0) -> PositionLog:
    """The last ``rows`` of an arm's log; ``control(target, its rate, position)`` in every step of MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data, time = mujoco.MjData(model), DT * np.arange(rows + begun)
    target = 0.4 * np.sin(3.0 * time) + 0.25 * np.sin(7.3 * time + 1.0) + 0.1 * np.sin(19.0 * time)
    rate, places = np.concatenate([[0.0], np.diff(target)]) / DT, []
    for goal, speed in zip(target, rate, strict=True):
        places.append(data.qpos.copy())
        for _ in range(round(DT / H)):
            data.ctrl[:] = control(goal, speed, float(data.qpos[0]))
            mujoco.mj_step(model, data)
    position = np.array(places) + 1e-4 * np.random.default_rng(0).standard_normal((len(places), 1))
    told = {"position": position[begun:], "command": target[begun:, None], "joint_names": ("a",)}
    return PositionLog(time=time[:rows], **told)
