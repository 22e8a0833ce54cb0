"""Hopper with a payload: a robot whose file is wrong, so that a fit has something to find.

The model starts from Gymnasium's hopper.xml. The real system is MuJoCo on a changed copy of that file: real.py has the
table of changes. Everything else is the task ``hopper``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cmbrl.tasks.hopper import TASK as HOPPER


def _record(**arguments: Any) -> Any:
    from cmbrl.tasks.hopper_payload import real

    return real.record(HOPPER, **arguments)


def _system() -> Any:
    from cmbrl.tasks.hopper_payload import real

    return real.system(HOPPER.scene_path)


TASK = replace(
    HOPPER,
    name="hopper_payload",
    description="Hopper-v5 with a payload, weak motors and a slippery foot, which its file does not know",
    recorder=_record,
    system=_system,
)
