"""A cube that bounces for 1 s under MuJoCo's own contact law: the scene of which DiffMJX publishes gradients and times.

The outcome is how far the cube has come along the floor; its derivative is by the speed at which it is thrown down.
Contact is stiff (5 ms), so a step must be short before its derivative is that of the motion.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.models.step_settings import RK4
from cmbrl.scene import Scene

LABEL = "cube"
MJCF = """<mujoco><option gravity="0 0 -2" cone="pyramidal"><flag refsafe="disable" eulerdamp="disable"/></option>
<default><geom solimp="0 .95 .001 .5 2" solref=".005 1"/></default><worldbody><geom type="plane" size="20 20 .125"/>
<body><freejoint/><geom type="box" size=".05 .05 .05" density="100" euler="60 0 0"/></body></worldbody></mujoco>"""
HEIGHT, ALONG, DOWN, SECONDS = 0.2, -0.1, -2.0, 1.0  # m, m/s, m/s, s
STEPS = (1_000, 10_000, 30_000, 100_000)
RK4_STEPS = (10_000, 30_000)
#: solver and step or tolerance; derivative by reverse mode, by differences; seconds (cube_results.csv of DiffMJX)
PUBLISHED = (
    ("MJX, Euler, 1e-2 s", 4.336, 4.336, 0.256),
    ("MJX, Euler, 1e-3 s", 3.240, 0.233, 3.29),
    ("MJX, Euler, 1e-4 s", 0.1325, 0.1676, 31.0),
    ("MJX, Euler, 3e-5 s", 0.1775, 0.1708, 102.5),
    ("DiffMJX, Tsit5, tolerance 1e-7", 0.1749, 0.1714, 16.5),
    ("DiffMJX, Tsit5, tolerance 1e-10", 0.1724, 0.1715, 55.9),
)
_FINE, _WIDTH = 33_333, 1e-2  # steps and width of the differences that the truth is: RK4 of MuJoCo
_NARROW = 1e-4  # width of differences at the same step


@dataclass(frozen=True)
class Derivative:
    """Of one number of steps: ours by the implicit function theorem, MuJoCo's by differences, and our seconds."""

    integrator: str
    steps: int
    ours: float
    mujoco: float
    seconds: float


def truth() -> float:
    """The derivative of MuJoCo's law, in the limit of short steps."""
    return _differences(_FINE, mujoco.mjtIntegrator.mjINT_RK4, _WIDTH)


def measure(steps: Sequence[int], integrator: str = "semi-implicit") -> list[Derivative]:
    """Ours and MuJoCo's, for each number of steps; ``integrator``: semi-implicit (MuJoCo's Euler) or rk4."""
    scene, found = Scene.from_mjcf(MJCF), []
    theirs = getattr(mujoco.mjtIntegrator, "mjINT_RK4" if integrator == RK4 else "mjINT_EULER")
    damping = None if integrator == RK4 else "split"
    for count in steps:
        model = ComplementarityModel(
            scene, count, SECONDS / count, sliding="convex", integrator=integrator, damping=damping
        )
        begin = time.thread_time()
        ours = _derivative(model)
        seconds = time.thread_time() - begin
        found.append(Derivative(integrator, count, ours, _differences(count, theirs, _NARROW), seconds))
    return found


def _derivative(model: ComplementarityModel) -> float:
    down = torch.tensor(DOWN, dtype=torch.float64, requires_grad=True)
    zero = torch.zeros((), dtype=torch.float64)
    q = torch.tensor([[0.0, 0.0, HEIGHT, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    v = torch.stack([zero, zero + ALONG, down, zero, zero, zero])[None]
    q_next, _ = model.step(q, v, torch.zeros((1, 0), dtype=torch.float64))
    (gradient,) = torch.autograd.grad(q_next[0, 1], down)
    return float(gradient)


def _differences(count: int, integrator: int, width: float) -> float:
    model = mujoco.MjModel.from_xml_string(MJCF)
    model.opt.timestep, model.opt.integrator = SECONDS / count, integrator
    model.opt.iterations, model.opt.tolerance = 100, 1e-14
    data = mujoco.MjData(model)

    def outcome(down: float) -> float:
        mujoco.mj_resetData(model, data)
        data.qpos[2], data.qvel[1:3] = HEIGHT, (ALONG, down)
        mujoco.mj_step(model, data, nstep=count)
        return float(data.qpos[1])

    return float(np.diff([outcome(DOWN - width), outcome(DOWN + width)])[0] / (2 * width))
