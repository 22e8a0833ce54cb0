"""A configuration under many seeds gives what each seed gives alone; it resumes, and a Slurm array does the same."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cmbrl.cli import main
from cmbrl.cli.main import parser_of
from cmbrl.cli.sweep import report
from cmbrl.cli.sweep.plan import Plan
from cmbrl.gradients.kinds import KINDS, parse_derivative
from cmbrl.scene.laws import LawChoice
from cmbrl.text import parse_fields
from cmbrl.train.algorithms import algorithm

CONFIG = """
command: train
task: ball_throw
algorithm: shac
iterations: 2
set: {environments: 4, horizon: 1}
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    pytest.importorskip("pymunk")
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "throw.yaml"
    file.write_text(CONFIG, encoding="utf-8")
    return file


def policy(folder: Path) -> bytes:
    return (folder / "policy.safetensors").read_bytes()


def test_every_seed_is_what_it_is_alone(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "throw.yaml", "--seeds", "3:5", "--out", "sweep", "--jobs", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:7]] == ["3", "4", "median", "lowest", "highest"]
    assert lines[-1].endswith("sbatch sweep/slurm.sh")
    for seed in (3, 4):
        assert main(["train", "--config", "throw.yaml", "--seed", str(seed), "--out", f"alone_{seed}"]) == 0
        assert policy(tmp_path / f"sweep/seed_{seed}") == policy(tmp_path / f"alone_{seed}")
    kept = json.loads((tmp_path / "sweep/sweep.json").read_text())
    assert kept["seeds"] == [3, 4]
    assert {"commit", "hardware", "versions"} <= kept["environment"].keys()
    before = (tmp_path / "sweep/seed_3/policy.safetensors").stat().st_mtime_ns
    assert main(["sweep", "throw.yaml", "--seeds", "3:6", "--out", "sweep"]) == 0  # only seed 5 is new
    assert (tmp_path / "sweep/seed_3/policy.safetensors").stat().st_mtime_ns == before
    assert policy(tmp_path / "sweep/seed_5")


