"""Digests of what the commands compute: run it before and after a change that must not alter any result.

    .venv/bin/python scripts/fingerprint.py > before.txt      ...      diff before.txt after.txt

The digests depend on processor and versions, so compare two runs on one computer.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

SMALL_SAC = "--set warmup=100 --set block=50 --set hidden=16,16"
COMMANDS = (
    ("record hopper", "record hopper --steps 1500 --seed 0 --out hopper.npz", "hopper.npz"),
    ("record cheetah", "record cheetah --steps 800 --seed 0 --behaviour pd --out cheetah.npz", "cheetah.npz"),
    ("record ball", "record ball_throw --steps 500 --seed 0 --out ball.npz", "ball.npz"),
    ("record dojo", "record hopper_dojo --steps 300 --seed 1 --out dojo.npz", "dojo.npz"),
    ("fit hopper", "fit hopper --data hopper.npz --out fit --seed 0", "fit/model.json"),
    ("fit cheetah", "fit cheetah --data cheetah.npz --all-parameters --horizon 2 --out fit2", "fit2/model.json"),
    (
        "fit ball",
        "fit ball_throw --data ball.npz --method gauss-newton --groups friction --out fit3",
        "fit3/model.json",
    ),
    ("error", "error --data hopper.npz --out error hold ballistic nominal fit", "error/error.json"),
    ("shac hopper", "train hopper --algorithm shac --iterations 6 --set environments=16 --out shac", "shac"),
    ("shac cheetah", "train cheetah --algorithm shac --iterations 4 --set environments=16 --out shac2", "shac2"),
    ("shac bcg", "train hopper --algorithm shac --iterations 3 --set environments=8 --derivative bcg --out bcg", "bcg"),
    *(
        (
            f"fopg {estimator}",
            f"train hopper --algorithm fopg --iterations 3 --set samples=8 --set estimator={estimator} "
            f"--out {estimator}",
            estimator,
        )
        for estimator in ("pathwise", "zeroth", "aobg", "pipps")
    ),
    (
        "loop",
        "train hopper --algorithm loop --iterations 12 --set transitions=300 --set environments=8 --set draws=16 "
        "--set score_episodes=4 --out loop",
        "loop",
    ),
    ("sac", f"train hopper --algorithm sac --iterations 4 {SMALL_SAC} --out sac", "sac"),
    ("ppo", "train hopper --algorithm ppo --iterations 2 --set horizon=128 --out ppo", "ppo"),
    ("ars", "train cheetah --algorithm ars --iterations 1 --set directions=2 --set best=1 --out ars", "ars"),
    (
        "mbpo",
        "train hopper --algorithm mbpo --iterations 2 --data hopper.npz --offline --set block=20 --set rollouts=100 "
        "--set fit_updates=20 --set refit_updates=5 --set hidden=16,16 --out mbpo",
        "mbpo",
    ),
)
TIMED = {"seconds", "step_microseconds", "started"}


def digest(path: Path) -> str:
    """Of the numbers in a log, a JSON file or the policy of a run."""
    seen = hashlib.sha256()
    if path.is_dir():
        seen.update((path / "policy.safetensors").read_bytes())
    elif path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            for name in ("q", "v", "u", "q_next", "v_next"):
                seen.update(np.ascontiguousarray(arrays[name]).tobytes())
    else:
        seen.update(json.dumps(without_times(json.loads(path.read_text())), sort_keys=True).encode())
    return seen.hexdigest()[:16]


def without_times(value: object) -> object:
    """``value`` without what differs from run to run, and without paths."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in TIMED | {"scene", "notes"}}
    return [without_times(x) for x in value] if isinstance(value, list) else value


def main() -> None:
    """Runs every command in a temporary folder and prints a line each."""
    with tempfile.TemporaryDirectory() as folder:
        for name, command, made in COMMANDS:
            alone = [] if name.startswith("record") else ["--threads", "1"]
            ran = subprocess.run(
                [sys.executable, "-m", "cmbrl", *command.split(), *alone], cwd=folder, capture_output=True,
                text=True, check=False,
            )  # fmt: skip
            told = digest(Path(folder) / made) if ran.returncode == 0 else f"failed: {ran.stderr.strip()[-200:]}"
            print(f"{name:16s} {told}", flush=True)


if __name__ == "__main__":
    main()
