"""train, evaluate, play, export from end to end, small; and their mistakes: one line, exit code 2, nothing written."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from cmbrl import registry
from cmbrl.cli.main import main
from cmbrl.data.transitions import Transitions
from cmbrl.envs.episode import play_episode
from cmbrl.envs.evaluation import evaluate_model, evaluate_real
from cmbrl.envs.system_batch import SystemBatch
from cmbrl.models.neural.ensemble import EnsembleConfig, NeuralEnsemble
from cmbrl.registry import load_task
from cmbrl.system import MujocoSystem
from cmbrl.train.policies.file import load_policy, save_policy
from cmbrl.train.policies.policy import Architecture, Policy
from cmbrl.train.running.checkpoint import load_state

from .conftest import Refused

SMALL = ["--set", "environments=4", "--set", "horizon=4", "--threads", "1"]
TRAIN = ["train", "hopper", "--algorithm", "shac", *SMALL]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of SHAC, and one that holds an ensemble."""
    folder = tmp_path_factory.mktemp("train")
    assert main([*TRAIN, "--iterations", "4", "--out", str(folder / "run")]) == 0
    scene = load_task("hopper").load_scene()
    NeuralEnsemble(scene, 0.008, EnsembleConfig(nets=2, elites=1, width=8)).save(folder / "ensemble")
    NeuralEnsemble(scene, 0.02, EnsembleConfig(nets=2, elites=1, width=8)).save(folder / "slow_ensemble")
    cheetah = load_task("cheetah")
    NeuralEnsemble(cheetah.load_scene(), 0.008, EnsembleConfig(nets=2, elites=1)).save(folder / "cheetah_ensemble")
    (folder / "other_run").mkdir()
    (folder / "other_run/config.json").write_text('{"command": "fit"}')
    (folder / "empty").mkdir()
    load_task("hopper").record(5, seed=0).save(folder / "hopper.npz")
    save_policy(Policy(Architecture(11, 3, (4,))), folder / "of_no_task", {"task": "cube_toss"})
    save_policy(Policy(Architecture(17, 6, (4,))), folder / "of_cheetah", {"task": "hopper"})
    spoiled = Policy(Architecture(11, 3, (4,)))
    with torch.no_grad():
        spoiled.net[0].weight.fill_(float("nan"))
    save_policy(spoiled, folder / "spoiled", {"task": "hopper"})
    return folder


def weights(folder: Path) -> dict[str, bytes]:
    return {name: value.numpy().tobytes() for name, value in load_policy(folder).policy.state_dict().items()}


def test_a_run_folder_holds_all_of_a_run(place: Path) -> None:
    run = place / "run"
    names = {path.name for path in run.iterdir()}
    assert names >= {"config.json", "environment.json", "metrics.csv", "metrics.png", "checkpoint.safetensors",
                     "policy.json", "policy.safetensors", "train.json"}  # fmt: skip
    assert any(name.startswith("events.out.tfevents") for name in names)
    assert json.loads((run / "config.json").read_text())["model"] == "nominal"
    assert len((run / "metrics.csv").read_text().splitlines()) == 5
    assert load_state(run / "checkpoint.safetensors")["iteration"] == 4


def test_killed_and_resumed_from_its_own_configuration(place: Path, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "cmbrl", *TRAIN, "--iterations", "4", "--out", "run", "--checkpoint-seconds", "1e-6"],
        cwd=tmp_path,
    )
    while not (tmp_path / "run/metrics.csv").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    config = tmp_path / "run/config.json"
    out = ["--out", str(tmp_path / "run")]
    assert main(["train", "--config", str(config), *out, "--resume"]) == 0
    assert weights(tmp_path / "run") == weights(place / "run")


def test_a_finished_run_continues_with_more_iterations(tmp_path: Path) -> None:
    """Also when no algorithm was named: the configuration has the one that was chosen."""
    run, typed = tmp_path / "run", ["train", "hopper", "--model", "nominal", *SMALL]
    assert main([*typed, "--iterations", "2", "--out", str(run)]) == 0
    assert json.loads((run / "config.json").read_text())["algorithm"] == "shac"
    assert main([*typed, "--iterations", "3", "--out", str(run), "--resume", "--json"]) == 0
    assert main(["train", "--config", str(run / "config.json"), "--iterations", "4", "--resume"]) == 0
    assert len((run / "metrics.csv").read_text().splitlines()) == 5


