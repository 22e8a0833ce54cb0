#!/usr/bin/env python
"""Steps of MJX on this machine's GPU (or CPU) beside ours: ``scripts/mjx.py``; needs JAX and mujoco-mjx.

Wall-clock microseconds a step, by batch, from the same states that MuJoCo visits: MJX in single precision, with the
file's solver settings and with one iteration, which alone has reverse-mode derivatives; ours in double precision, on
one thread and on all. The error is that of the change of velocity in the step, against ``mj_step``.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

try:
    import jax
    import jax.numpy as jnp
    from mujoco import mjx
except ImportError as error:
    raise SystemExit(f"{error}: pip install jax mujoco-mjx (jax[cuda13] for a GPU)") from None

from cmbrl.bench.peers.mujoco_steps import Visited, visit
from cmbrl.bench.scenes import PairedScene, paired
from cmbrl.contact import Exact

SCENES = ("hopper euler", "cheetah", "g1 feet")
STATES = 1024  # visited ones, repeated to fill a batch
TURNS = 5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", action="append", metavar="LABEL", help=f"default: {', '.join(SCENES)}")
    parser.add_argument("--batch", type=int, nargs="+", default=[256, 2048, 16384], metavar="N")
    arguments = parser.parse_args()
    print(json.dumps({"device": str(jax.devices()[0].device_kind), "threads": os.cpu_count(), "jax": jax.__version__}))
    for label in arguments.scene or SCENES:
        pair = paired(label)
        visited = visit(pair, STATES, seed=0)
        for batch in arguments.batch:
            rows = np.arange(batch) % STATES
            for row in (*_ours(pair, visited, rows), *_mjx(pair.peer, visited, rows)):
                print(json.dumps({"scene": label, "batch": batch, **row}), flush=True)


def _ours(pair: PairedScene, visited: Visited, rows: np.ndarray) -> Iterator[dict[str, Any]]:
    q, v, u = visited.q[rows], visited.v[rows], visited.u[rows]
    gradient = np.random.default_rng(0).normal(size=(2, len(rows), pair.scene.nv))
    for threads in (1, os.cpu_count() or 1):
        model = pair.model(smoothing=Exact(), threads=threads)

        def forward(model: Any = model) -> Any:
            return model.predict(q, v, u)

        def backward(model: Any = model) -> Any:
            out = model.stepper.forward(q, v, u, model.parameters, tape=True)
            return model.stepper.backward(u, model.parameters, out["tape"], *gradient)

        yield {
            "simulator": f"ours, {threads} threads" if threads > 1 else "ours, 1 thread",
            "step_us": _microseconds(forward, len(rows)),
            "vjp_us": _microseconds(backward, len(rows)),
            "error": _error(forward().v_next, visited, rows),
        }


def _mjx(peer: mujoco.MjModel, visited: Visited, rows: np.ndarray) -> Iterator[dict[str, Any]]:
    state = [jnp.asarray(x[rows]) for x in (visited.q, visited.v, visited.u, visited.warmstart)]
    iterations, searches = peer.opt.iterations, peer.opt.ls_iterations
    for name, most, lines in (
        ("the file's iterations", iterations, searches),
        ("4 iterations", 4, 8),
        ("one iteration", 1, 8),
    ):
        peer.opt.iterations, peer.opt.ls_iterations = most, lines
        step = _step_of(peer)

        def pulled(*given: Any, step: Any = step) -> Any:
            following, back = jax.vjp(step, *given)
            return back(jax.tree.map(jnp.ones_like, following))

        calls = [jax.jit(step)] + [jax.jit(pulled)] * (most == 1)
        times = [_microseconds(lambda f=call: jax.block_until_ready(f(*state)), len(rows)) for call in calls]
        yield {
            "simulator": f"MJX, {name}",
            **dict(zip(("step_us", "vjp_us"), times, strict=False)),
            "error": _error(np.asarray(calls[0](*state)[1]), visited, rows),
        }
    peer.opt.iterations, peer.opt.ls_iterations = iterations, searches


def _step_of(peer: mujoco.MjModel) -> Callable[..., Any]:
    model = mjx.put_model(peer)
    start = mjx.make_data(model)

    def one(q: Any, v: Any, u: Any, warm: Any) -> Any:
        data = mjx.step(model, start.replace(qpos=q, qvel=v, ctrl=u, qacc_warmstart=warm))
        return data.qpos, data.qvel

    return jax.vmap(one)


def _microseconds(call: Callable[[], Any], steps: int) -> float:
    """The median turn, after one that compiles."""
    call()
    turns = []
    for _ in range(TURNS):
        begin = time.perf_counter()
        call()
        turns.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(turns)) / steps


def _error(following: np.ndarray, visited: Visited, rows: np.ndarray) -> float:
    """Median over states of the root mean square over coordinates, in units of their usual change."""
    scale = np.sqrt(np.mean((visited.v_next - visited.v) ** 2, axis=0)) + 1e-12
    off = (following - visited.v_next[rows]) / scale
    return float(np.median(np.sqrt(np.mean(off**2, axis=1))))


if __name__ == "__main__":
    main()
