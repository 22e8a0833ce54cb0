"""A clip of episodes side by side, each with its time and return in a caption; MP4 or GIF."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from cmbrl.envs.drawing import Drawer
from cmbrl.errors import UserError
from cmbrl.files import atomic_path

if TYPE_CHECKING:  # it imports mujoco, which must wait until a renderer is chosen
    from cmbrl.envs.episode import Episode

WIDTH, HEIGHT, CAPTION = 480, 360, 24  # pixels of a panel; video codecs need multiples of 16 in total
_FRAMES_PER_SECOND = {".mp4": 30, ".gif": 15}  # GIFs are large


def check_clip_path(path: str | os.PathLike[str]) -> None:
    """Raises UserError unless the suffix is a format that this installation can write."""
    suffix = Path(path).suffix.lower()
    if suffix not in _FRAMES_PER_SECOND:
        raise UserError(f"{path}: unknown clip format: use .mp4 or .gif")
    if suffix == ".mp4":
        try:
            import imageio_ffmpeg

            imageio_ffmpeg.get_ffmpeg_exe()
        except (ImportError, RuntimeError) as error:
            raise UserError(f"{path}: MP4 needs ffmpeg ({error}): pip install 'cmbrl[play]', or make a .gif") from None


def write_clip(path: str | os.PathLike[str], scene: str, episodes: Mapping[str, Episode]) -> int:
    """Draws ``episodes`` (title -> episode) of the MJCF ``scene`` in real time; returns the number of frames.

    Raises UserError if the format cannot be written.
    """
    check_clip_path(path)
    dt = next(iter(episodes.values())).dt
    stride = max(1, round(1 / (_FRAMES_PER_SECOND[Path(path).suffix.lower()] * dt)))
    seconds = stride * dt
    frames = _frames(scene, episodes, stride)
    with atomic_path(path) as temporary:
        if temporary.suffix.lower() == ".gif":
            _write_gif(temporary, frames, seconds)
        else:
            _write_mp4(temporary, frames, seconds)
    return len(frames)


def _write_gif(path: Path, frames: list[np.ndarray], seconds: float) -> None:
    first, *rest = (Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE) for frame in frames)
    first.save(path, save_all=True, append_images=rest, duration=round(1000 * seconds), loop=0)


def _write_mp4(path: Path, frames: list[np.ndarray], seconds: float) -> None:
    import imageio.v2 as imageio
    from imageio_ffmpeg import count_frames_and_secs

    writer: Any
    options: dict[str, Any] = {"codec": "libx264", "quality": 8, "ffmpeg_log_level": "quiet"}
    try:
        with imageio.get_writer(path, fps=1 / seconds, **options) as writer:
            for frame in frames:
                writer.append_data(frame)
        count = count_frames_and_secs(str(path))[0]  # ffmpeg's exit code, which tells of a full disk, is not passed on
    except (OSError, RuntimeError):
        count = 0
    if count != len(frames):
        raise OSError("ffmpeg could not write all of it")


def _frames(scene: str, episodes: Mapping[str, Episode], stride: int) -> list[np.ndarray]:
    """Pictures (CAPTION + HEIGHT, panels * WIDTH, 3); an episode that has ended is frozen."""
    seen = np.concatenate([episode.q[::stride] for episode in episodes.values()])
    drawer = Drawer(scene, WIDTH, HEIGHT, seen)
    try:
        panels = [_panels(drawer, title, episode, stride) for title, episode in episodes.items()]
    finally:
        drawer.close()
    longest = max(map(len, panels))
    return [np.concatenate([p[min(k, len(p) - 1)] for p in panels], axis=1) for k in range(longest)]


def _panels(drawer: Drawer, title: str, episode: Episode, stride: int) -> list[np.ndarray]:
    """Captioned pictures of every ``stride``-th configuration and of the last."""
    last = len(episode.q) - 1
    return [_panel(drawer, title, episode, k) for k in (*range(0, last, stride), last)]


def _panel(drawer: Drawer, title: str, episode: Episode, k: int) -> np.ndarray:
    text = f"{title}   {k * episode.dt:.2f} s   return {episode.returns[k]:.4g}"
    if k == len(episode.q) - 1 and episode.terminated:
        text += "   ended"
    panel = Image.new("RGB", (WIDTH, CAPTION + HEIGHT), "white")
    panel.paste(Image.fromarray(drawer.draw(episode.q[k])), (0, CAPTION))
    ImageDraw.Draw(panel).text((8, 4), text, fill="black", font=ImageFont.load_default(14))
    return np.asarray(panel)
