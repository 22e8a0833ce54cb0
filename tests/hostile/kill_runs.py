"""Commands that are killed at a random moment, and run again until they end."""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .disk_writers import FIT, HOPPER


@dataclass(frozen=True)
class Run:
    """``words`` begin it and ``again`` goes on with it (where ``begun`` exists); ``result`` is what must not change."""

    words: list[str]
    begun: str
    again: list[str]
    result: Callable[[Path], Any]


def _bytes(*names: str) -> Callable[[Path], Any]:
    return lambda place: [hashlib.sha256((place / name).read_bytes()).hexdigest() for name in names]


def _parameters(place: Path) -> Any:
    return [json.loads((place / "fit" / name).read_text()).get(key) for name, key in
            (("fit.json", "parameters"), ("model.json", "settings"))]  # fmt: skip


def _metrics(place: Path) -> Any:
    return [*_bytes("train/policy.safetensors")(place), *untimed(place / "train" / "metrics.csv")]


def untimed(metrics: Path) -> list[list[str]]:
    """The rows of a run's metrics.csv without the times that it took."""
    rows = [line.split(",") for line in metrics.read_text().splitlines()]
    kept = [k for k, name in enumerate(rows[0]) if name not in ("seconds", "processor_seconds")]
    return [[row[k] for k in kept] for row in rows]


def _sweep(place: Path) -> Any:
    return json.loads((place / "sweep" / "sweep.json").read_text())["runs"]


def _bench(place: Path) -> Any:
    return json.loads((place / "bench" / "reduction" / "section.json").read_text())["tables"][0]["columns"]


_TRAIN = ["train", "hopper", "--algorithm", "shac", "--model", "nominal", "--iterations", "8", "--threads", "1",
          *HOPPER, "--checkpoint-seconds", "0.05", "--out", "train"]  # fmt: skip
_FIT = ["fit", "hopper", "--data", "in/log.npz", "--groups", "gear", "--groups", "friction", "--threads", "1"]
_SWEEP = ["sweep", "in/fit.yaml", "--seeds", "0:2", "--jobs", "1", "--out", "sweep"]
_RECORD = ["record", "hopper", "--steps", "2000", "--out"]
_BENCH = ["bench", "reduction", "--quick", "--threads", "1", "--out", "bench"]

RUNS = {
    "record": Run([*_RECORD, "log.npz"], "", [], _bytes("log.npz")),
    "record minari": Run([*_RECORD, "minari"], "", [], _bytes("minari/data/metadata.json")),
    "fit": Run([*_FIT, "--out", "fit"], "fit/state.json", ["--resume"], _parameters),
    "fit quick": Run([*FIT, "--out", "fit"], "fit/state.json", ["--resume"], _parameters),
    "train": Run(_TRAIN, "train/checkpoint.safetensors", ["--resume"], _metrics),
    "sweep": Run(_SWEEP, "", [], _sweep),
    "bench": Run(_BENCH, "", [], _bench),
}


def start(run: Run, place: Path) -> subprocess.Popen[str]:
    """The command as it goes on from what is in ``place``; in a session of its own, so that all of it can be killed."""
    again = run.again if run.begun and (place / run.begun).exists() else []
    return subprocess.Popen(
        [sys.executable, "-m", "cmbrl", *run.words, *again],
        cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def finish(run: Run, place: Path) -> float:
    """Runs it to its end; returns the seconds that it took."""
    begin = time.monotonic()
    process = start(run, place)
    told = process.communicate(timeout=600)[1]
    assert process.returncode == 0, told
    return time.monotonic() - begin


def kill(run: Run, place: Path, rng: random.Random, usual: float) -> bool:
    """Kills it at a random moment of its ``usual`` seconds; returns whether it was still running."""
    process = start(run, place)
    try:
        told = process.communicate(timeout=rng.uniform(0.1, 1.0) * usual)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return True
    assert process.returncode == 0, told
    return False
