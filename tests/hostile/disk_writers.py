"""Commands that write, and a disk that is full after so many bytes."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

HOPPER = ["--set", "environments=4", "--set", "actor_hidden=8", "--set", "critic_hidden=8", "--set", "window=0.03"]
FIT = ["fit", "hopper", "--data", "in/log.npz", "--groups", "gear", "--method", "gauss-newton", "--threads", "1"]
ERROR = ["--data", "in/log.npz", "--scene", "hopper", "--horizons", "1", "--out", "OUT/error"]

# name -> words; OUT is the place on the full disk
WRITERS = {
    "record": ["record", "hopper", "--steps", "300", "--out", "OUT/log.npz"],
    "record minari": ["record", "hopper", "--steps", "300", "--out", "OUT/minari"],
    "import": ["import", "in/raw.npz", "--scene", "hopper", "--out", "OUT/log.npz"],
    "fit": [*FIT, "--out", "OUT/fit"],
    "train": ["train", "hopper", "--algorithm", "shac", "--model", "nominal", "--iterations", "2", "--threads", "1",
              *HOPPER, "--out", "OUT/train"],
    "error": ["error", "hold", "nominal", *ERROR],
    "error ensemble": ["error", "ensemble", *ERROR, "--train", "in/log.npz", "--train-seconds", "0.1"],
    "export": ["export", "in/policy", "--torchscript", "OUT/policy.pt", "--onnx", "OUT/policy.onnx"],
    "play gif": ["play", "in/policy", "--out", "OUT/clip.gif", "--seconds", "0.2"],
    "play mp4": ["play", "in/policy", "--out", "OUT/clip.mp4", "--seconds", "0.2"],
    "bench": ["bench", "reduction", "--quick", "--threads", "1", "--out", "OUT/bench"],
    "sweep": ["sweep", "in/fit.yaml", "--seeds", "0:1", "--jobs", "1", "--out", "OUT/sweep"],
}  # fmt: skip


def inputs(place: Path) -> None:
    """What the commands read, in place/in."""
    from cmbrl.registry import load_task
    from cmbrl.train.policies.file import save_policy
    from cmbrl.train.policies.policy import Architecture, Policy

    recorded = load_task("hopper").record(120, seed=0)
    recorded.save(place / "in" / "log.npz")
    np.savez(
        place / "in" / "raw.npz", dt=recorded.dt, joint_names=np.array(recorded.joint_names), q=recorded.q,
        dq=recorded.v, ctrl=recorded.u, ctrl_names=np.array(recorded.actuator_names), episode=recorded.episode,
    )  # fmt: skip
    save_policy(Policy(Architecture(11, 3, (128, 64))), place / "in" / "policy", {"task": "hopper"})
    log = (place / "in" / "log.npz").resolve()
    (place / "in" / "fit.yaml").write_text(
        f"command: fit\nsource: hopper\ndata: {log}\ngroups: [gear]\nmethod: gauss-newton\n", encoding="utf-8"
    )


def limited(words: list[str], out: Path, size: int, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command where no file may grow beyond ``size`` bytes, which is an error as on a full disk."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return subprocess.run(
        [sys.executable, "-m", "cmbrl", *(word.replace("OUT", str(out)) for word in words)],
        cwd=cwd, capture_output=True, text=True, timeout=300, preexec_fn=limit,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip


def full(*_: object, **__: object) -> None:
    """Raises what a full disk does."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
