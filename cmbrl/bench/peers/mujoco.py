"""MuJoCo: models compiled from MJCF without a log file, and the names of its integrators."""

from __future__ import annotations

from pathlib import Path

import mujoco

from cmbrl.scene.mjcf import quiet as quiet

INTEGRATORS: dict[str, int] = {
    name.removeprefix("mjINT_").lower(): int(value) for name, value in mujoco.mjtIntegrator.__members__.items()
}  #: "euler", "rk4", ...: all that the installed version has


def compiled(mjcf: str | Path, integrator: str | None = None) -> mujoco.MjModel:
    """A new model of an MJCF text or file, with another integrator of :data:`INTEGRATORS` where one is given.

    A string that starts with "<" is an MJCF text, any other a path.
    """
    with quiet():
        text = isinstance(mjcf, str) and mjcf.lstrip().startswith("<")
        load = mujoco.MjModel.from_xml_string if text else mujoco.MjModel.from_xml_path
        model = load(str(mjcf))
    if integrator is not None:
        model.opt.integrator = INTEGRATORS[integrator]
    return model
