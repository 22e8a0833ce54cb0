"""The command line from end to end, small: info, record, fit, error, as a user types them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from matplotlib.image import imread

from cmbrl.accuracy.named_models import train_ensemble
from cmbrl.cli.argument_types import assignment, seed
from cmbrl.cli.main import COMMANDS, main
from cmbrl.cli.parser import Parser, resolved
from cmbrl.errors import UserError
from cmbrl.models.neural.ensemble import NeuralEnsemble

CONFIGS = Path(__file__).parent.parent / "configs"
# Packages of the extras, as they are imported.
OPTIONAL = [
    "gymnasium",
    "pymunk",
    "cmaes",
    "minari",
    "h5py",
    "pyarrow",
    "rosbags",
    "stable_baselines3",
    "sb3_contrib",
    "tensorboard",
    "imageio",
]
OPTIONAL += [
    "imageio_ffmpeg",
    "onnx",
    "onnxscript",
    "onnxruntime",
    "sklearn",
    "qpsolvers",
    "proxsuite",
    "daqp",
]
OPTIONAL += [
    "quadprog",
    "piqp",
    "osqp",
    "clarabel",
    "scs",
    "highspy",
    "cvxpy",
    "cvxpylayers",
    "pinocchio",
    "ray",
    "dask",
]
FIT = ["fit", "hopper", "--data", "log.npz", "--groups", "friction", "--method", "gauss-newton"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small log of the hopper."""
    folder = tmp_path_factory.mktemp("cli")
    assert main(["record", "hopper", "--steps", "120", "--out", str(folder / "log.npz")]) == 0
    return folder


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert stopped.value.code == 0
    shown = capsys.readouterr().out
    assert "examples:" in shown
    assert f"cmbrl {name} " in shown.split("examples:")[1]


def test_overview_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    overview = capsys.readouterr().out
    assert all(f"  {name}" in overview for name in COMMANDS)
    with pytest.raises(SystemExit) as stopped:
        main(["--version"])
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith("cmbrl ")


@pytest.mark.parametrize(
    ("typed", "code"), [("info nope 2>&-", 2), ("--version >&-", 0), ("--version <&- >&- 2>&-", 0)]
)
def test_streams_that_are_closed_lead_nowhere(typed: str, code: int) -> None:
    ended = subprocess.run(["sh", "-c", f"{sys.executable} -m cmbrl {typed}"], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "")


def test_a_folder_that_was_removed_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(["info", "hopper"]) == 2
    assert "the folder that you are in has been removed" in capsys.readouterr().err


