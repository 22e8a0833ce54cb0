"""The command line from end to end, small: info, record, fit, error, as a user types them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from cmbrl.cli.main import COMMANDS, main

CONFIGS = Path(__file__).parent.parent / "configs"
FIT = ["fit", "hopper", "--data", "log.npz", "--groups", "friction", "--method", "gauss-newton"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small log of the hopper."""
    folder = tmp_path_factory.mktemp("cli")
    assert main(["record", "hopper", "--steps", "300", "--out", str(folder / "log.npz")]) == 0
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
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("cmbrl ")


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
    assert all(parameter["name"] in text.stdout for parameter in known["parameters"])
    assert "planar" in text.stdout


def test_record_is_repeatable_and_says_what_it_wrote(command, tmp_path: Path) -> None:
    options = ["record", "hopper", "--steps", 40, "--seed", 3]
    first = command(*options, "--out", "new/a.npz", "--json")
    assert first.returncode == 0, first.stderr
    assert first.stderr == ""  # no progress bar outside a terminal
    assert json.loads(first.stdout)["transitions"] == 40
    assert "40 transitions" in command(*options, "--out", "new/b.npz").stdout
    assert (tmp_path / "new/a.npz").read_bytes() == (tmp_path / "new/b.npz").read_bytes()


def test_fit_writes_a_run_folder_that_repeats_and_compares(command, place: Path) -> None:
    done = command(*FIT, "--out", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    assert "friction.foot_geom" in done.stdout
    names = {entry.name for entry in (place / "run").iterdir()}
    assert {"config.json", "environment.json", "fit.json", "model.json", "report.txt"} <= names
    assert json.loads((place / "run/environment.json").read_text())["versions"]["cmbrl"]

    again = command("fit", "--config", "run/config.json", "--out", "again", "--json", "--threads", 1, cwd=place)
    assert again.returncode == 0, again.stderr
    parameters = json.loads((place / "run/fit.json").read_text())["parameters"]
    assert json.loads(again.stdout)["parameters"] == parameters  # any number of threads

    other = command(*FIT, "--out", "run", cwd=place)
    assert (other.returncode, other.stderr.count("\n")) == (2, 1)
    assert "--resume" in other.stderr
    resumed = command(*FIT, "--out", "run", "--resume", cwd=place)
    assert resumed.returncode == 0, resumed.stderr
    assert json.loads((place / "run/fit.json").read_text())["parameters"] == parameters

    table = command(
        "error", "--data", "log.npz", "hold", "nominal", "run", "--horizons", 1, 5, "--out", "error", cwd=place
    )
    assert table.returncode == 0, table.stderr
    assert all(model in table.stdout for model in ("hold", "nominal", "run"))
    assert {entry["model"] for entry in json.loads((place / "error/error.json").read_text())["entries"]} >= {
        "hold",
        "run",
    }
    assert (place / "error/error.png").stat().st_size > 0


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
    """In an empty folder: up to the log of a fit, the model of a policy, or the run that is to be gone on with."""
    monkeypatch.chdir(tmp_path)
    settings = yaml.safe_load(file.read_text())
    stopped = {
        "fit": [f"runs/{file.stem}/train.npz: no such file"],
        "train": [f"no model '{settings.get('model')}'", f"runs/{file.stem}: holds no run to go on with"],
    }[settings["command"]]
    options = ["--resume"] if settings["command"] == "train" else []
    assert main([settings["command"], "--config", str(file), *options]) == 2
    shown = capsys.readouterr().err
    assert any(line in shown for line in stopped), shown


def test_start_values_are_taken_from_the_command_line(command, place: Path) -> None:
    done = command(*FIT, "--out", "started", "--set", "mass.torso=1.3", "--json", cwd=place)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["parameters"]["mass.torso"]["value"] == 1.3


def test_ctrl_c_leaves_the_best_so_far(place: Path) -> None:
    # The selection among all groups over several steps: long enough that the signal comes before the end.
    options = ["fit", "hopper", "--data", "log.npz", "--horizon", "4", "--out", "interrupted"]
    running = subprocess.Popen(
        [sys.executable, "-m", "cmbrl", *options], cwd=place, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    while not (place / "interrupted/state.json").exists():
        assert running.poll() is None, running.communicate()
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    shown, complaint = running.communicate(timeout=60)
    assert running.returncode == 130
    assert complaint.splitlines()[-1].startswith("cmbrl: interrupted")
    assert "STOPPED EARLY" in shown
    assert json.loads((place / "interrupted/fit.json").read_text())["report"]["stopped"] == "interrupted"


def test_a_python_user_has_the_same_names() -> None:
    import cmbrl

    assert all(hasattr(cmbrl, name) for name in cmbrl.__all__)
    assert set(cmbrl.__all__) <= set(dir(cmbrl))
    with pytest.raises(AttributeError, match="nothing_like_it"):
        cmbrl.nothing_like_it  # noqa: B018
