"""A flat picture of a MuJoCo state for computers without graphics: a camera's view, without perspective."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image, ImageDraw

SKY, GROUND = (236, 240, 245), (196, 201, 208)
MOVING, FIXED, EDGE = (214, 140, 62), (120, 128, 140), (60, 52, 44)
MARKS = 0.5  # m between marks on the ground, which show motion when the camera follows the robot
SHARP = 3  # drawn this many times larger, then reduced


def side_view(model: Any, data: Any, camera: int, width: int, height: int) -> np.ndarray:
    """(height, width, 3) uint8 of ``data`` (after mj_forward), seen by the camera of that index."""
    view = _View(model, data, camera, width * SHARP, height * SHARP)
    image = Image.new("RGB", view.size, SKY)
    draw = ImageDraw.Draw(image)
    planes = [g for g in range(model.ngeom) if model.geom_type[g] == 0]
    for g in planes:
        _draw_ground(draw, view, data.geom_xpos[g])
    others = [g for g in range(model.ngeom) if model.geom_type[g] != 0 and model.geom_rgba[g, 3] > 0]
    for g in sorted(others, key=lambda g: view.depth(data.geom_xpos[g])):  # the nearer last
        colour = MOVING if model.body_weldid[model.geom_bodyid[g]] else FIXED
        corners, radius = _core(model, data, g)
        outline = _hull(np.concatenate([_disc(c, radius * view.scale) for c in view.pixels(corners)]))
        draw.polygon([tuple(p) for p in outline], fill=colour, outline=EDGE, width=SHARP)
    return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS))


class _View:
    """From the world [m] to pixels, along the camera's line of sight."""

    def __init__(self, model: Any, data: Any, camera: int, width: int, height: int) -> None:
        self.size = (width, height)
        self.axes = data.cam_xmat[camera].reshape(3, 3).T  # right, up, back
        self.centre = data.cam_xpos[camera]
        distance = abs(self.axes[2] @ (self.centre - model.stat.center))
        tall = 2 * distance * np.tan(np.radians(model.cam_fovy[camera]) / 2)
        self.scale = height / tall  # pixels per metre

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) from (n, 3)."""
        right, up = ((points - self.centre) @ self.axes[:2].T).T
        return np.stack([self.size[0] / 2 + self.scale * right, self.size[1] / 2 - self.scale * up], axis=1)

    def depth(self, point: np.ndarray) -> float:
        """How near the camera, from far to near."""
        return float(self.axes[2] @ point)


def _draw_ground(draw: ImageDraw.ImageDraw, view: _View, place: np.ndarray) -> None:
    level = view.pixels(place[None])[0, 1]
    draw.rectangle([0, min(level, view.size[1]), *view.size], fill=GROUND)
    middle, half = view.centre[0], view.size[0] / 2 / view.scale
    for x in MARKS * np.arange(np.ceil((middle - half) / MARKS), np.floor((middle + half) / MARKS) + 1):
        across = view.pixels(np.array([[x, 0.0, 0.0]]))[0, 0]
        draw.line([across, level, across, level + 8 * SHARP], fill=FIXED, width=SHARP)


def _core(model: Any, data: Any, g: int) -> tuple[np.ndarray, float]:
    """Points (n, 3) whose hull, grown by a radius [m], is the geom: of spheres and capsules, else of its box."""
    kind, size, place = model.geom_type[g], model.geom_size[g], data.geom_xpos[g]
    frame = data.geom_xmat[g].reshape(3, 3)
    if kind == 2:  # sphere
        return place[None], float(size[0])
    if kind == 3:  # capsule
        return place + size[1] * np.array([[-1], [1]]) * frame[:, 2], float(size[0])
    box = model.geom_aabb[g]
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    return place + (box[:3] + signs * box[3:]) @ frame.T, 0.0


def _disc(centre: np.ndarray, radius: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _hull(points: np.ndarray) -> np.ndarray:
    """The convex hull of points (n, 2), in order (Andrew's monotone chain)."""

    def chain(ordered: list[np.ndarray]) -> list[np.ndarray]:
        kept: list[np.ndarray] = []
        for p in ordered:
            while len(kept) > 1:
                (ax, ay), (bx, by) = kept[-1] - kept[-2], p - kept[-1]
                if ax * by - ay * bx > 0:
                    break
                kept.pop()
            kept.append(p)
        return kept[:-1]

    ordered = sorted(np.unique(points, axis=0), key=tuple)
    return np.array(chain(ordered) + chain(ordered[::-1]))
