"""Pictures of robots in their home pose, as MuJoCo renders their files, on one sheet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cmbrl.envs.renderer import choose_renderer

choose_renderer()  # before mujoco is imported

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from PIL import Image, ImageDraw  # noqa: E402

TILE, COLUMNS, LABEL = 160, 8, 14  # pixels, tiles a row, pixels of the name
FINER = 2  # rendered at so many times the size
BODY, WORLD = (0.35, 0.52, 0.72, 1.0), (0.8, 0.8, 0.8, 1.0)  # colours of what moves and what stands


def contact_sheet(files: Sequence[Path], out: Path) -> None:
    """One tile a robot, with the name of its folder."""
    rows = -(-len(files) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + LABEL)), "white")
    pen = ImageDraw.Draw(sheet)
    for k, file in enumerate(files):
        x, y = k % COLUMNS * TILE, k // COLUMNS * (TILE + LABEL)
        sheet.paste(picture(file).resize((TILE, TILE), Image.Resampling.LANCZOS), (x, y))
        pen.text((x + TILE // 2, y + TILE + LABEL // 2), file.parent.name, fill="black", anchor="mm", font_size=11)
    sheet.quantize(128).save(out, optimize=True)


def picture(file: Path) -> Image.Image:
    """A robot on white, seen from the front and above."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    moves = model.body_weldid[model.geom_bodyid] != 0
    seen = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_rgba[:] = np.where(moves[:, None], BODY, WORLD)
    model.geom_rgba[~seen] = 0
    model.geom_matid[:] = -1
    low = (data.geom_xpos - model.geom_rbound[:, None])[seen & moves].min(axis=0)
    high = (data.geom_xpos + model.geom_rbound[:, None])[seen & moves].max(axis=0)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (low + high) / 2
    camera.distance, camera.azimuth, camera.elevation = 1.3 * float(np.linalg.norm(high - low)), 140, -20
    option = mujoco.MjvOption()
    option.geomgroup[:] = 1
    size = FINER * TILE
    model.vis.global_.offwidth = model.vis.global_.offheight = size
    model.vis.headlight.ambient[:] = 0.4
    with mujoco.Renderer(model, size, size) as renderer:
        renderer.update_scene(data, camera, option)
        pixels = renderer.render().copy()
        renderer.enable_segmentation_rendering()
        pixels[renderer.render()[:, :, 0] < 0] = 255
    return Image.fromarray(pixels)
