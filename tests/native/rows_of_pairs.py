"""Normal rows of contacts against MuJoCo's, of two free shapes in random poses, and in what they differ.

python -m tests.native.rows_of_pairs prints the table of docs/robots.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import mujoco
import numpy as np

from cmbrl.bench.check_steps import mujocos
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene

PAIRS = (
    ("capsule", "box"), ("capsule", "mesh"), ("cylinder", "box"), ("cylinder", "mesh"), ("cylinder", "cylinder"),
    ("box", "mesh"), ("ellipsoid", "box"),
)  # fmt: skip
DEEPEST = 3e-3  #: [m]
EQUAL = 1e-5  #: rows, whose numbers are up to 1
FLAT = 5.1  #: [degrees] within which sides lie on each other
NO_MORE_POINTS = int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)
FILE = """<mujoco><option cone="elliptic"/><asset><mesh name="mesh" vertex="{}"/></asset><worldbody>
<body><freejoint/><geom {} mass="1" margin="{}"/></body><body pos="1 0 0"><freejoint/><geom {} mass="1"/></body>
</worldbody></mujoco>"""


def geom(kind: str, rng: np.random.Generator) -> str:
    size = " ".join(f"{x:.4f}" for x in rng.uniform(0.02, 0.08, 3))
    return 'type="mesh" mesh="mesh"' if kind == "mesh" else f'type="{kind}" size="{size}"'


def robots(
    a: str, b: str, files: int, states: int, seed: int, margin: float
) -> Iterator[tuple[mujoco.MjModel, np.ndarray]]:
    """Models, and poses q (states, 14) in which the shapes overlap by up to DEEPEST, or are apart within the margin."""
    rng = np.random.default_rng(seed)
    for _ in range(files):
        stone = rng.normal(size=(20, 3))
        stone *= [0.06, 0.05, 0.04] / np.linalg.norm(stone, axis=1, keepdims=True)
        text = FILE.format(" ".join(f"{x:.5f}" for x in stone.ravel()), geom(b, rng), margin, geom(a, rng))
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 1000
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        yield model, np.array([overlapping(model, rng, margin) for _ in range(states)])


def overlapping(model: mujoco.MjModel, rng: np.random.Generator, margin: float) -> np.ndarray:
    data, q = mujoco.MjData(model), np.zeros(14)
    while not data.ncon or data.contact.dist.min() < margin - 1.3 * DEEPEST:
        q[3:7], q[10:14], along = rng.normal(size=4), rng.normal(size=4), rng.normal(size=3)
        along /= np.linalg.norm(along)
        deep, low, high = margin - rng.uniform(0, DEEPEST), 0.0, 0.5
        for _ in range(40):
            q[7:10] = 0.5 * (low + high) * along
            data.qpos[:] = q
            mujoco.mj_normalizeQuat(model, data.qpos)
            mujoco.mj_forward(model, data)
            if data.ncon and data.contact.dist.min() < deep:
                low = 0.5 * (low + high)
            else:
                high = 0.5 * (low + high)
    return data.qpos.copy()


def rows(model: mujoco.MjModel, q: np.ndarray, flags: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's normal rows (n, 12), and its first normal (3,)."""
    data, model.opt.disableflags = mujoco.MjData(model), flags
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    model.opt.disableflags = 0
    return data.efc_J.reshape(-1, 12)[data.contact.efc_address], data.contact.frame[0, :3]


def verdict(ours: np.ndarray, model: mujoco.MjModel, q: np.ndarray) -> str:
    """In what our rows (n, 12) differ from MuJoCo's at q."""
    theirs, normal = rows(model, q)
    apart = np.abs(ours[:, None] - theirs).max(axis=2, initial=0.0)
    if len(ours) == len(theirs) and apart.min(axis=0).max() < EQUAL:
        return "equal"
    touch = rows(model, q, NO_MORE_POINTS)[1]  # MuJoCo's own normal of the touch, before it looks for more points
    if np.degrees(np.arccos(np.clip(touch @ normal, -1, 1))) > FLAT:
        return "MuJoCo's normal is a side's that is turned away from the touch"
    return "points beside each other" if len(ours) == len(theirs) > 1 else "another number, or one point elsewhere"


def shares(a: str, b: str, files: int = 12, states: int = 50, seed: int = 7, margin: float = 0.0) -> dict[str, float]:
    """Of the verdicts."""
    found: Counter[str] = Counter()
    for model, q in robots(a, b, files, states, seed, margin):
        scene = Scene.from_mjcf(model, self_contact="all")
        ours = ComplementarityModel(scene, **mujocos(scene))
        for state, problem in zip(
            q, ours.contact_problems(q, np.zeros((states, 12)), np.zeros((states, 0))), strict=True
        ):
            found[verdict(problem.J.reshape(-1, 3, 12)[:, 0], model, state)] += 1
    return {why: count / found.total() for why, count in found.most_common()}


if __name__ == "__main__":
    for first, second in PAIRS:
        print(first, second, shares(first, second))