def test_mistakes_are_one_line(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for typed, said in (
        (["--seeds", "5:5"], "give at least one seed"),
        (["--seeds", "a"], "neither A:B nor a list"),
        (["--seeds", "0:2", "--backend", "slurm"], "invalid choice"),
    ):
        assert main(["sweep", "throw.yaml", "--out", "sweep", *typed]) == 2
        assert said in capsys.readouterr().err
    config.write_text(CONFIG.replace("iterations: 2", "iterations: two"), encoding="utf-8")
    assert main(["sweep", "throw.yaml", "--seeds", "0:1", "--out", "sweep"]) == 2
    assert "--iterations: 'two' is not a whole number" in capsys.readouterr().err
    config.write_text(CONFIG.replace("horizon", "horizn"), encoding="utf-8")
    for out in ("sweep", "new/folders/sweep"):
        assert main(["sweep", "throw.yaml", "--seeds", "0:2", "--out", out]) == 2
        assert "seed 0: shac: no setting 'horizn'" in capsys.readouterr().err
    assert not (tmp_path / "sweep").exists()
    assert not (tmp_path / "new").exists()
    config.write_text("task: hopper\n", encoding="utf-8")
    assert main(["sweep", "throw.yaml", "--seeds", "0:1", "--out", "other"]) == 2
    assert "no `command: train`" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_ctrl_c_ends_the_sweep_and_the_same_command_goes_on(config: Path, tmp_path: Path) -> None:
    config.write_text(CONFIG.replace("iterations: 2", "iterations: 120"), encoding="utf-8")
    typed = ["sweep", "throw.yaml", "--seeds", "0:2", "--out", "sweep", "--jobs", "1"]
    begun = tmp_path / "sweep/seed_0/metrics.csv"

    def interrupt() -> None:
        end = time.monotonic() + 60
        while not begun.exists() and time.monotonic() < end:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    assert main(typed) == 130
    thread.join()
    assert not (tmp_path / "sweep/seed_1").exists()
    assert list((tmp_path / "sweep/seeds").iterdir()) == []
    assert main(typed) == 0
    rows = (tmp_path / "sweep/seed_0/metrics.csv").read_text().splitlines()
    assert len(rows) == 121


def test_a_run_of_other_code_is_not_passed_off_as_this_one(config: Path, tmp_path: Path) -> None:
    typed = ["sweep", "throw.yaml", "--seeds", "0:1", "--out", "sweep"]
    assert main(typed) == 0
    (tmp_path / "sweep/seeds/seed_0.json").unlink()
    about = tmp_path / "sweep/seed_0/environment.json"
    about.write_text(json.dumps(json.loads(about.read_text()) | {"code": "other"}))
    assert main(typed) == 2


def test_the_slurm_array_does_the_same(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "throw.yaml", "--seeds", "3:5", "--out", "array", "--slurm"]) == 0
    script = capsys.readouterr().out
    assert "#SBATCH --array=3-4\n" in script
    (tmp_path / "array").mkdir()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/cmbrl").write_text(f'#!/bin/sh\nexec {sys.executable} -m cmbrl "$@"\n')
    (tmp_path / "bin/cmbrl").chmod(0o755)
    environment = {**os.environ, "SLURM_ARRAY_TASK_ID": "3", "PATH": f"{tmp_path}/bin:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert main(["sweep", "throw.yaml", "--seeds", "3:4"]) == 0
    assert policy(tmp_path / "array/seed_3") == policy(tmp_path / "runs/throw-seeds/seed_3")
    written = (tmp_path / "runs/throw-seeds/slurm.sh").read_text()
    assert "#SBATCH --array=3-3\n" in written
    assert "run=runs/throw-seeds/seed_$SLURM_ARRAY_TASK_ID\n" in written


ARMS = """question: Does BCG help?
answer: an interval above zero
command: train
task: ball_throw
algorithm: shac
iterations: 2
judge: 2
seeds: '0:2'
set: {environments: 4}
arms:
  plain: {}
  longer: {iterations: 3, set: {discount: 0.98}, seeds: [1]}
"""


def test_arms_differ_in_their_options_and_are_compared(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arms.yaml").write_text(ARMS)
    assert main(["sweep", "arms.yaml", "--out", "study", "--jobs", "1"]) == 0
    told = capsys.readouterr().out
    for part in ("Question: Does BCG help?", "An answer: an interval", "difference to plain", "longer: train, 1 seeds"):
        assert part in told
    assert (tmp_path / "study/report.txt").read_text().strip() in told
    assert (tmp_path / "study/curves.png").stat().st_size > 0
    kept = json.loads((tmp_path / "study/sweep.json").read_text())
    plain, longer = kept["arms"]
    assert [run["result"]["iteration"] for run in plain["runs"]] == [2, 2]
    assert longer["options"]["set"] == {"environments": 4, "discount": 0.98}
    assert longer["seeds"] == [1]
    judged = longer["runs"][0]["judged"]
    alone = tmp_path / "study/longer/seed_1"
    assert main(["evaluate", str(alone), "--episodes", "2", "--json"]) == 0
    evaluated = json.loads(capsys.readouterr().out)["in"]
    assert judged["model"]["returns"] == next(value for name, value in evaluated.items() if name != "real")["returns"]
    cell = (tmp_path / "study/seeds/longer_seed_1.json").read_text()
    assert str(tmp_path) not in cell  # results count wherever they lie
    shutil.rmtree(tmp_path / "study/plain")
    assert main(["sweep", "arms.yaml", "--out", "study", "--jobs", "1"]) == 0  # nothing is computed again
    assert not (tmp_path / "study/plain").exists()


def test_arms_are_run_one_by_one(config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sweep of all goes on with what is finished."""
    (tmp_path / "arms.yaml").write_text(ARMS)
    assert main(["sweep", "arms.yaml", "--arm", "shorter", "--out", "study"]) == 2
    assert "arms.yaml: no arm 'shorter'; its arms: plain; longer" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()
    assert main(["sweep", "arms.yaml", "--arm", "longer", "--out", "study", "--jobs", "1"]) == 0
    assert [file.stem for file in (tmp_path / "study/seeds").iterdir()] == ["longer_seed_1"]
    shutil.rmtree(tmp_path / "study/longer")
    assert main(["sweep", "arms.yaml", "--out", "study", "--jobs", "1"]) == 0
    assert not (tmp_path / "study/longer").exists()
    kept = json.loads((tmp_path / "study/sweep.json").read_text())
    assert [(arm["arm"], len(arm["runs"])) for arm in kept["arms"]] == [("plain", 2), ("longer", 1)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("iterations: 3", "iterationz: 3", "arms.yaml: longer: 'iterationz' is not an option"),
        ("longer:", "'Plain ':", "give each a name of its own"),
        ("'0:2'", "3:6", "in quotes"),
        ("judge: 2", "judge: many", "judge"),
        ("plain: {}", "plain: 3", "arms: give a mapping"),
        ("seeds: '0:2'\n", "", "has no seeds"),
        ("plain: {}", "plain: {out: x}", "'out' is decided by the sweep"),
    ],
)
def test_a_mistake_in_the_arms_is_found_at_the_door(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    (tmp_path / "arms.yaml").write_text(ARMS.replace(old, new))
    assert main(["sweep", "arms.yaml", "--out", "study"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(
    "file", sorted((Path(__file__).parents[2] / "configs/studies").glob("*.yaml")), ids=lambda file: file.stem
)
def test_the_studies_are_plans_whose_options_exist(file: Path) -> None:
    plan = Plan.read(file, None)
    assert plan.question
    assert plan.answer
    for arm in plan.arms:
        parser = parser_of(plan.command)
        parser.use(arm.options, file)
        typed = parser.parse(["--out", "out"])
        chosen = algorithm(typed.algorithm or "shac")
        parse_fields(chosen.load()[1], dict(typed.set), file.name)
        if typed.contact_law:
            LawChoice.parse(typed.contact_law)
        if typed.derivative:
            kind, options = parse_derivative(typed.derivative)
            assert options.keys() <= KINDS[kind].options.keys()


def test_a_run_that_never_began_leaves_nothing_of_its_arms(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arms.yaml").write_text(ARMS.replace("task: ball_throw", "task: g1\nmotion: none.csv"))
    assert main(["sweep", "arms.yaml", "--out", "study", "--jobs", "1"]) == 2
    assert "none.csv: no such file" in capsys.readouterr().err
    assert not (tmp_path / "study").exists()


def test_curves_count_model_steps_and_real_transitions_alike() -> None:
    seen = {"iteration": [1.0, 2.0], "steps": [64.0, 128.0], "transitions": [1000.0, None]}
    assert report.samples(seen).tolist() == [1064.0, 128.0]
    assert report.samples({"iteration": [1.0, 2.0], "transitions": [10.0, 20.0]}).tolist() == [10.0, 20.0]
    assert report.samples({"iteration": [1.0, 2.0]}).tolist() == [1.0, 2.0]
