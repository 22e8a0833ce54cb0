"""``cmbrl play``: a clip of a policy in the real system and in a model, side by side; or MuJoCo's viewer."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from cmbrl.cli.evaluate import model_word
from cmbrl.cli.models import MODEL_HELP, add_smoothing, check_model, load_model, real_system, saved_policy
from cmbrl.cli.options import add_seed, positive_number
from cmbrl.errors import UserError
from cmbrl.files import check_writable

EXAMPLE = """
cmbrl play runs/policy --out policy.mp4
cmbrl play runs/policy --out policy.gif --seconds 4 --seed 3
cmbrl play runs/policy --viewer
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--out", metavar="FILE", help="the clip to write: NAME.mp4 or NAME.gif")
    where.add_argument("--viewer", action="store_true", help="show the real system in MuJoCo's window instead")
    parser.add_argument("--model", metavar="M", help=f"beside the real system: {MODEL_HELP} (default: as trained)")
    parser.add_argument(
        "--seconds", type=positive_number, default=10.0, metavar="S", help="of the episode, at most (default 10)"
    )
    add_smoothing(parser)
    add_seed(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.envs.clip import check_clip_path
    from cmbrl.envs.drawing import choose_renderer, has_display

    saved, task, mdp = saved_policy(arguments.policy)
    if arguments.model is not None:
        check_model(arguments.model)
    if arguments.viewer and not has_display():
        raise UserError("--viewer: there is no display to open a window on: make a clip with --out FILE.mp4")
    if arguments.out:
        check_clip_path(arguments.out)
        check_writable(arguments.out)
        choose_renderer()  # before anything imports mujoco, as the next lines do

    import torch

    from cmbrl.envs.episode import play_episode
    from cmbrl.envs.system_batch import SystemBatch

    start = mdp.reset(1, torch.Generator().manual_seed(arguments.seed))
    models: dict[str, Any] = {"real": SystemBatch(real_system(task), 1)}
    policy = Path(arguments.policy)
    word = None if arguments.viewer else model_word(policy, saved.about, arguments.model, real_only=False)
    if word is not None:
        models["model"] = load_model(word, task, arguments.smoothing)
    episodes = {
        title: play_episode(saved.policy, mdp, start, model, arguments.seconds) for title, model in models.items()
    }
    if arguments.viewer:
        _show(task.scene_path, episodes["real"])
        return
    from cmbrl.envs.clip import write_clip

    frames = write_clip(arguments.out, task.scene_path, episodes)
    told = (f"{title} return {e.returns[-1]:.4g} in {(len(e.q) - 1) * e.dt:.2f} s" for title, e in episodes.items())
    print(f"{arguments.out}: {frames} frames: {', '.join(told)}")


def _show(scene: str, episode: Any) -> None:
    """The episode in a window, again and again in real time, until it is closed."""
    import mujoco
    import mujoco.viewer

    model = mujoco.MjModel.from_xml_path(scene)
    data = mujoco.MjData(model)
    with mujoco.viewer.launch_passive(model, data) as window:
        while window.is_running():
            for q in episode.q:
                data.qpos[:] = q
                mujoco.mj_forward(model, data)
                window.sync()
                time.sleep(episode.dt)
                if not window.is_running():
                    break