def test_help_does_not_wait_for_torch(command) -> None:
    code = "import sys, cmbrl.cli; cmbrl.cli.main(['fit', '--help'])"
    done = subprocess.run([sys.executable, "-X", "importtime", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0
    assert not any(line.split("|")[-1].strip() == "torch" for line in done.stderr.splitlines() if "|" in line)


def test_info_says_the_same_as_text_and_as_json(command) -> None:
    text = command("info", "hopper")
    assert text.returncode == 0, text.stderr
    known = json.loads(command("info", "hopper", "--json").stdout)
    assert (known["nq"], known["nv"], known["nu"]) == (6, 6, 3)
    rows = text.stdout.split("GROUP ")[1].replace(",", "").split()
    assert all(set(parameter["name"].split(".")) <= set(rows) for parameter in known["parameters"])
    assert len(text.stdout.splitlines()) < 70  # 77 parameters, folded
    assert "planar" in text.stdout


def test_record_is_repeatable_and_says_what_it_wrote(command, tmp_path: Path) -> None:
    options = ["record", "hopper", "--steps", 40, "--seed", 3]
    first = command(*options, "--out", "new/a.npz", "--json")
    assert first.returncode == 0, first.stderr
    assert first.stderr == ""  # no progress bar outside a terminal
    assert json.loads(first.stdout)["transitions"] == 40
    assert "40 transitions" in command(*options, "--out", "new/b.npz").stdout
    assert (tmp_path / "new/a.npz").read_bytes() == (tmp_path / "new/b.npz").read_bytes()


def test_fit_writes_a_run_folder_that_repeats_and_compares(
    command, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = command(*FIT, "--out", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    assert "friction.foot_geom" in done.stdout
    names = {entry.name for entry in (place / "run").iterdir()}
    assert {"config.json", "environment.json", "fit.json", "model.json", "report.txt"} <= names
    assert json.loads((place / "run/environment.json").read_text())["versions"]["cmbrl"]

    monkeypatch.chdir(place)  # what follows needs no process of its own
    capsys.readouterr()
    assert main(["fit", "--config", "run/config.json", "--out", "again", "--json", "--threads", "1"]) == 0
    parameters = json.loads((place / "run/fit.json").read_text())["parameters"]
    assert json.loads(capsys.readouterr().out)["parameters"] == parameters  # any number of threads

    assert main([*FIT, "--out", "run"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "--resume" in told
    assert main([*FIT, "--out", "run", "--resume"]) == 0
    assert json.loads((place / "run/fit.json").read_text())["parameters"] == parameters

    capsys.readouterr()
    compared = ["error", "--data", "log.npz", "hold", "nominal", "run", "--horizons", "1", "5", "--out", "error"]
    assert main(compared) == 0
    table = capsys.readouterr().out
    assert all(model in table for model in ("hold", "nominal", "run"))
    assert {entry["model"] for entry in json.loads((place / "error/error.json").read_text())["entries"]} >= {
        "hold",
        "run",
    }
    assert len(np.unique(imread(place / "error/error.png").reshape(-1, 4), axis=0)) > 20  # lines and bars, not a blank


def test_a_folder_of_the_same_name_hides_no_task(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hopper").mkdir()
    assert main(["info", "hopper"]) == 0
    assert "torso" in capsys.readouterr().out


@pytest.mark.parametrize("file", sorted(CONFIGS.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_configuration_is_understood(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In an empty folder: up to the log of a fit, the model of a policy, or the run to resume."""
    monkeypatch.chdir(tmp_path)
    settings = yaml.safe_load(file.read_text())
    stopped = {
        "fit": [f"runs/{file.stem}/train.npz: no such file"],
        "train": [
            f"'{settings.get('model')}' is neither a model nor a folder",
            f"runs/{file.stem}: no `cmbrl train` run to resume here",
        ],
    }[settings["command"]]
    options = ["--resume"] if settings["command"] == "train" else []
    assert main([settings["command"], "--config", str(file), *options]) == 2
    shown = capsys.readouterr().err
    assert any(line in shown for line in stopped), shown


def test_a_configuration_keeps_every_value_of_a_list(
    tmp_path: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lists, positional lists and mappings from a file; typed options replace or, where repeatable, add to them."""
    monkeypatch.chdir(place)
    file = tmp_path / "error.yaml"
    file.write_text(f"data: log.npz\nscene: hopper\nmodels: [hold, ballistic]\nhorizons: [1, 5]\nout: {tmp_path}/a\n")
    assert main(["error", "--config", str(file)]) == 0
    entries = json.loads((tmp_path / "a/error.json").read_text())["entries"]
    assert {(entry["model"], entry["horizon"]) for entry in entries} == {
        (model, horizon) for model in ("hold", "ballistic") for horizon in (1, 5)
    }
    typed = ["nominal", "--config", str(file), "--horizons", "2", "--out", str(tmp_path / "b")]
    assert main(["error", *typed]) == 0
    held = json.loads((tmp_path / "b/config.json").read_text())
    assert (held["models"], held["horizons"], held["data"]) == (["nominal"], [2], ["log.npz"])


def test_a_configuration_is_the_default_of_every_kind_of_option(tmp_path: Path) -> None:
    parser = Parser("cmbrl toy", "", "")
    parser.add_argument("task")
    parser.add_argument("--set", action="append", default=[], type=assignment)
    parser.add_argument("--groups", action="append")
    parser.add_argument("--seed", type=seed, default=0)
    parser.add_argument("--law", choices=("hard", "soft"))
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--out", required=True)
    parser.add_config()
    file = tmp_path / "toy.json"
    file.write_text(
        '{"task": "a", "set": {"x": 1, "y": [2, 3]}, "groups": ["g"], "seed": 4, "law": "soft", "fast": true,'
        ' "out": "o"}'
    )
    given = parser.parse(["--config", str(file), "--set", "x=5", "--groups", "h", "--seed", "6"])
    assert resolved(given) == {
        "task": "a", "set": {"x": "5", "y": "2,3"}, "groups": ["g", "h"], "seed": 6, "law": "soft", "fast": True,
        "out": "o",
    }  # fmt: skip


@pytest.mark.parametrize("name", [*sorted(COMMANDS), ""])
def test_help_needs_no_optional_package_and_fits_a_terminal(name: str) -> None:
    """As after `pip install .`: every package of an extra is missing. Also in a terminal wider than 100 columns."""
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL}));"  # None: as if it were not installed
        f"from cmbrl.cli import main; main({[name, '--help'] if name else ['--help']})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | {"COLUMNS": "200"}
    )
    assert done.returncode == 0, done.stderr
    assert f"usage: cmbrl {name}".rstrip() in done.stdout
    assert [line for line in done.stdout.splitlines() if len(line) > 100] == []


@pytest.mark.parametrize(
    ("typed", "missing"),
    [
        ("info hopper", "tasks"),
        ("record ball_throw --steps 5 --out new.npz", "tasks"),
        ("record ball_throw --steps 5 --out minari:a/b-v0", "data"),
        ("train ball_throw --algorithm ppo --out new", "train"),
    ],
)
def test_a_missing_package_is_one_line(typed: str, missing: str, tmp_path: Path) -> None:
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL}));"
        f"from cmbrl.cli import main; sys.exit(main({typed.split()}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"pip install 'cmbrl[{missing}]'" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("typed", ["info hopper", "info cheetah", "info ball_throw", "fit hopper"])
def test_output_fits_a_terminal(
    typed: str, place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    options = [*FIT[2:], "--out", "narrow"] if typed == "fit hopper" else []
    assert main([*typed.split(), *options]) == 0
    wide = [line for line in capsys.readouterr().out.splitlines() if len(line) > 100]
    assert [line for line in wide if not line.endswith(".xml")] == []  # a path is as long as it is


def test_an_ensemble_that_fails_leaves_torch_as_it_was() -> None:
    class Failing(NeuralEnsemble):
        def __init__(self) -> None:
            pass

        def fit(self, *_: object, **__: object) -> None:  # type: ignore[override]
            assert torch.get_num_threads() == 1
            raise UserError("too short")

    torch.set_num_threads(2)
    try:
        with pytest.raises(UserError, match="too short"):
            train_ensemble(Failing(), None)  # type: ignore[arg-type]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)


def test_start_values_are_taken_from_the_command_line(command, place: Path) -> None:
    done = command(*FIT, "--out", "started", "--set", "mass.torso=1.3", "--json", cwd=place)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["parameters"]["mass.torso"]["value"] == 1.3
    assert found["report"]["set"] == ["mass.torso"]


def test_ctrl_c_leaves_the_best_so_far(place: Path) -> None:
    # The selection among all groups over several steps: long enough that the signal comes before the end.
    options = ["fit", "hopper", "--data", "log.npz", "--horizon", "4", "--out", "interrupted"]
    running = subprocess.Popen(
        [sys.executable, "-m", "cmbrl", *options], cwd=place, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    state = place / "interrupted/state.json"
    while not (state.exists() and '"begin"' in state.read_text()):  # until then, the log is checked
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    shown, complaint = running.communicate(timeout=60)
    assert running.returncode == 130
    assert complaint.splitlines()[-1].startswith("cmbrl: interrupted: the best fit so far is in interrupted")
    assert "STOPPED EARLY" in shown
    assert json.loads((place / "interrupted/fit.json").read_text())["report"]["stopped"] == "interrupted"


def test_ctrl_c_during_the_checks_names_the_way_on(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def checking(*arguments: object, folder: Path, **options: object) -> None:
        (folder / "state.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr("cmbrl.fitting.fit_or_played", checking)
    monkeypatch.chdir(place)
    assert main(["fit", "hopper", "--data", "log.npz", "--out", "checking"]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "cmbrl: interrupted: continue with --resume"


def test_a_python_user_has_the_same_names() -> None:
    import cmbrl

    assert all(hasattr(cmbrl, name) for name in cmbrl.__all__)
    assert set(cmbrl.__all__) <= set(dir(cmbrl))
    with pytest.raises(AttributeError, match="nothing_like_it"):
        cmbrl.nothing_like_it  # noqa: B018
