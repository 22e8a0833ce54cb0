"""Pictures of a scene at a configuration, by MuJoCo's renderer or, without a graphics driver, drawn flat."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from cmbrl.data.recorder import without_mujoco_warnings
from cmbrl.envs.renderer import FLAT, REMEDY, can_draw
from cmbrl.envs.side_view import side_view

_SKY, _LIGHT, _DARK = (0.93, 0.95, 0.97), (0.82, 0.84, 0.86), (0.7, 0.73, 0.76)
_FIXED, _MOVING = (0.35, 0.4, 0.48), (0.85, 0.5, 0.2)
_TILT = np.radians(8.0)  # our camera looks down by this angle
_OURS = "cmbrl "  # prefix of added names, so that they differ from the file's
_CAMERA = _OURS + "camera"
_GREY = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of a geom that has none
_DRAWN = 3  # MuJoCo draws geoms of groups below
_SHADOWS = 1024  # pixels; MuJoCo's 4096 take half of the drawing time on a CPU


class Drawer:
    """Pictures of the MJCF at ``path``, ``width`` x ``height``; close it at the end.

    MuJoCo's renderer draws if there is a display or MUJOCO_GL is set; otherwise, or if it does not start (a warning
    says what to install), pictures are flat. The camera is the MJCF's first one. Without one, ours looks along +y and
    shows everything but planes and height fields at all configurations ``seen`` (N, nq). Missing lights, sky and
    colours are added.
    """

    def __init__(
        self, path: str, width: int = 480, height: int = 360, seen: Iterable[np.ndarray] | None = None
    ) -> None:
        import mujoco

        self.width, self.height = width, height
        self._mujoco = mujoco
        self.model = _dressed(mujoco, path)
        self.data = mujoco.MjData(self.model)
        if self.model.camera(0).name == _CAMERA:
            self._look_at(*(self._box(seen) if seen is not None else _extent(self.model)))
        self._renderer = _renderer(mujoco, self.model, width, height) if can_draw() else None

    def draw(self, q: np.ndarray) -> np.ndarray:
        """A picture (height, width, 3) uint8 of the configuration q (nq,)."""
        self._place(q)
        if self._renderer is None:
            return side_view(self.model, self.data, 0, self.width, self.height)
        self._renderer.update_scene(self.data, 0)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        """Frees the graphics driver's resources."""
        if self._renderer is not None:
            self._renderer.close()

    def _place(self, q: np.ndarray) -> None:
        self.data.qpos[:] = q
        self._mujoco.mj_forward(self.model, self.data)

    def _box(self, seen: Iterable[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) of the box around all geoms except planes and height fields, at all configurations."""
        kinds = self._mujoco.mjtGeom
        solid = ~np.isin(self.model.geom_type, (kinds.mjGEOM_PLANE, kinds.mjGEOM_HFIELD))
        radius = self.model.geom_rbound[solid, None]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for q in seen:
            self._place(q)
            centre = self.data.geom_xpos[solid]
            low = np.minimum(low, (centre - radius).min(axis=0))
            high = np.maximum(high, (centre + radius).max(axis=0))
        return low, high

    def _look_at(self, low: np.ndarray, high: np.ndarray) -> None:
        """Places our camera so that it sees a box."""
        size = high - low
        tall = max(size[2], size[0] * self.height / self.width)
        distance = 1.15 * tall / (2 * np.tan(np.radians(self.model.cam_fovy[0]) / 2)) + size[1] / 2
        back = np.array([0.0, -np.cos(_TILT), np.sin(_TILT)])
        self.model.cam_pos[0] = (low + high) / 2 + distance * back
        half = (np.pi / 2 - _TILT) / 2  # a camera looks along -z; turned about x it looks along +y and slightly down
        self.model.cam_quat[0] = np.cos(half), np.sin(half), 0.0, 0.0


def _renderer(mujoco: Any, model: Any, width: int, height: int) -> Any:
    """MuJoCo's, or None with a warning."""
    frame = model.vis.global_
    frame.offwidth, frame.offheight = max(frame.offwidth, width), max(frame.offheight, height)
    model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, _SHADOWS)
    try:
        return mujoco.Renderer(model, height, width)
    except Exception as error:  # whatever the graphics driver raises
        warnings.warn(f"{FLAT} ({error}): set MUJOCO_GL=egl, or {REMEDY}", stacklevel=3)
        return None


def _extent(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box around the scene as MuJoCo measures it."""
    return model.stat.center - model.stat.extent, model.stat.center + model.stat.extent


def _dressed(mujoco: Any, path: str) -> Any:
    """The compiled MJCF, with our sky, light, ground pattern and colours where it has none."""
    with without_mujoco_warnings(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # shown when the scene was read
        spec = mujoco.MjSpec.from_file(path)
        _add_sky_and_ground(mujoco, spec)
        if not spec.cameras:
            spec.worldbody.add_camera(name=_CAMERA)
        model = spec.compile()
    if not model.nlight:
        model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.45, 0.5
    plain = (model.geom_matid < 0) & (model.geom_rgba == _GREY).all(axis=1)
    moving = model.body_weldid[model.geom_bodyid] > 0
    for which, colour in ((moving, _MOVING), (~moving, _FIXED)):
        model.geom_rgba[plain & which, :3] = colour
    _unhide(model)
    return model


def _unhide(model: Any) -> None:
    """Bodies whose geoms are all in groups that MuJoCo does not draw show them: a file without looks has no others."""
    shown = model.geom_group < _DRAWN
    bare = ~np.isin(model.geom_bodyid, model.geom_bodyid[shown])
    model.geom_group[bare] = 0


def _add_sky_and_ground(mujoco: Any, spec: Any) -> None:
    """A bright sky, and squares of 0.5 m on planes without a material, so that motion can be seen."""
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
