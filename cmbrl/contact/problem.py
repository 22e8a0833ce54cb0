"""A single contact problem as solvers see it: one step of a robot, without the robot.

    M (v' - v_free) = J^T lambda,    c = J v' + b + R lambda,    K_mu contains lambda, c obeys Signorini and Coulomb

or, where ``convex`` says so, the convex law of sliding, as MuJoCo's: c is in the dual cone and perpendicular to lambda.

Rows of a contact are (normal, tangents): nt = 1 tangent in the plane, 2 in space. Torsional and rolling friction are
further tangents, one cone around all of them: 2 in the plane, 3 or 5 in space, scaled so that mu bounds them, too; they
are zero rows of contacts that only slide. A joint limit is a contact with mu = 0 and zero tangent rows. A ``.npz`` file
holds many problems (:func:`save`, :func:`load`).
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from cmbrl.errors import UserError
from cmbrl.files import write_bytes

Array = NDArray[np.float64]
FIELDS = ("M", "J", "v_free", "b", "mu", "R", "convex")


@dataclass(frozen=True)
class ContactProblem:
    """M (nv, nv); J (n, 1 + nt, nv); v_free (nv,) [m/s]; b (n, 1 + nt) [m/s]: gap term of the normal row (phi/h if
    rigid), surface speed in the tangents; mu (n,); R (n, 1 + nt) [1/kg] compliance of the rows; speed [m/s]: the scale
    of velocities, max(g h, |u_free|); convex (n,): 1 for contacts under the convex law of sliding, 0 for the exact one
    (default: all).

    Raises UserError if shapes disagree, a value is not finite, mu or R is negative, convex is neither 0 nor 1, or speed
    is not positive.
    """

    M: Array
    J: Array
    v_free: Array
    b: Array
    mu: Array
    R: Array
    speed: float
    name: str = "problem"
    convex: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n, nv = len(self.mu), len(self.v_free)
        if self.convex is None:
            object.__setattr__(self, "convex", np.zeros(n))
        rows = self.J.shape[1] if self.J.ndim == 3 else 0
        shapes = {"M": (nv, nv), "J": (n, rows, nv), "v_free": (nv,), "b": (n, rows), "mu": (n,), "R": (n, rows)}
        shapes["convex"] = (n,)
        for field, shape in shapes.items():
            value = getattr(self, field)
            if value.shape != shape:
                raise UserError(
                    f"{self.name}: {field} has shape {value.shape}; {n} contacts and {nv} dofs need {shape}"
                )
            if not np.isfinite(value).all():
                raise UserError(f"{self.name}: {field} is not finite")
        if rows not in (2, 3, 4, 6):
            raise UserError(
                f"{self.name}: J has {rows} rows per contact; give 2 in the plane, 3 in space, or 4 or 6 with "
                "torsional and rolling friction"
            )
        for field, what in (("mu", "friction"), ("R", "compliance")):
            if (getattr(self, field) < 0).any():
                raise UserError(f"{self.name}: {field} ({what}) is negative; give values of at least 0")
        if not np.isin(self.convex, (0, 1)).all():
            raise UserError(f"{self.name}: convex has values other than 0 (Coulomb) and 1 (convex law of sliding)")
        if not 0 < self.speed < np.inf:
            raise UserError(f"{self.name}: speed is {self.speed:g}; give a positive, finite scale of velocities [m/s]")

    @property
    def rows(self) -> Array:
        """J with its rows stacked, (n (1 + nt), nv)."""
        return self.J.reshape(-1, len(self.v_free))

    def delassus(self) -> Array:
        """G = J M^-1 J^T (n (1 + nt), n (1 + nt)) [1/kg], without R."""
        return self.rows @ np.linalg.solve(self.M, self.rows.T)

    def free_contact_velocity(self) -> Array:
        """J v_free + b, (n, 1 + nt) [m/s]."""
        return self.J @ self.v_free + self.b

    def velocity(self, impulse: Array) -> Array:
        """v' (nv,) under the impulses lambda (n, 1 + nt)."""
        return self.v_free + np.linalg.solve(self.M, self.rows.T @ impulse.ravel())


def from_rows(rows: dict[str, Array], resolution: float, name: str) -> list[ContactProblem]:
    """Problems of a batch of states from arrays over all candidates, of which ``active`` (B, rows) enter.

    ``rows`` has M (B, nv, nv), v_free (B, nv), J (B, rows, 1 + nt, nv), b, R, mu and convex. ``resolution`` [m/s],
    g h, is the smallest speed that matters.
    """
    problems = []
    for k, active in enumerate(rows["active"].astype(bool)):
        J, b, mu, R, convex = (rows[key][k, active] for key in ("J", "b", "mu", "R", "convex"))
        v_free = rows["v_free"][k]
        speed = max(resolution, float(np.linalg.norm(J @ v_free + b)))
        problems.append(ContactProblem(rows["M"][k], J, v_free, b, mu, R, speed, f"{name} {k}", convex.astype(float)))
    return problems


def save(problems: Sequence[ContactProblem], path: str | os.PathLike[str]) -> None:
    """Writes problems into one ``.npz``: arrays ``<k>/M``, ``<k>/J``, ... and ``names``, ``speeds``."""
    arrays = {f"{k}/{field}": getattr(p, field) for k, p in enumerate(problems) for field in FIELDS}
    names, speeds = np.array([p.name for p in problems]), np.array([p.speed for p in problems])
    content = io.BytesIO()
    np.savez_compressed(content, names=names, speeds=speeds, **arrays)
    write_bytes(path, content.getvalue())


def load(path: str | os.PathLike[str]) -> list[ContactProblem]:
    """Reads what :func:`save` wrote; raises UserError if the file is missing or has no contact problems."""
    if not Path(path).is_file():
        raise UserError(f"{path}: no such file; give one written by 'cmbrl bench solvers --out DIR'")
    try:
        with np.load(path, allow_pickle=False) as data:
            speeds = data["speeds"]
            return [
                ContactProblem(
                    **{f: data[f"{k}/{f}"] for f in FIELDS if f != "convex" or f"{k}/convex" in data},
                    speed=float(speeds[k]),
                    name=str(name),
                )
                for k, name in enumerate(data["names"])
            ]
    except UserError:  # it names the problem
        raise
    except (KeyError, ValueError, TypeError, IndexError, EOFError, OSError, BadZipFile) as error:
        what = f"{path}: not a file of contact problems ({type(error).__name__})"
        raise UserError(f"{what}; write one with 'cmbrl bench solvers --out DIR'") from None
