"""Which of MuJoCo's renderers draws here. Imports no mujoco, which reads MUJOCO_GL once, when it is imported."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

from cmbrl.errors import UserError

_PROBE = """import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
mujoco.Renderer(model, 16, 16).render()"""
FLAT = "drawn flat, because MuJoCo's renderer does not start"
REMEDY = "install Mesa's EGL (apt-get install libegl1 libgl1-mesa-dri) or OSMesa (apt-get install libosmesa6)"


def has_display() -> bool:
    """Whether a window can be opened, as far as the environment tells."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def choose_renderer() -> None:
    """Without a display, sets MUJOCO_GL to an off-screen renderer that works; call it before importing mujoco.

    Each candidate is tried in its own process, because a broken driver may crash it. If none works, a warning says what
    to install. Raises UserError if the user's MUJOCO_GL does not work.
    """
    named = os.environ.get("MUJOCO_GL")
    if has_display() and not named:
        return
    for name in [named] if named else ["egl", "osmesa"]:
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE], env=os.environ | {"MUJOCO_GL": name}, capture_output=True
        )
        if tried.returncode == 0:
            os.environ["MUJOCO_GL"] = name
            return
    if named:
        raise UserError(f"MUJOCO_GL={named} does not draw here: unset it, or {REMEDY}")
    warnings.warn(f"{FLAT}: {REMEDY}", stacklevel=2)


def can_draw() -> bool:
    """Whether MuJoCo's renderer can be expected to start."""
    return has_display() or bool(os.environ.get("MUJOCO_GL"))
