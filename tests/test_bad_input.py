"""A user's mistake is one line on stderr and exit code 2, and leaves the disk as it was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cmbrl.registry import load_task

from .conftest import Refused

BALL = '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>{}</worldbody>{}</mujoco>'
FREE_BODY = '<body name="ball"><freejoint/><geom name="ball" type="sphere" size="0.1"/><site name="b"/></body>'
TENDON = '<tendon><spatial name="string" armature="1"><site site="a"/><site site="b"/></spatial></tendon>'
SITES = '<site name="a" pos="0 0 1"/>'

FIT = "fit hopper --data hopper.npz --out run"
RECORD = "record hopper --steps 5 --out new.npz"
ERROR = "error --data hopper.npz"

# What the user types -> what the line must tell: the place, and where there is one, the remedy.
MISTAKES = {
    "no command of that name": ("inof hopper", "unknown command 'inof'", "did you mean 'info'"),
    "missing argument": ("info", "SCENE|TASK", "cmbrl info --help"),
    "unknown option": (f"{RECORD} --sed 1", "--sed", "cmbrl record --help"),
    "not a number": ("record hopper --steps many --out new.npz", "--steps", "'many'"),
    "no steps": ("record hopper --steps 0 --out new.npz", "--steps", "below 1"),
    "empty option": ("record hopper --steps 5 --out=", "--out: is empty", "leave it out"),
    "missing scene": ("info nowhere.xml", "nowhere.xml", "no such file"),
    "scene is a folder": ("info ./", "no such file", ".xml"),
    "not XML": ("info text.xml", "text.xml", ""),
    "XML but not MJCF": ("info page.xml", "page.xml", ""),
    "unsupported element": ("info tendon.xml", "tendon 'string'", "--ignore tendon"),
    "unknown kind to ignore": ("info tendon.xml --ignore tendn", "tendn", "tendon"),
    "unknown task": ("info hoper", "unknown task 'hoper'", "did you mean 'hopper'"),
    "unknown task to record": ("record chetah --steps 5 --out new.npz", "'chetah'", "did you mean 'cheetah'"),
    "unknown behaviour": (f"{RECORD} --behaviour rndom", "rndom", "did you mean 'random'"),
    "policy missing": (f"{RECORD} --policy none.pt", "none.pt", "no such policy file"),
    "policy is no TorchScript": (f"{RECORD} --policy text.xml", "text.xml", "torch.jit"),
    "unknown format": ("record hopper --steps 5 --out new.csv", "new.csv", ".npz"),
    "output below a file": ("record hopper --steps 5 --out text.xml/new.npz", "text.xml/new.npz", "another place"),
    "Minari folder exists": ("record hopper --steps 5 --out run_of_fit", "run_of_fit", "another name"),
    "published log not named": ("record cube_toss --steps 5 --out new.npz", "cube_toss", "--data"),
    "missing log": ("fit hopper --data nowhere.npz --out run", "nowhere.npz", "no such file"),
    "log is no npz": ("fit hopper --data damaged.npz --out run", "damaged.npz", ""),
    "log of another robot": ("fit hopper --data cheetah.npz --out run", "cheetah.npz", "scene"),
    "NaN in the log": ("fit hopper --data nan.npz --out run", "nan.npz", "row 17"),
    "empty log": ("fit hopper --data empty.npz --out run", "empty.npz", ""),
    "log of another time step": ("fit hopper --data slow.npz --out run", "dt", ""),
    "horizon beyond every episode": (f"{FIT} --horizon 5000", "5000", "shorter horizon"),
    "parameter outside its bounds": (f"{FIT} --set mass.torso=90", "mass.torso", "bounds"),
    "unknown parameter": (f"{FIT} --set mass.toroso=1", "mass.toroso", "did you mean 'mass.torso'"),
    "parameter without a value": (f"{FIT} --set mass.torso", "mass.torso", "name=value"),
    "unknown group": (f"{FIT} --groups frction", "frction", "did you mean 'friction'"),
    "output is a file": ("fit hopper --data hopper.npz --out text.xml", "text.xml", "another"),
    "nothing to resume": (f"{FIT} --resume", "run", "--resume"),
    "missing configuration": ("fit --config none.yaml", "none.yaml", "no such"),
    "whole number of 5,000 digits": ("fit --config digits.yaml", "digits.yaml", "YAML"),
    "value of the wrong type in a configuration": ("fit --config wrong.yaml", "wrong.yaml", "--horizon"),
    "value that is not a choice": ("fit --config choice.yaml", "choice.yaml", "'gauss-newton'"),
    "nested value in a configuration": ("fit --config nested.yaml", "nested.yaml", "--groups"),
    "list without a value in a configuration": ("fit --config none_of.yaml", "argument --data", "at least one"),
    "switch that is not on or off": ("fit --config switch.yaml", "switch.yaml", "true or false"),
    "all parameters and some": (f"{FIT} --all-parameters --groups mass", "--groups", "drop one"),
    "some by a configuration and all": ("fit --config groups.yaml --all-parameters", "--groups", "drop one"),
    "unknown key in a configuration": ("fit --config typo.yaml", "typo.yaml", "did you mean 'method'"),
    "configuration of another command": ("fit --config other.yaml", "other.yaml", "cmbrl record"),
    "no model of that name": (f"{ERROR} --scene hopper hodl", "hodl", "did you mean 'hold'"),
    "no scene to compare in": (f"{ERROR} hold", "--scene", ""),
    "ensemble without a log to learn from": (f"{ERROR} --scene hopper ensemble", "ensemble", "--train"),
    "log of another robot to compare on": ("error --data cheetah.npz --scene hopper hold", "cheetah.npz", "scene"),
    "output holds another run": (f"{ERROR} --scene hopper hold --out run_of_fit", "run_of_fit", "another --out"),
    "unknown row of a benchmark": ("bench speed --scene hoper", "hoper", "did you mean 'hopper"),
    "unknown benchmark": ("bench sped", "sped", "speed"),
}


@pytest.fixture(scope="session")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one small good log and many bad files."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "text.xml").write_text("dear diary", encoding="utf-8")
    (folder / "page.xml").write_text("<html><body>hello</body></html>", encoding="utf-8")
    (folder / "tendon.xml").write_text(BALL.format(FREE_BODY + SITES, TENDON), encoding="utf-8")
    (folder / "damaged.npz").write_bytes(b"PK\x03\x04 and then nothing")
    (folder / "typo.yaml").write_text("source: hopper\nmethd: random\n", encoding="utf-8")
    (folder / "other.yaml").write_text("command: record\ntask: hopper\n", encoding="utf-8")
    (folder / "digits.yaml").write_text(f"source: hopper\nseed: {'9' * 5000}\n", encoding="utf-8")
    (folder / "wrong.yaml").write_text("source: hopper\nhorizon: many\n", encoding="utf-8")
    (folder / "choice.yaml").write_text("source: hopper\nmethod: magic\n", encoding="utf-8")
    (folder / "nested.yaml").write_text("source: hopper\ngroups: [{mass: 1}]\n", encoding="utf-8")
    (folder / "none_of.yaml").write_text("source: hopper\ndata: []\nout: o\n", encoding="utf-8")
    (folder / "switch.yaml").write_text("source: hopper\nresume: perhaps\n", encoding="utf-8")
    groups = "source: hopper\ndata: hopper.npz\nout: run\ngroups: [mass]\n"
    (folder / "groups.yaml").write_text(groups, encoding="utf-8")
    (folder / "run_of_fit").mkdir()
    (folder / "run_of_fit" / "config.json").write_text('{"command": "fit"}', encoding="utf-8")
    load_task("hopper").record(200, seed=0).save(folder / "hopper.npz")
    load_task("cheetah").record(20, seed=0).save(folder / "cheetah.npz")
    with np.load(folder / "hopper.npz", allow_pickle=False) as archive:
        good = dict(archive)
    v = good["v"].copy()
    v[17, 2] = np.nan
    np.savez(folder / "nan.npz", **(good | {"v": v}))
    np.savez(folder / "slow.npz", **(good | {"dt": np.float64(0.02)}))
    np.savez(folder / "empty.npz", **_head(good, 0))
    return folder


def _head(log: dict[str, np.ndarray], rows: int) -> dict[str, np.ndarray]:
    """The first ``rows`` transitions of the arrays of a log; what is not one value a transition stays."""
    n = len(log["q"])
    return {name: array[:rows] if np.shape(array)[:1] == (n,) else array for name, array in log.items()}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_one_line_exit_2_nothing_written(mistake: str, inputs: Path, refused: Refused) -> None:
    refused(inputs, *MISTAKES[mistake])
