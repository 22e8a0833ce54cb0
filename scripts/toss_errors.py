"""What rules the errors of models on tossed bodies: impacts, the measured start, or the law of contact.

    python scripts/toss_errors.py elbow.xml train.npz test.npz FIT ... [--ensemble SECONDS] [--sysid]

Errors of the first body after 20 steps, on windows of the tosses in test.npz: all; those in free fall; those with an
impact; those in contact without one. An impact is a frame in which the centre of mass is pushed by more than 2 g beyond
its weight, by second differences, since contacts between two frames show in no gap. Starts: as logged; velocities by
local parabolas over the frames up to the start, which a controller could have; and the best start within the noise of
the capture in hindsight, which tells what no better start can mend. The noise comes from third differences in flight.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import torch

from cmbrl import ComplementarityModel, Scene, Transitions
from cmbrl.fitting.log.evidence import Evidence
from cmbrl.models.named import load_complementarity
from cmbrl.models.neural.ensemble import NeuralEnsemble
from cmbrl.models.protocol import rollout

STEPS, EVERY, PUSH = 20, 3, 20.0  # PUSH in m/s^2
PAST = 5  # frames of a start from the past


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("train")
    parser.add_argument("test")
    parser.add_argument("fits", nargs="*")
    parser.add_argument("--ensemble", type=float, metavar="SECONDS", help="train a neural ensemble for so long")
    parser.add_argument("--sysid", action="store_true", help="fit by mujoco.sysid too")
    arguments = parser.parse_args()
    scene = Scene.from_mjcf(arguments.scene)
    log = Transitions.load(arguments.test).going_on(scene)
    models = {"nominal": ComplementarityModel(scene).for_log(log.dt)}
    models |= {folder: load_complementarity(folder) for folder in arguments.fits}
    starts = log.windows(STEPS)
    starts = starts[starts - first_rows(log)[starts] >= PAST][::EVERY]
    kinds = windows_by_kind(scene, log, starts)
    sizes = noise(scene, log)
    print("noise of a frame [mm, mrad]:", np.round(1e3 * sizes, 2))
    for name, model in models.items():
        report(name, "as logged", kinds, errors(scene, log, starts, model, log.v[starts]))
        report(name, "from the past", kinds, errors(scene, log, starts, model, past(scene, log, starts)))
        report(name, "in hindsight", kinds, hindsight(model, log, starts, sizes))
    train = Transitions.load(arguments.train)
    if arguments.ensemble:
        ensemble = NeuralEnsemble(scene, log.dt)
        ensemble.fit(train, seed=0, max_seconds=arguments.ensemble)
        report("neural ensemble", "as logged", kinds, errors(scene, log, starts, ensemble, log.v[starts]))
    if arguments.sysid:
        from cmbrl.bench.peers.mujoco_model import GROUPS
        from cmbrl.bench.peers.mujoco_sysid import identified

        some = train.select(np.isin(train.episode, np.unique(train.episode)[::4]))
        groups = [group for group in GROUPS if group != "gravity"]
        fitted, about = identified(scene, some, scene.parameter_vector(), groups)
        report(
            f"mujoco.sysid ({about['parameters']})",
            "as logged",
            kinds,
            errors(scene, log, starts, fitted, log.v[starts]),
        )


def first_rows(log: Transitions) -> np.ndarray:
    """The first row (N,) of each row's episode."""
    return np.searchsorted(log.episode, log.episode)


def windows_by_kind(scene: Scene, log: Transitions, starts: np.ndarray) -> dict[str, np.ndarray]:
    """Masks over the windows."""
    centre = scene.centre_of_mass(log.q)
    push = np.zeros(len(log))
    inside = np.flatnonzero(log.episode[2:] == log.episode[:-2]) + 1
    second = (centre[inside + 1] - 2.0 * centre[inside] + centre[inside - 1]) / log.dt**2
    push[inside] = np.linalg.norm(second - scene.gravity, axis=1)
    pushes = push[np.minimum(starts[:, None] + np.arange(STEPS), len(log) - 1)]
    impact = (pushes > PUSH).any(axis=1)
    falls = np.median(pushes, axis=1) < 0.5 * np.linalg.norm(scene.gravity)
    return {
        "all": np.ones(len(starts), dtype=bool), "free fall": ~impact & falls, "impact": impact,
        "contact": ~impact & ~falls,
    }  # fmt: skip


def noise(scene: Scene, log: Transitions) -> np.ndarray:
    """Standard deviations (nv,) of the capture in one frame: robust, from differences of order three."""
    step = scene.difference(log.q, log.q_next)
    rows = np.flatnonzero(log.episode[2:] == log.episode[:-2])
    third = step[rows + 2] - 2.0 * step[rows + 1] + step[rows]
    far = scene.gaps(log.q).min(axis=1)[rows] > 0.02
    return 1.4826 * np.median(np.abs(third[far]), axis=0) / np.sqrt(20.0)


def past(scene: Scene, log: Transitions, starts: np.ndarray) -> np.ndarray:
    """Velocities (S, nv) at the newest frame of parabolas through it and the PAST frames before."""
    away = np.stack([scene.difference(log.q[starts], log.q[starts - k]) for k in range(PAST + 1)], axis=1)
    time = -log.dt * np.arange(PAST + 1)
    weights = np.linalg.pinv(np.stack([time**0, time, time**2], axis=1))[1]
    return np.einsum("k,ska->sa", weights, away)


def errors(scene: Scene, log: Transitions, starts: np.ndarray, model: object, v: np.ndarray) -> np.ndarray:
    """Errors (S, 2) of place [mm] and rotation [mrad] after all steps."""
    u = log.u[starts[:, None] + np.arange(STEPS)]
    with torch.no_grad():
        q, _ = rollout(model, torch.as_tensor(log.q[starts]), torch.as_tensor(v), torch.as_tensor(u))  # type: ignore[arg-type]
    return sizes_of(scene.difference(log.q_next[starts + STEPS - 1], q[:, -1].numpy()))


def hindsight(model: ComplementarityModel, log: Transitions, starts: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The same from the best starts within the noise of the capture, and of velocities from two frames."""
    evidence = Evidence.of(model, log)
    both = np.concatenate([sizes, np.sqrt(2.0) * sizes / log.dt])
    loss = evidence.loss(starts, STEPS, *evidence.scales(STEPS, 0.5, both[None]))
    settled = loss.settled(evidence.space.nominal)
    moved = replace(log, q=log.q.copy(), v=log.v.copy())
    moved.q[starts], moved.v[starts] = settled.windows.begin(model.scene)
    return errors(model.scene, moved, starts, model, moved.v[starts])


def sizes_of(error: np.ndarray) -> np.ndarray:
    return 1e3 * np.stack([np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:6], axis=1)], axis=1)


def report(model: str, start: str, kinds: dict[str, np.ndarray], found: np.ndarray) -> None:
    found = np.where(np.isfinite(found), found, 1e6)
    for kind, mask in kinds.items():
        if mask.any():
            median, share = np.median(found[mask], axis=0), (found[mask] ** 2).sum(axis=0) / (found**2).sum(axis=0)
            rms = np.sqrt((found[mask] ** 2).mean(axis=0))
            print(
                f"{model[-24:]:<24} {start:<14} {kind:<10} {mask.sum():>5} windows: median {median[0]:5.1f} mm "
                f"{median[1]:4.0f} mrad, RMSE {rms[0]:5.1f} mm {rms[1]:4.0f} mrad, of all squares {share[0]:.2f} "
                f"{share[1]:.2f}", flush=True,
            )  # fmt: skip


if __name__ == "__main__":
    main()
