"""The folders that commands read again: how each is made, and what using it tells."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import folders_mutators as m
from .array_mutators import arrays, tensors
from .judge import command
from .kill_runs import untimed

_NETS = ["--set", "environments=4", "--set", "actor_hidden=8", "--set", "critic_hidden=8", "--set", "window=0.03"]


@dataclass(frozen=True)
class Victim:
    """``make(place, seed)`` fills the folder place/victim; ``use(place)`` uses it and returns what must not change."""

    make: Callable[[Path, int], None]
    use: Callable[[Path], Any]
    mutators: tuple[m.Mutator, ...]


def log(place: Path) -> Path:
    """A log next to the victim, which nobody damages."""
    from cmbrl.registry import load_task

    if not (place / "log.npz").exists():
        load_task("hopper").record(120, seed=0).save(place / "log.npz")
    return place / "log.npz"


def make_fit(place: Path, seed: int) -> None:
    fit = ["fit", "hopper", "--data", log(place), "--groups", "gear", "--method", "gauss-newton", "--threads", 1]
    command(*fit, "--seed", seed, "--set", f"gear.leg_joint={1.0 + 0.1 * seed}", "--out", place / "victim")


def compare(place: Path) -> Any:
    """``cmbrl error`` with the fit or the ensemble in the folder, without its times."""
    words = ["--scene", "hopper"] if (place / "ensemble").exists() else []
    told = json.loads(
        command("error", "--data", log(place), *words, place / "victim", "--horizons", 1, 3, "--threads", 1, "--json")
    )
    for entry in told["entries"]:
        entry["step_microseconds"] = None
    return told


def load_fit(place: Path) -> Any:
    """The fit in Python: its parameters, its text and draws from its posterior."""
    from cmbrl.fitting import FitResult

    found = FitResult.load(place / "victim")
    digest = hashlib.sha256(np.ascontiguousarray(found.draws(4)).tobytes()).hexdigest()
    return [found.report_text(), {n: p.value for n, p in found.parameters.items()}, digest, found.model.to_config()]


def resume_fit(place: Path) -> Any:
    """``cmbrl fit --resume``: the parameters that it ends with."""
    config = place / "victim" / "config.json"
    command("fit", "--config", config if config.is_file() else place / "none", "--resume", "--out", place / "victim")
    model = json.loads((place / "victim" / "model.json").read_text())
    model["settings"]["threads"] = None  # of this machine, if config.json does not say
    return [model["settings"], json.loads((place / "victim" / "fit.json").read_text())["parameters"]]


def make_begun_fit(place: Path, seed: int) -> None:
    make_fit(place, seed)
    for name in ("fit.json", "model.json", "report.txt"):
        (place / "victim" / name).unlink()


def make_train(place: Path, seed: int) -> None:
    command("train", "hopper", "--algorithm", "shac", "--model", "nominal", "--iterations", 2, "--threads", 1,
            "--seed", seed, *_NETS, "--out", place / "victim")  # fmt: skip


def resume_train(place: Path) -> Any:
    """``cmbrl train --resume`` for one more iteration: the bits of the policy."""
    out = place / "victim"
    command("train", "hopper", "--algorithm", "shac", "--model", "nominal", "--iterations", 3, "--threads", 1,
            "--seed", 0, *_NETS, "--out", out, "--resume")  # fmt: skip
    rows = untimed(out / "metrics.csv")
    return [hashlib.sha256((out / "policy.safetensors").read_bytes()).hexdigest(), rows]


def make_policy(place: Path, seed: int) -> None:
    make_train(place, seed)
    for file in (place / "victim").iterdir():
        if not file.name.startswith("policy."):
            file.unlink()


def evaluate(place: Path) -> Any:
    return json.loads(command("evaluate", place / "victim", "--episodes", 1, "--threads", 1, "--json"))["in"]


def export(place: Path) -> Any:
    """The exported policy's actions; nothing may be left where it was refused."""
    import torch

    target = place / "out" / "policy.pt"
    try:
        command("export", place / "victim", "--torchscript", target)
    finally:
        left = [f.name for f in place.rglob(".*tmp*")]
        assert not left, left
    observations = torch.linspace(-1, 1, 22).reshape(2, 11)
    return torch.jit.load(str(target))(observations).tolist()


def play(place: Path) -> Any:
    told = command("play", place / "victim", "--out", place / "clip.gif", "--seconds", 0.03)
    return told.split(": ", 1)[1]


def make_ensemble(place: Path, seed: int) -> None:
    from cmbrl.data import Transitions
    from cmbrl.models.neural.config import EnsembleConfig
    from cmbrl.models.neural.ensemble import NeuralEnsemble
    from cmbrl.registry import load_task

    data = Transitions.load(log(place))
    config = EnsembleConfig(nets=3, elites=2, hidden=1, width=8, updates=10, weight_decay=(1e-5, 1e-5))
    ensemble = NeuralEnsemble(load_task("hopper").load_scene(), data.dt, config)
    ensemble.fit(data, seed=seed)
    ensemble.save(place / "victim")
    (place / "ensemble").touch()


def make_minari(place: Path, seed: int) -> None:
    from cmbrl.registry import load_task

    load_task("hopper").record(60, seed=seed).save(place / "victim")


def load_minari(place: Path) -> Any:
    """The log in Python, checked against its scene: a digest of its arrays."""
    from cmbrl.data import Transitions
    from cmbrl.registry import load_task

    data = Transitions.load(place / "victim")
    data.check(load_task("hopper").load_scene())
    digest = hashlib.sha256()
    for name in ("q", "v", "u", "q_next", "v_next", "episode"):
        digest.update(np.ascontiguousarray(getattr(data, name)).tobytes())
    return [digest.hexdigest(), data.dt, data.joint_names, data.actuator_names]


def make_bench(place: Path, seed: int) -> None:
    command("bench", "reduction", "--quick", "--seed", seed, "--threads", 1, "--out", place / "victim")


def read_bench(place: Path) -> Any:
    """``cmbrl bench`` on a folder with a finished study: what it shows."""
    return command("bench", "reduction", "--quick", "--threads", 1, "--out", place / "victim")


_ALL = m.BYTES + m.JSON + m.EDITED
_WEIGHTS = (*_ALL, tensors, tensors)
_MINARI = (*m.BYTES, *m.JSON, *[arrays] * 6)

VICTIMS = {
    "fit, error": Victim(make_fit, compare, _ALL),
    "fit, load": Victim(make_fit, load_fit, _ALL),
    "fit, resume": Victim(make_begun_fit, resume_fit, _ALL),
    "train, resume": Victim(make_train, resume_train, (*m.BYTES, *[tensors] * 6, *m.JSON)),
    "policy, evaluate": Victim(make_policy, evaluate, _WEIGHTS),
    "policy, export": Victim(make_policy, export, _WEIGHTS),
    "policy, play": Victim(make_policy, play, _WEIGHTS),
    "ensemble, error": Victim(make_ensemble, compare, _WEIGHTS),
    "minari, load": Victim(make_minari, load_minari, _MINARI),
    "bench, read": Victim(make_bench, read_bench, _ALL),
}
