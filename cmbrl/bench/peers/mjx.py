"""MJX (MuJoCo in JAX), in double precision."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from cmbrl.bench.peers.mujoco import compiled
from cmbrl.bench.peers.simulator import Array, World


class Mjx:
    """All trajectories in one compiled call: Euler, solver settings of the MJCF.

    Compiles at the first call, for any time step; do not time that call.
    """

    def __init__(self, world: World) -> None:
        self._model = compiled(world.mjcf, "euler")

    def trajectories(self, q: Array, v: Array, u: Array, h: float, steps: int) -> tuple[Array, int]:
        """As :meth:`cmbrl.bench.peers.simulator.Simulator.trajectories`; failures are not counted."""
        return np.asarray(self._simulate(q, v, u, h, steps)), 0

    @cached_property
    def _simulate(self) -> Any:
        import jax
        from mujoco import mjx

        jax.config.update("jax_enable_x64", True)
        model, start = mjx.put_model(self._model), mjx.make_data(self._model)

        def trajectory(q: Any, v: Any, u: Any, h: Any, steps: Any) -> Any:
            stepped = model.tree_replace({"opt.timestep": h})

            def interval(data: Any, control: Any) -> Any:
                data = data.replace(ctrl=control)
                data = jax.lax.fori_loop(0, steps, lambda _, d: mjx.step(stepped, d), data)
                return data, data.qpos

            return jax.lax.scan(interval, start.replace(qpos=q, qvel=v), u)[1]

        return jax.jit(jax.vmap(trajectory, in_axes=(0, 0, 0, None, None)))
