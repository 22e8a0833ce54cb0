"""A body in flight falls as gravity says: another time step or unit shows by its factor."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cmbrl.data.plausible.finding import Finding
from cmbrl.scene.records import WORLD, JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

WINDOW = 12  #: samples of one parabola
APART = 0.02  #: [m] gap to everything
MOST = 1000  #: windows
LEAST = 10  #: windows
IMPOSSIBLE = 50  #: times gravity; no robot goes on like this
WRONG = 0.2  #: relative deviation from gravity


def free_fall(q: np.ndarray, blocks: tuple[slice, ...], dt: float, scene: Scene) -> Iterator[Finding]:
    """Compares the fall of the centre of mass in flight with the file's gravity.

    Only for one robot or body that nothing holds: its root has all slides and no actuator, and nothing else acts on it.
    """
    core, g = scene.core, scene.gravity
    strength = float(np.linalg.norm(g))
    if strength == 0 or not _flies(scene) or core.nbox or core.nellipsoid or core.nlift or core.ntie:
        return
    starts = np.concatenate(
        [np.arange(b.start, max(b.stop - WINDOW, b.start), 3) for b in blocks] or [np.zeros(0, int)]
    )
    if len(starts) < LEAST:
        return
    starts = starts[np.unique(np.linspace(0, len(starts) - 1, MOST).astype(int))]
    rows = starts[:, None] + np.arange(WINDOW)
    height = scene.centre_of_mass(q[rows]) @ (g / strength)  # (windows, WINDOW), rising as it falls
    t = np.arange(WINDOW) - (WINDOW - 1) / 2
    basis = np.polynomial.legendre.legvander(t / t[-1], 2)
    fitted = np.linalg.lstsq(basis, height.T, rcond=None)[0]
    rest = (height.T - basis @ fitted).std(axis=0)
    fall = 3 * fitted[2] / (t[-1] * dt) ** 2  # second derivative of the second Legendre polynomial
    usual = float(np.median(np.abs(fall)))
    if usual > IMPOSSIBLE * strength:
        yield _finding(usual, strength, dt)
        return
    clear = rest < 0.05 * np.abs(fitted[2])
    if core.ncontact:
        clear &= scene.gaps(q[rows[:, [0, WINDOW // 2, WINDOW - 1]]]).min(axis=(1, 2)) > APART
    if clear.sum() < LEAST:
        return
    typical = float(np.median(fall[clear]))
    spread = 1.4826 * float(np.median(np.abs(fall[clear] - typical)))
    if typical > 0 and spread < 0.15 * typical and abs(typical / strength - 1) > WRONG:
        yield _finding(typical, strength, dt)


def _finding(fall: float, gravity: float, dt: float) -> Finding:
    factor = fall / gravity
    cause = "millimetres instead of metres" if 100 < factor < 2000 else f"lengths {factor:.3g} times too large"
    return Finding(
        f"q of the body in flight falls by {fall:.4g} m/s^2, gravity in the file is {gravity:.4g}: the wrong rate (dt "
        f"should be {dt * np.sqrt(factor):.4g} s), or {cause}?"
    )


def _flies(scene: Scene) -> bool:
    core = scene.core
    roots = [b for b in range(core.nbody) if core.body_parent[b] == WORLD]
    if len(roots) != 1:
        return False
    first = core.body_jadr[roots[0]]
    joints = range(first, first + core.body_jnum[roots[0]])
    slides = [j for j in joints if core.jnt_type[j] == JointKind.SLIDE]
    if len(slides) != core.layout.dimension:
        return False
    dofs = [int(core.jnt_vadr[j]) for j in slides]
    held = set(core.act_line.tolist()) | set(core.lim_line.tolist())
    forces = [core.P[scene.layout.dof(d, f)] for d in dofs for f in ("damping", "stiffness", "frictionloss")]
    return not held & set(dofs) and not any(forces) and not (core.nwide or core.nlink)
