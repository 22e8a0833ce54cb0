"""Ball throw: a disc, the ground and a wall; the real system is pymunk (Chipmunk 2D) with restitution and friction.

The real system is continuous, so the model takes 10 steps of 1 ms: a semi-implicit step is off by g h^2 / 2 in position
and its impacts by g h in speed, for which a fit at h = 10 ms would blame gravity and restitution (3 %; 0.5 % here).
An impact changes the velocity anywhere within a control step, during which the ball moves up to 45 mm: that is why a
transition counts as contact up to a gap of 20 mm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cmbrl.registry import Task


def _record(**arguments: Any) -> Any:
    from tasks.ball_throw.real import record

    return record(**arguments)


TASK = Task(
    name="ball_throw",
    description="a disc thrown against ground and wall, with restitution and friction (pymunk); no control",
    scene=Path(__file__).with_name("scene.xml"),
    control_dt=0.01,
    substeps=10,
    time_step=0.001,
    contact_law="rigid",
    smoothing_kappa=1e-8,
    contact_gap=0.02,
    behaviours=("random",),
    recorder=_record,
)
