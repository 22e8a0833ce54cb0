"""Random states on which the core is judged: near contact, penetrating, at joint limits, fast, with any friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cmbrl.registry import load_task
from cmbrl.scene import Scene

G1 = Path(__file__).parents[3] / "shared/models/g1_reference.xml"  #: a folder beside the repository; not part of it
SCENES = ("hopper", "cheetah", "cube_toss", "g1")


@dataclass(frozen=True)
class Ranges:
    """How wild the states are. Gaps of the lowest contact [m], speeds [m/s, rad/s], share of joints at a limit."""

    gap: tuple[float, float] = (-0.005, 0.005)
    speed: float = 1.0
    at_limit: float = 0.2
    spread: float = 0.3  #: of joint positions without limits, and about the initial pose [m, rad]
    turn: float = 3.0  #: of free rotations [rad]; floating bases of robots get ``spread``


WILD = Ranges(gap=(-0.05, 0.02), speed=20.0)


def bench_scenes(files: Mapping[str, Path] | None = None, contact_law: str = "mujoco") -> dict[str, Scene]:
    """Scenes by label; ``files`` maps labels to MJCF files, by default the tasks and the G1 where its file is there."""
    if files is None:
        files = {name: Path(load_task(name).scene_path) for name in SCENES[:3]}
        if G1.exists():
            files["g1"] = G1
    return {name: Scene.from_mjcf(path, contact_law=contact_law) for name, path in files.items()}


def random_states(
    scene: Scene, count: int, rng: np.random.Generator, ranges: Ranges | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q (count, nq), v (count, nv), u (count, nu): the lowest contact with the ground has a gap in ``ranges.gap``.

    Joints with limits are uniform in them, some exactly at one and up to 0.05 rad or m beyond; controls fill 1.5 times
    their range, so that some are clamped. Every velocity is below ``ranges.speed``, in some states far below.
    """
    ranges = ranges or Ranges()
    core = scene.core
    q = np.empty((0, scene.nq))
    while len(q) < count:  # links of a robot may not overlap by more than it may sink into the ground
        more = _configurations(scene, count, rng, ranges)
        between = scene.gaps(more)[:, core.con_plane < 0].min(axis=1, initial=np.inf)
        q = np.concatenate([q, more[between >= ranges.gap[0]]])
    v = ranges.speed * rng.random((count, 1)) * rng.uniform(-1, 1, (count, scene.nv))
    control = np.reshape(core.act_ctrl, (-1, 2))
    low, high = np.where(np.isfinite(control), control, [-1.0, 1.0]).T
    u = (low + high) / 2 + 0.75 * (high - low) * rng.uniform(-1, 1, (count, scene.nu))
    return q[:count], v, u


def with_friction(scene: Scene, count: int, rng: np.random.Generator, highest: float = 10.0) -> np.ndarray:
    """Parameters (count, np): nominal, but every friction coefficient uniform in [0, highest], a tenth of them zero."""
    theta = np.tile(scene.parameter_vector(), (count, 1))
    columns = [k for k, p in enumerate(scene.parameters) if p.group == "friction"]
    friction = rng.uniform(0, highest, (count, len(columns)))
    theta[:, columns] = np.where(rng.random(friction.shape) < 0.1, 0.0, friction)
    return theta


def _configurations(scene: Scene, count: int, rng: np.random.Generator, ranges: Ranges) -> np.ndarray:
    core = scene.core
    loose = not core.nlimit and "rotation" in scene.coordinate_kinds
    width = np.where([kind == "rotation" and loose for kind in scene.coordinate_kinds], ranges.turn, ranges.spread)
    q = scene.integrate(np.tile(scene.q0, (count, 1)), width * rng.normal(size=(count, scene.nv)))
    for adr, low, high in zip(core.lim_qadr, core.lim_lo, core.lim_hi, strict=True):
        inside, side = rng.uniform(low, high, count), rng.random(count) < 0.5
        beyond = rng.choice([0.0, 1.0], count) * rng.uniform(0, 0.05, count)
        at = np.where(side, low - beyond, high + beyond)
        q[:, adr] = np.where(rng.random(count) < ranges.at_limit, at, inside)
    _lower(scene, q, rng.uniform(*ranges.gap, count))
    return q


def _lower(scene: Scene, q: np.ndarray, gap: np.ndarray) -> None:
    """Moves the root along the position coordinate that is nearest to the normal of the first plane, in place."""
    planes = np.flatnonzero(scene.core.con_plane >= 0)
    roots = [j for j in scene.joints if j.kind == 0 and scene.core.body_parent[j.body] < 0]
    if not len(planes) or not roots:
        return
    step, here = 1e-3, scene.gaps(scene.q0)[planes]
    slopes = []
    for joint in roots:
        moved = np.array(scene.q0)
        moved[joint.qadr] += step
        slopes.append(np.mean(scene.gaps(moved)[planes] - here) / step)
    best = int(np.argmax(np.abs(slopes)))
    q[:, roots[best].qadr] += (gap - scene.gaps(q)[:, planes].min(axis=1)) / slopes[best]
