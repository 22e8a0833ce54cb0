"""Steps of mixed scenes without end, and the memory that they take.

python -m tests.hostile.soak_steps 1e8     # steps; about 10 minutes on one core
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

BATCH = 4096
TASKS = ("hopper", "cheetah", "ball_throw")


def resident() -> float:
    """Resident memory of this process [MiB]."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmRSS"))


def soak(steps: int, seed: int = 0) -> Iterator[tuple[int, float]]:
    """(steps so far, resident memory [MiB]) after each round over the scenes.

    Most steps are of the hopper without gradients. Every round also makes a model anew, steps the other scenes, and
    takes a derivative; states restart from the scene's own under noise before they can drift away.
    """
    from cmbrl.models.named import nominal_model
    from cmbrl.registry import load_task

    rng = np.random.default_rng(seed)
    models = {name: nominal_model(load_task(name)) for name in TASKS}
    hopper, done = models["hopper"].with_settings(substeps=1), 0
    while done < steps:
        for model, repeats in [(hopper, 40), *((model, 1) for model in models.values())]:
            scene = model.scene
            q = scene.integrate(np.repeat(scene.q0[None], BATCH, axis=0), rng.normal(0.0, 0.1, (BATCH, scene.nv)))
            v, u = rng.normal(0.0, 1.0, (BATCH, scene.nv)), rng.uniform(-1.0, 1.0, (BATCH, scene.nu))
            for _ in range(repeats):
                result = model.predict(q, v, u)
                lost = ~np.isfinite(result.q_next).all(axis=1)
                q, v = np.where(lost[:, None], scene.q0, result.q_next), np.where(lost[:, None], 0.0, result.v_next)
                done += BATCH * model.substeps
        state = [torch.as_tensor(x[:64]).requires_grad_() for x in (q, v, u)]
        sum(x.sum() for x in models["ball_throw"].with_settings(threads=1).step(*state)).backward()
        done += 64 * models["ball_throw"].substeps
        yield done, resident()


def main(steps: int) -> None:
    begin, first, told = time.monotonic(), None, 0.0
    for done, memory in soak(steps):
        first = memory if first is None or done < 0.05 * steps else first
        if time.monotonic() - told > 10 or done >= steps:
            told = time.monotonic()
            print(
                f"{done:.3g} steps, {told - begin:.0f} s: {memory:.1f} MiB, {memory - first:+.1f} since warm",
                flush=True,
            )


if __name__ == "__main__":
    main(int(float(sys.argv[1])))
