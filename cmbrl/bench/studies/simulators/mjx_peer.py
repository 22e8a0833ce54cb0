"""MJX (MuJoCo in JAX) as a simulator, where it is installed; in double precision, as the others are."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from cmbrl.bench.studies.simulators.engine import Path
from cmbrl.bench.studies.simulators.scenes import TrajectoryScene

LANES = 64  #: trajectories of one call: initial states are repeated up to it, and the time divided


class Mjx:
    """All trajectories in one compiled call, Euler, solver settings of the file.

    Compiled once a scene, for any time step; its first call, which compiles, must not be counted.
    """

    name, family, limit = "MJX, euler", "mjx", "MuJoCo"

    def __init__(self, scene: TrajectoryScene) -> None:
        self._scene, self.copies = scene, max(1, LANES // len(scene.q))

    def run(self, steps: int) -> Path:
        s = self._scene
        q, v, u = (np.concatenate([x] * self.copies) for x in (s.q, s.v, s.u))
        return Path(np.asarray(self._simulate(q, v, u, s.interval / steps, steps))[: len(s.q)])

    @cached_property
    def _simulate(self) -> Any:
        import jax
        from mujoco import mjx

        jax.config.update("jax_enable_x64", True)
        model = copy.deepcopy(self._scene.peer)
        assert model is not None
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        compiled, start = mjx.put_model(model), mjx.make_data(model)

        def trajectory(q: Any, v: Any, u: Any, h: Any, steps: Any) -> Any:
            stepped = compiled.tree_replace({"opt.timestep": h})

            def interval(data: Any, control: Any) -> Any:
                data = data.replace(ctrl=control)
                data = jax.lax.fori_loop(0, steps, lambda _, d: mjx.step(stepped, d), data)
                return data, data.qpos

            return jax.lax.scan(interval, start.replace(qpos=q, qvel=v), u)[1]

        return jax.jit(jax.vmap(trajectory, in_axes=(0, 0, 0, None, None)))
