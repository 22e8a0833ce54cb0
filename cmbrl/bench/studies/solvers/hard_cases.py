"""One-step problems that break contact solvers, with answers known by hand or judged by their residuals alone.

Units: kg, m, s; gravity 9.81, step 1 ms. Labels F1 to F28 are the scenes of ``cmbrl bench stability``.
"""

from __future__ import annotations

import numpy as np

from cmbrl.contact.problem import Array, ContactProblem

G, H = 9.81, 1e-3
FAMILY = "hard cases"
INFEASIBLE = "F17 slot, rigid"  #: has no solution: two walls overlap


def hard_cases() -> list[ContactProblem]:
    """All of them. Nobody can solve :data:`INFEASIBLE`; it shows how solvers react."""
    return [
        *(stack(n, top) for n in (2, 5, 10) for top in (1.0, 1e3, 1e6)),
        cube("F2 cube at rest"),
        cube("F3 cube sliding and spinning", v=(0.3, 1.0, -0.5), spin=3.0),
        cube("F4 cube sliding", v=(0.0, 1.0, 0.0)),
        rod("F15 Painleve rod, mu 1.5", 1.5),
        rod("F15 Painleve rod, mu 2", 2.0),
        rod("F16 three solutions", 2.0, separating=0.1),
        slot(INFEASIBLE, 0.0),
        slot("F17 slot, compliant", 1e-2),
        cube("F20 mu 0", v=(0.0, 1.0, 0.0), mu=0.0),
        cube("F20 mu 1000", v=(0.0, 1.0, 0.0), mu=1e3),
        limit_and_floor(),
        problem("F28 graze", np.eye(2), np.array([[[0.0, 1.0], [1.0, 0.0]]]), np.array([1.0, 0.0]), np.array([0.4])),
    ]


def problem(name: str, M: Array, J: Array, v_free: Array, mu: Array, b: Array | None = None, R: float = 0.0,
            family: str = FAMILY) -> ContactProblem:  # fmt: skip
    """A problem with its speed scale; ``b`` and ``R`` default to zero."""
    b = np.zeros(J.shape[:2]) if b is None else b
    speed = max(G * H, float(np.linalg.norm(J @ v_free + b)))
    return ContactProblem(M, J, v_free, b, mu, np.full(b.shape, R), speed, f"{family}/{name}")


def stack(n: int, top: float) -> ContactProblem:
    """F1: ``n`` point masses of 1 kg at rest in the plane, stacked; the highest has ``top`` kg.

    Truth: v' = 0, and the impulse of contact k is g h times the mass above it.
    """
    masses = np.ones(n)
    masses[-1] = top
    J = np.zeros((n, 2, 2 * n))
    for k in range(n):
        J[k, 0, 2 * k + 1] = J[k, 1, 2 * k] = 1.0
        if k:
            J[k, 0, 2 * k - 1] = J[k, 1, 2 * k - 2] = -1.0
    v_free = np.tile([0.0, -G * H], n)
    return problem(f"F1 stack of {n}, top {top:g} kg", np.diag(np.repeat(masses, 2)), J, v_free, np.full(n, 0.5))


def cube(name: str, v: tuple[float, float, float] = (0.0, 0.0, 0.0), spin: float = 0.0, mu: float = 0.4,
         side: float = 0.2) -> ContactProblem:  # fmt: skip
    """F2, F3, F4, F20: a cube of 1 kg on its four lower corners; hyperstatic, as G has rank 6 of 12."""
    half, inertia = side / 2, side**2 / 6
    corners = [np.array([x, y, -half]) for x in (half, -half) for y in (half, -half)]
    J = np.stack([point_rows(r) for r in corners])
    v_free = np.array([v[0], v[1], v[2] - G * H, 0.0, 0.0, spin])
    return problem(name, np.diag([1.0] * 3 + [inertia] * 3), J, v_free, np.full(4, mu))


def point_rows(r: Array) -> Array:
    """Rows (normal z, tangents x and y) of a point at ``r`` from the centre of a free body, (3, 6)."""
    turning = -np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    return np.hstack([np.eye(3), turning])[[2, 0, 1]]


def rod(name: str, mu: float, separating: float = 0.0) -> ContactProblem:
    """F15, F16: a rod (half-length 1, 1 kg, tan theta = 2) whose tip slides at 5 m/s into the ground.

    Truth of F15 as h -> 0: for mu >= 4/3 it jams, with impulses 1.5 and 2.0 N s. ``separating`` [m/s]: tip speed.
    """
    sine, cosine = 2 / np.sqrt(5), 1 / np.sqrt(5)
    J = np.array([[[0.0, 1.0, -cosine], [1.0, 0.0, sine]]])
    turning = -separating / cosine
    v_free = np.array([-5.0 - sine * turning, -G * H, turning])
    return problem(name, np.diag([1.0, 1.0, 1 / 3]), J, v_free, np.array([mu]))


def slot(name: str, R: float) -> ContactProblem:
    """F17: a slider that both walls overlap by 1 mm. Rigid, it has no solution; otherwise impulses are 1/R."""
    J = np.array([[[1.0, 0.0], [0.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]])
    return problem(name, np.eye(2), J, np.array([0.0, -G * H]), np.zeros(2), np.array([[-1.0, 0.0]] * 2), R)


def limit_and_floor() -> ContactProblem:
    """F21: a pendulum (rod, 1 m, 1 kg) that rests on its joint limit and on the floor; v' = 0."""
    angle = 0.5
    J = np.array([[[np.cos(angle)], [np.sin(angle)]], [[1.0], [0.0]]])
    v_free = np.array([-1.5 * G * H * np.cos(angle)])
    return problem("F21 limit and floor", np.array([[1 / 3]]), J, v_free, np.array([0.5, 0.0]))