def test_a_run_goes_on_from_another_ones_policy(place: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert main([*TRAIN, "--iterations", "2", "--start", str(place / "run"), "--out", str(run)]) == 0
    assert load_policy(run).about["start"] == str(place / "run")
    assert main(["train", "--config", str(run / "config.json"), "--iterations", "3", "--resume"]) == 0


def test_a_run_that_diverges_says_so_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    assert main([*TRAIN, "--set", "actor_rate=1e9", "--iterations", "30", "--out", str(run)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert "diverged.npz" in lines[-1]
    assert not [line for line in lines[:-1] if not line.startswith("train hopper:")]  # of progress
    with np.load(run / "diverged.npz") as states:
        assert states["q"].shape == (4, 6)
    assert json.loads((run / "train.json").read_text())["stopped"] == "diverged"


def test_evaluate_shows_the_gap_in_numbers_that_python_gives(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(place / "run"), "--episodes", "2", "--seed", "5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["in"]
    task = load_task("hopper")
    assert task.mdp is not None
    assert task.system is not None
    policy = load_policy(place / "run").policy
    real = evaluate_real(policy, task.mdp(), task.system, 2, seed=5)
    assert found["real"]["returns"] == real.returns.tolist()
    assert found["real"]["lengths"] == real.lengths.tolist()
    assert set(found) == {"real", "nominal"}
    assert main(["evaluate", str(place / "run"), "--model", str(place / "ensemble"), "--real", "--episodes", "2"]) == 0
    shown = capsys.readouterr().out
    assert "real - model: " in shown
    assert all(len(line) <= 100 for line in shown.splitlines())
    assert main(["evaluate", str(place / "run"), "--real", "--episodes", "1"]) == 0
    assert "model" not in capsys.readouterr().out


def test_a_policy_is_judged_in_another_real_system_of_its_robot(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    returns = {}
    for task in ("hopper", "hopper@payload:3"):
        given = [] if task == "hopper" else ["--task", task]
        assert main(["evaluate", str(place / "run"), *given, "--real", "--episodes", "2", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["task"] == task
        returns[task] = found["in"]["real"]["returns"]
    process, policy = load_task("hopper").mdp, load_policy(place / "run").policy
    hidden = load_task("hopper@payload:3").system
    assert process is not None
    assert hidden is not None
    assert returns["hopper@payload:3"] == evaluate_real(policy, process(), hidden, 2, seed=0).returns.tolist()
    assert returns["hopper@payload:3"] != returns["hopper"]


def test_an_episode_that_is_played_is_the_one_that_is_evaluated(place: Path) -> None:
    task = load_task("hopper")
    assert task.mdp is not None
    assert task.system is not None
    mdp, policy = task.mdp(), load_policy(place / "run").policy
    from cmbrl.train.models import load_model

    model = load_model("nominal", task, threads=1)
    for moved_by, evaluated in (
        (SystemBatch(task.system, 1), evaluate_real(policy, mdp, task.system, 1, seed=2, keep=True)),
        (model, evaluate_model(policy, mdp, model, 1, seed=2)),
    ):
        start = mdp.reset(1, torch.Generator().manual_seed(2))
        episode = play_episode(policy, mdp, start, moved_by, seconds=100.0)
        assert len(episode.q) == evaluated.lengths[0] + 1
        assert episode.terminated
        np.testing.assert_allclose(episode.returns[-1], evaluated.returns[0], rtol=1e-12)
        if evaluated.q:
            np.testing.assert_array_equal(episode.q, evaluated.q[0])


@pytest.mark.parametrize("suffix", [pytest.param("mp4", marks=pytest.mark.slow), "gif"])
def test_a_clip_shows_both_side_by_side(suffix: str, place: Path, command, tmp_path: Path) -> None:
    done = command("play", place / "run", "--out", f"clip.{suffix}", "--seconds", "0.2")
    assert done.returncode == 0, done.stderr
    frames = _frames(tmp_path / f"clip.{suffix}")
    assert len(frames) == int(done.stdout.split(": ")[1].split()[0])
    assert frames[0].shape == (384, 960, 3)
    assert np.ptp(frames[0][30:, :480]) > 50  # something is drawn on the left
    assert np.ptp(frames[0][30:, 480:]) > 50  # and on the right
    same = np.abs(frames[0][30:, :480].astype(float) - frames[0][30:, 480:]).mean()
    assert same < 3.0  # the start is the same


def _frames(path: Path) -> list[np.ndarray]:
    if path.suffix == ".gif":
        with Image.open(path) as clip:
            found = []
            for k in range(clip.n_frames):
                clip.seek(k)
                found.append(np.asarray(clip.convert("RGB")))
            return found
    imageio = pytest.importorskip("imageio.v3")
    return list(imageio.imread(path, plugin="FFMPEG"))


def test_what_cannot_draw_says_what_to_install(place: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "cmbrl", "play", str(place / "run"), "--out", "clip.gif"],
        cwd=tmp_path, capture_output=True, text=True, env={**_environment(), "MUJOCO_GL": "glx"},
    )  # fmt: skip
    assert done.returncode == 2
    assert "apt-get install libegl1" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_renderer_is_chosen_before_mujoco_is_imported(place: Path, tmp_path: Path) -> None:
    """mujoco reads MUJOCO_GL when it is imported: a choice that comes later has no effect."""
    asked = (
        "import sys\nfrom cmbrl.cli import main\nfrom cmbrl.envs import renderer\n"
        "renderer.choose_renderer = lambda: sys.exit(4 if 'mujoco' in sys.modules else 3)\n"
        f"main(['play', {str(place / 'run')!r}, '--out', 'clip.gif'])"
    )
    done = subprocess.run([sys.executable, "-c", asked], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 3, done.stderr


def _environment() -> dict[str, str]:
    import os

    return {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


def test_an_exported_policy_records(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script, log = tmp_path / "policy.pt", tmp_path / "log.npz"
    assert main(["export", str(place / "run"), "--torchscript", str(script)]) == 0
    assert main(["record", "hopper", "--steps", "20", "--policy", str(script), "--out", str(log)]) == 0
    data = Transitions.load(log)
    task = load_task("hopper")
    assert task.mdp is not None
    observed = task.mdp().observe(torch.from_numpy(data.q), torch.from_numpy(data.v)).float()
    expected = load_policy(place / "run").policy(observed).detach().numpy()
    np.testing.assert_allclose(data.u, expected, rtol=0, atol=1e-6)
    capsys.readouterr()
    assert main(["record", "cheetah", "--steps", "5", "--policy", str(script), "--out", str(tmp_path / "no.npz")]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith(f"cmbrl: {script}: the policy fails on 17 observations")
    assert shown.count("\n") == 1


def test_a_real_system_of_another_step_is_told_before_a_training(
    tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    hopper = load_task("hopper")
    skipping = replace(hopper, name="skipping", system=lambda: MujocoSystem(hopper.scene_path, frame_skip=2))
    monkeypatch.setitem(registry._registered, "skipping", skipping)
    typed = "train skipping --algorithm shac --model nominal --out new"
    refused(tmp_path, typed, "'skipping': a step of Task.system takes 0.004 s", "0.008 s: fix its frame_skip")


NEW = "train hopper --out new --iterations 1"
# What the user types -> what the line must tell: the place, and where there is one, the remedy.
MISTAKES = {
    "unknown algorithm": (f"{NEW} --algorithm shaq", "unknown algorithm 'shaq'", "did you mean 'shac'"),
    "robot for a task": (
        "train arm.xml --algorithm shac --out new",
        "arm.xml: a robot",
        "Python file that defines TASK",
    ),
    "unknown task": ("train hoper --algorithm shac --out new", "'hoper'", "did you mean 'hopper'"),
    "task without reward": ("train cube_toss --algorithm shac --out new", "cube_toss", "hopper"),
    "no such model": (f"{NEW} --algorithm shac --model nominla", "nominla", "did you mean 'nominal'"),
    "folder without model": (f"{NEW} --algorithm shac --model empty", "empty", "model.json"),
    "model of another robot": (f"{NEW} --algorithm shac --model cheetah_ensemble", "cheetah_ensemble", "another robot"),
    "model of another step": (f"{NEW} --algorithm shac --model slow_ensemble", "0.02", "0.008"),
    "real for a gradient": (f"{NEW} --algorithm shac --model real", "real", "contact model"),
    "smoothing of an ensemble": (f"{NEW} --algorithm shac --model ensemble_x --smoothing exact", "ensemble_x", ""),
    "softening an ensemble": (
        f"{NEW} --algorithm shac --model ./ensemble --smoothing exact",
        "./ensemble",
        "drop it",
    ),
    "unknown smoothing": (f"{NEW} --algorithm shac --smoothing soft", "'soft'", "barrier:kappa=1e-4"),
    "no iterations": ("train hopper --algorithm shac --out new --iterations 0", "--iterations", "below 1"),
    "unknown hyperparameter": (
        f"{NEW} --algorithm shac --set horzon=3",
        "shac: no setting 'horzon'",
        "did you mean 'horizon'",
    ),
    "hyperparameter is NaN": (f"{NEW} --algorithm shac --set discount=nan", "discount", "number"),
    "hyperparameter out of its bounds": (f"{NEW} --algorithm shac --set environments=0", "environments", "at least 1"),
    "squashed by nothing known": (f"{NEW} --algorithm fopg --set squash=tan", "squash", "did you mean 'tanh'"),
    "discount of 1": (f"{NEW} --algorithm shac --set discount=1", "discount", "below 1"),
    "refused by the library": (f"{NEW} --algorithm ppo --set batch=1", "PPO", "batch_size"),
    "unknown derivative": (f"{NEW} --algorithm shac --derivative gausian", "gausian", "did you mean 'gaussian'"),
    "softness without its name": (
        f"{NEW} --algorithm shac --smoothing barrier=1e-4",
        "'barrier=1e-4'",
        "barrier:kappa",
    ),
    "softness without a value": (f"{NEW} --algorithm shac --smoothing barrier:kappa", "'kappa'", "barrier:kappa=1e-4"),
    "gaussian without a length": (f"{NEW} --algorithm shac --smoothing gaussian", "length", "gaussian:length=1e-3"),
    "softer than anything": (f"{NEW} --algorithm shac --derivative barrier:kappa=1e300", "kappa", "at most"),
    "simulated softer than anything": (f"{NEW} --algorithm shac --smoothing barrier:kappa=1e300", "kappa", "at most"),
    "epochs without end": (f"{NEW} --algorithm shac --set critic_epochs=1e300", "critic_epochs", "at most 2147483648"),
    "seed of 5,000 digits": (f"{NEW} --algorithm shac --seed {'9' * 5000}", "--seed", "whole number"),
    "half a sample": (f"{NEW} --algorithm shac --derivative bundle:samples=2.5", "samples = 2.5", "whole number"),
    "derivative without contacts": (f"{NEW} --algorithm sac --derivative exact", "--derivative", "drop it"),
    "a bundle that is to be fitted": (f"{NEW} --algorithm loop --derivative bundle", "bundle", "gaussian"),
    "seed beyond all generators": (f"{NEW} --algorithm shac --seed 99999999999", "--seed", "is above"),
    "threads without end": (f"{NEW} --algorithm shac --threads 9999", "--threads", "above 256"),
    "a log that is not used": (f"{NEW} --algorithm shac --data log.npz", "--data", "fit"),
    "offline without a log": (f"{NEW} --algorithm loop --offline", "--offline", "--data"),
    "offline without acting": (f"{NEW} --algorithm loop --offline --data hopper.npz", "--offline", "shac"),
    "missing log": (f"{NEW} --algorithm loop --data log.npz", "log.npz", "no such file"),
    "folder of another command": ("train hopper --algorithm shac --out other_run", "other_run", "another --out"),
    "folder holds a run": ("train hopper --algorithm shac --out run", "run", "--resume"),
    "nothing to resume": (f"{NEW} --algorithm shac --resume", "no `cmbrl train` run to resume", "drop --resume"),
    "resumed with other options": (f"{' '.join(TRAIN)} --out run --resume --seed 1", "seed 0", "another --out"),
    "start without a policy": (f"{NEW} --algorithm shac --start empty", "policy.json", "cmbrl train"),
    "start of another robot": (f"{NEW} --algorithm shac --start of_cheetah", "17 observations", "same task"),
    "start of a loop": (f"{NEW} --algorithm loop --start run", "--start", "shac or fopg"),
    "not a policy": ("evaluate empty", "policy.json", "cmbrl train"),
    "policy with NaN": ("evaluate spoiled", "spoiled", "not finite"),
    "policy of a task without reward": ("evaluate of_no_task", "cube_toss", ""),
    "policy of another robot": ("evaluate of_cheetah", "17 observations", "train again"),
    "judged on another robot": ("evaluate run --task cheetah", "--task cheetah", "name a task of that robot"),
    "judged in no task": ("evaluate run --task hoper", "'hoper'", "did you mean 'hopper'"),
    "played on a task of another robot": ("play run --task cheetah --out clip.gif", "--task cheetah", "of that robot"),
    "played on another robot": ("play of_cheetah --out clip.gif", "17 observations", "train again"),
    "evaluated in the real system as a model": ("evaluate run --model real", "`real` is not a model", "use --real"),
    "evaluated in an unknown model": ("evaluate run --model nominla", "nominla", "nominal"),
    "no policy to play": ("play empty --out clip.gif", "policy.json", ""),
    "no clip format": ("play run --out clip.avi", "clip.avi", ".mp4"),
    "neither clip nor viewer": ("play run", "--out", "--viewer"),
    "both clip and viewer": ("play run --out clip.gif --viewer", "--out", "--viewer"),
    "viewer without a display": ("play run --viewer", "no display", "--out"),
    "nothing to export": ("export run", "--onnx", "--torchscript"),
    "export over a folder": ("export run --onnx empty", "empty", "folder"),
}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_one_line_exit_2_nothing_written(
    mistake: str, place: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    refused(place, *MISTAKES[mistake])
