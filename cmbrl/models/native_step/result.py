"""What a batched step returns beside its tensors, and warns of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


class SolverWarning(RuntimeWarning):
    """Some contact solves of a batch did not converge; ``StepResult.status`` tells which."""


@dataclass(frozen=True)
class StepResult:
    """Result of one batched step, in numpy.

    q_next (B, nq); v_next (B, nv); status (B,), a :class:`~cmbrl.native.SolverStatus`; iterations (B,), summed over
    substeps; rung (B,), how far a solve climbed the ladder of fallbacks (0: no further than the first); residual (B,),
    the worst relative residual over substeps. On request: jacobian (B, 2 nv, 2 nv + nu
    [+ np]) of (q', v') in (q, v, u [, theta]), with q in tangent space; impulse (B, contacts, 2 or 3) [N s] along the
    rows of ``smooth_dynamics``, summed over substeps; without the moments of torsional and rolling friction.
    """

    q_next: np.ndarray
    v_next: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    rung: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray | None = None
    impulse: np.ndarray | None = None
