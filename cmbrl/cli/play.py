"""``cmbrl play``: a clip of a policy in the real system and in a model, side by side; or MuJoCo's viewer."""

from __future__ import annotations

import argparse
import time
from typing import Any

from cmbrl.cli.argument_types import positive_number
from cmbrl.cli.options import MODEL_HELP, add_seed, add_smoothing
from cmbrl.errors import UserError
from cmbrl.files import check_writable

EXAMPLE = """
cmbrl play runs/policy --out policy.mp4
cmbrl play runs/policy --out policy.gif --seconds 4 --seed 3
cmbrl play runs/policy --task hopper@payload:3 --out hidden.mp4   # in another real system
cmbrl play runs/policy --viewer
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("policy", metavar="POLICY", help="the folder of a policy: a `cmbrl train` run")
    parser.add_argument("--out", metavar="FILE", help="the clip to write: NAME.mp4 or NAME.gif")
    parser.add_argument("--viewer", action="store_true", help="show the real system in MuJoCo's viewer instead")
    parser.add_argument("--model", metavar="M", help=f"next to the real system: {MODEL_HELP} (default: as trained)")
    parser.add_argument(
        "--task",
        metavar="TASK",
        help="show it in this task, whose real system is another one of the same robot, as hopper@payload:3 or a file",
    )
    parser.add_argument(
        "--seconds", type=positive_number, default=10.0, metavar="S", help="length of the clip, at most (default 10)"
    )
    add_smoothing(parser)
    add_seed(parser)


def run(arguments: argparse.Namespace) -> None:
    from cmbrl.envs.renderer import choose_renderer, has_display

    if bool(arguments.out) == arguments.viewer:
        raise UserError("give either --out FILE or --viewer")
    if arguments.viewer and not has_display():
        raise UserError("--viewer: there is no display to open a window on; make a clip with --out FILE.mp4")
    if arguments.out:
        choose_renderer()  # before anything imports mujoco, as the next lines do

    from cmbrl.envs.clip import check_clip_path
    from cmbrl.envs.of_task import real_system
    from cmbrl.train.models import REAL, check_model, load_model
    from cmbrl.train.policies.saved import Trained

    if arguments.model == REAL:
        raise UserError("--model real: `real` is not a model, and is always shown; name a model or drop --model")
    trained = Trained.load(arguments.policy, arguments.task)
    policy, task, mdp = trained.saved.policy, trained.task, trained.mdp
    if arguments.model is not None:
        check_model(arguments.model)
    if arguments.out:
        check_clip_path(arguments.out)
        check_writable(arguments.out)

    import numpy as np
    import torch

    from cmbrl.envs.episode import Episode, play_episode
    from cmbrl.envs.system_batch import SystemBatch

    start = mdp.reset(1, torch.Generator().manual_seed(arguments.seed))
    models: dict[str, Any] = {"real": SystemBatch(real_system(task), 1)}
    word = None if arguments.viewer else arguments.model or trained.usual_model()
    if word is not None:
        models["model"] = load_model(word, task, arguments.smoothing)
    episodes = {title: play_episode(policy, mdp, start, model, arguments.seconds) for title, model in models.items()}
    if task.reference is not None:
        wanted = task.reference()[: max(len(e.q) for e in episodes.values())]
        episodes = {"reference": Episode(wanted, np.zeros(len(wanted)), task.control_dt, False), **episodes}
    if arguments.viewer:
        _show(task.scene_path, episodes["real"])
        return
    from cmbrl.envs.clip import write_clip

    frames = write_clip(arguments.out, task.scene_path, episodes)
    played = {title: e for title, e in episodes.items() if title in models}
    told = (f"{title} return {e.returns[-1]:.4g} in {(len(e.q) - 1) * e.dt:.2f} s" for title, e in played.items())
    print(f"{arguments.out}: {frames} frames: {', '.join(told)}")


def _show(scene: str, episode: Any) -> None:
    """Repeats the episode in a window, in real time, until the window is closed."""
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
