"""Pictures of a scene at a configuration, by MuJoCo's renderer: of the real system and of a model alike."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.errors import UserError

_PROBE = """import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
mujoco.Renderer(model, 16, 16).render()"""
_SKY, _LIGHT, _DARK = (0.93, 0.95, 0.97), (0.82, 0.84, 0.86), (0.7, 0.73, 0.76)
_FIXED, _MOVING = (0.35, 0.4, 0.48), (0.85, 0.5, 0.2)
_OURS = "cmbrl "  # begins the names of what is added, which no name of the file's should equal
_GREY = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of a geom that has none
_SHADOWS = 1024  # pixels: MuJoCo's 4096 take half the time of a picture where the processor draws it
_REMEDY = "install Mesa's EGL (apt-get install libegl1 libgl1-mesa-dri) or OSMesa (apt-get install libosmesa6)"


def has_display() -> bool:
    """Whether a window can be opened, as far as the environment tells."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def choose_renderer() -> None:
    """Without a display, sets MUJOCO_GL to what draws off screen here; call it before mujoco is first imported.

    Each candidate is tried in a process of its own, since a broken driver may take its process down. Raises UserError
    that says what to install when none draws.
    """
    if has_display() and "MUJOCO_GL" not in os.environ:
        return
    candidates = [os.environ["MUJOCO_GL"]] if "MUJOCO_GL" in os.environ else ["egl", "osmesa"]
    for name in candidates:
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE], env=os.environ | {"MUJOCO_GL": name}, capture_output=True
        )
        if tried.returncode == 0:
            os.environ["MUJOCO_GL"] = name
            return
    raise UserError(f"nothing can be drawn without a display ({' and '.join(candidates)} failed): {_REMEDY}")


class SceneDrawer:
    """Draws the MJCF at ``path`` in pictures of ``width`` x ``height``; close it at the end.

    The camera is the MJCF's first; without one it looks along +y at all that is not a plane, so that every one of the
    configurations ``seen`` (N, nq) is in the picture. An MJCF without lights, sky or colours gets ours.

    Raises UserError when MuJoCo cannot draw here.
    """

    def __init__(self, path: str, seen: Iterable[np.ndarray], width: int = 480, height: int = 360) -> None:
        import mujoco

        self._mujoco = mujoco
        self.model = _dressed(mujoco, path)
        self.model.vis.quality.shadowsize = min(self.model.vis.quality.shadowsize, _SHADOWS)
        self.data = mujoco.MjData(self.model)
        self.camera: Any = 0 if self.model.ncam else self._whole_view(seen, width / height)
        try:
            self._renderer = mujoco.Renderer(self.model, height, width)
        except Exception as error:  # whatever the graphics driver raises
            raise UserError(f"MuJoCo cannot draw here ({error}): set MUJOCO_GL=egl, or {_REMEDY}") from None

    def draw(self, q: np.ndarray) -> np.ndarray:
        """A picture (height, width, 3) uint8 of the configuration q (nq,)."""
        self._place(q)
        self._renderer.update_scene(self.data, self.camera)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        self._renderer.close()

    def _place(self, q: np.ndarray) -> None:
        self.data.qpos[:] = q
        self._mujoco.mj_forward(self.model, self.data)

    def _whole_view(self, seen: Iterable[np.ndarray], aspect: float) -> Any:
        """A camera that has the box around all geoms, planes left out, in view."""
        solid = self.model.geom_type != self._mujoco.mjtGeom.mjGEOM_PLANE
        radius = self.model.geom_rbound[solid, None]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for q in seen:
            self._place(q)
            centre = self.data.geom_xpos[solid]
            low = np.minimum(low, (centre - radius).min(axis=0))
            high = np.maximum(high, (centre + radius).max(axis=0))
        size = high - low
        half_angle = np.radians(self.model.vis.global_.fovy) / 2
        camera = self._mujoco.MjvCamera()
        camera.lookat[:] = (low + high) / 2
        camera.distance = 1.15 * max(size[2], size[0] / aspect) / (2 * np.tan(half_angle)) + size[1] / 2
        camera.azimuth, camera.elevation = 90.0, -8.0
        return camera


def _dressed(mujoco: Any, path: str) -> Any:
    """The compiled MJCF; where it has no sky, light or ground pattern, or MuJoCo's grey for a colour, with ours."""
    with without_mujoco_warnings(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # said when the scene was read
        spec = mujoco.MjSpec.from_file(path)
        _add_sky_and_ground(mujoco, spec)
        model = spec.compile()
    if not model.nlight:
        model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.45, 0.5
    plain = (model.geom_matid < 0) & (model.geom_rgba == _GREY).all(axis=1)
    moving = model.body_weldid[model.geom_bodyid] > 0
    for which, colour in ((moving, _MOVING), (~moving, _FIXED)):
        model.geom_rgba[plain & which, :3] = colour
    return model


def _add_sky_and_ground(mujoco: Any, spec: Any) -> None:
    """A bright sky, and squares of 0.5 m on planes without a material, over which motion can be seen."""
    kind, pattern = mujoco.mjtTexture, mujoco.mjtBuiltin
    if not any(texture.type == kind.mjTEXTURE_SKYBOX for texture in spec.textures):
        sky = {"builtin": pattern.mjBUILTIN_GRADIENT, "rgb1": _SKY, "rgb2": _SKY, "width": 64, "height": 384}
        spec.add_texture(name=_OURS + "sky", type=kind.mjTEXTURE_SKYBOX, **sky)
    planes = [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE and not g.material]
    if planes:
        squares = {"builtin": pattern.mjBUILTIN_CHECKER, "rgb1": _LIGHT, "rgb2": _DARK, "width": 256, "height": 256}
        spec.add_texture(name=_OURS + "squares", type=kind.mjTEXTURE_2D, **squares)
        ground = spec.add_material(name=_OURS + "ground", texuniform=True, texrepeat=(1.0, 1.0))
        ground.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = _OURS + "squares"
    for geom in planes:
        geom.material = _OURS + "ground"
