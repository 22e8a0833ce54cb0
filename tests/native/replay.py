"""Records native calls with the installed core, and replays them on another build of it, which needs only NumPy.

replay.py record FILE            replay.py replay FILE FOLDER (of the built ``_core``)
"""

from __future__ import annotations

import pickle
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np

# Relative to the largest number of a result. Builds differ by the order and the fusion of operations, amplified by a
# contact solve to 1e-9 of its size; iterations may differ by a few.
TOLERANCE = 1e-6


def record(file: str) -> None:
    """Two scenes, planar and spatial: inputs, and results of the installed core."""
    from cmbrl.bench.states import Ranges, random_states
    from cmbrl.contact import Barrier
    from cmbrl.models.complementarity import ComplementarityModel
    from cmbrl.registry import load_task

    calls = []
    for task in ("cube_toss", "hopper"):
        scene = load_task(task).load_scene()
        model = ComplementarityModel(scene, 2, smoothing=Barrier(1e-4), integrator="midpoint")
        q, v, u = random_states(scene, 83, np.random.default_rng(0), Ranges(gap=(-0.002, 0.01), speed=2.0))
        call: dict[str, Any] = {
            "scene": scene.core.to_native(),
            "options": model.stepper.options,
            "states": (q, v, u),
            "theta": model.parameters,
            "cotangents": tuple(np.random.default_rng(1).normal(size=(2, len(q), scene.nv))),
        }
        calls.append(call | {"results": results(model.stepper.core, call, 1)})
    Path(file).write_bytes(pickle.dumps(calls))


def results(core: Any, call: dict[str, Any], threads: int) -> dict[str, np.ndarray]:
    """Step, Jacobian, impulses, backward pass and losses."""
    (q, v, u), theta, options = call["states"], call["theta"], call["options"]
    wanted = {"tape": True, "jacobian": True, "columns": np.arange(len(theta)), "impulse": True}
    out = core.forward(q, v, u, theta, options, **wanted, threads=threads)
    back = core.backward(u, theta, out["tape"], *call["cotangents"], options, True, threads)
    ones, starts = np.ones(v.shape[1]), np.arange(0, len(q) - 5, 5)
    candidates = np.stack([theta * x for x in (0.95, 1.0, 0.99)])
    loss = core.loss(
        *(q[starts], v[starts], u, out["q_next"], out["v_next"]),
        *(starts, 1, candidates, ones, ones, 1.0, 1e3, options, threads),
    )
    kept = {name: np.array(x) for name, x in (out | back).items() if name not in ("tape", "iterations", "residual")}
    return kept | {"loss": np.array(loss)}


def replay(file: str, folder: str) -> None:
    """Compares; exits with an error where a result differs."""
    sys.path.insert(0, folder)
    import _core  # type: ignore[import-not-found]

    worst, sets = 0.0, []
    for call in pickle.loads(Path(file).read_bytes()):
        for isa in ("", "generic", "sse2", "avx2", "avx512"):
            try:
                core = _core.Core(call["scene"], isa=isa)
            except ValueError:
                continue  # not of this build or processor
            sets.append(f"{core.isa} with {core.width} lanes")
            one, two = (results(core, call, threads) for threads in (1, 2))
            for name, expected in call["results"].items():
                np.testing.assert_array_equal(one[name], two[name], err_msg=f"{name} on two threads")
                off = float(np.abs(one[name] - expected).max(initial=0) / np.abs(expected).max(initial=1))
                worst = max(worst, off)
                assert off < TOLERANCE, f"{name} on {core.isa} is off by {off:.2g} of the largest"
    print(f"{platform.machine()}: {', '.join(dict.fromkeys(sets))}: largest relative difference {worst:.1e}")


if __name__ == "__main__":
    {"record": record, "replay": replay}[sys.argv[1]](*sys.argv[2:])
