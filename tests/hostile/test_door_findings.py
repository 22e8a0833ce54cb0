"""What a hostile user found once: each is refused in one line, within seconds, and leaves nothing behind."""

from __future__ import annotations

import io
import os
import struct
import zipfile

import numpy as np
import pytest
import torch

from cmbrl import ComplementarityModel, Scene, Transitions
from cmbrl.cli.main import main
from cmbrl.errors import UserError
from cmbrl.registry import load_task

from . import door, mjcf_files, npz_files, yaml_files


@pytest.fixture(scope="module")
def model() -> ComplementarityModel:
    task = load_task("hopper")
    return ComplementarityModel(task.load_scene(), **task.model_options())


@pytest.fixture(scope="module")
def log() -> dict[str, np.ndarray]:
    return dict(npz_files.logs()[0])


def refused(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line with which ``cmbrl WORDS`` ends."""
    assert main([str(word) for word in words]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("cmbrl: ")
    assert shown.err.count("\n") == 1
    assert len(shown.err) < 1000
    return shown.err


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"prune": -np.inf}, "prune"),
        ({"prune": -1.0}, "prune"),
        ({"prune": np.nan}, "prune"),
        ({"prune": "3"}, "prune"),
        ({"substeps": 1.9}, "substeps"),
        ({"substeps": 2**31}, "substeps"),
        ({"substeps": True}, "substeps"),
        ({"time_step": np.inf}, "time_step"),
        ({"threads": 10**6}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"path_tolerance": np.nan}, "path_tolerance"),
        ({"path_tolerance": 0.0}, "path_tolerance"),
        ({"implicit_springs": "no"}, "implicit_springs"),
        ({"smoothing": "exact"}, "smoothing"),
        ({"candidates": 3.0}, "parameters"),
    ],
)
def test_settings_are_checked_at_the_door(model, settings, told):
    with pytest.raises(UserError, match=told):
        model.with_settings(**settings)
    assert model.with_settings(prune=np.inf, substeps=np.int64(2)).substeps == 2


@pytest.mark.parametrize("kind", ["U", "S", "M8[s]", "m8[s]", "complex", "O"])
def test_wrong_types_are_refused_wherever_a_log_or_a_state_enters(model, log, tmp_path, kind):
    rows = {name: log[name] for name in ("q", "v", "u", "q_next", "v_next", "dt", "episode")}
    wrong = log["v"].astype(kind)
    with pytest.raises(UserError, match="v "):
        Transitions(**(rows | {"v": wrong}))
    if kind != "O":  # objects are pickles in a file, which has its own refusal
        np.savez(tmp_path / "log.npz", **(log | {"v": wrong}))
        with pytest.raises(UserError, match=r"log\.npz: v "):
            Transitions.load(tmp_path / "log.npz")
    for call in (model.predict, model.contact_problems):
        with pytest.raises(UserError, match="v "):
            call(log["q"], wrong, log["u"])
    with pytest.raises(UserError, match="v "):
        model.smooth_dynamics(log["q"], wrong)
    with pytest.raises(UserError, match="v is"):
        model.step(torch.from_numpy(log["q"]), wrong, torch.from_numpy(log["u"]))
    with pytest.raises(UserError, match="dv"):
        model.scene.integrate(log["q"], wrong)
    with pytest.raises(UserError, match="parameters"):
        model.with_parameters(model.parameters.astype(kind))


def test_masked_entries_are_not_data(log):
    rows = {name: log[name] for name in ("q", "v", "u", "q_next", "v_next", "dt", "episode")}
    masked = np.ma.masked_greater(log["v"], 0.0)
    with pytest.raises(UserError, match="v has masked entries"):
        Transitions(**(rows | {"v": masked}))


@pytest.mark.parametrize(
    "text",
    [
        yaml_files.BOMB,
        yaml_files.BOMB + "command: *i\n",
        "seed: &s 1\nhorizon: *s\n",
        "a: " + "[" * 5 + "]" * 5,
        "command: {}\n",
    ],
)
def test_configurations_that_grow_are_refused(capsys, tmp_path, text):
    (tmp_path / "config.yaml").write_text(text, encoding="utf-8")
    assert "config.yaml" in refused(capsys, "fit", "--config", tmp_path / "config.yaml")


@pytest.mark.parametrize("value", ["0x" + "f" * 5000, "[" * 300 + "]" * 300, "9" * 5000])
def test_values_that_cannot_be_written_are_refused(capsys, tmp_path, value):
    (tmp_path / "config.yaml").write_text(f"source: hopper\nseed: {value}\n", encoding="utf-8")
    assert "config.yaml" in refused(capsys, "fit", "--config", tmp_path / "config.yaml")


@pytest.mark.parametrize(
    "words",
    [
        "fit --config pipe",
        "info pipe.xml",
        "info include.xml",
        "error --data pipe.npz --scene hopper hold",
        "sweep pipe --seeds 0:2",
    ],
)
def test_a_pipe_is_no_file(tmp_path, words):
    for name in ("pipe", "pipe.xml", "pipe.npz"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "include.xml").write_text('<mujoco><include file="pipe"/></mujoco>', encoding="utf-8")
    names = {path.name for path in tmp_path.iterdir()}
    typed = [str(tmp_path / word) if word in names else word for word in words.split()]
    kind, told = door.outcome(lambda: door.command(*typed), seconds=10.0)
    assert (kind, "pipe" in told) == (door.REFUSED, True), told


@pytest.mark.parametrize(
    "inside",
    [
        '<replicate count="100000000"><geom size=".1"/></replicate>',
        "<replicate count='1000'>" * 3 + "<site/>" + "</replicate>" * 3,
        '<composite type="cable" count="100000000 1 1"><geom size=".1"/></composite>',
    ],
)
def test_copies_without_end_are_refused(tmp_path, inside):
    text = mjcf_files.BALL.replace("</worldbody>", f"{inside}</worldbody>")
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    kind, told = door.outcome(lambda: door.command("info", str(tmp_path / "scene.xml")), seconds=10.0)
    assert (kind, "10000 elements" in told) == (door.REFUSED, True), told


def test_too_many_pairs_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr("cmbrl.scene.mixing.MOST_PAIRS", 10)
    inside = '<replicate count="9" offset="1 0 0"><body><freejoint/><geom size=".1"/></body></replicate>'
    text = mjcf_files.BALL.replace("</worldbody>", f"{inside}</worldbody>")
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match="more than 10 pairs of geoms"):
        Scene.from_mjcf(tmp_path / "scene.xml")


def test_a_few_copies_are_made(tmp_path):
    copies = '<replicate count="3" offset="1 0 0"><body><freejoint/><geom size=".1"/></body></replicate>'
    (tmp_path / "inside.xml").write_text(f"<mujoco><worldbody>{copies}</worldbody></mujoco>", encoding="utf-8")
    text = mjcf_files.BALL.replace("</mujoco>", '<include file="inside.xml"/></mujoco>')
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    assert Scene.from_mjcf(tmp_path / "scene.xml").nv == 24


@pytest.mark.parametrize(
    "setting",
    [
        "critic_epochs=1e300",
        "critic_epochs=2147483647",
        "actor_hidden=2147483647",
        "environments=1e9",
        "window=1e300",
        "window=inf",
    ],
)
def test_a_setting_has_a_largest_value(capsys, tmp_path, setting):
    words = ["train", "hopper", "--algorithm", "shac", "--out", tmp_path / "run", "--set", setting]
    assert setting.split("=")[0] in refused(capsys, *words)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("value", [1e300, 1e9])
def test_a_value_beyond_any_robot_names_its_row(capsys, tmp_path, log, value):
    v = log["v"].copy()
    v[17, 2] = value
    np.savez(tmp_path / "log.npz", **(log | {"v": v}))
    words = ["--data", tmp_path / "log.npz", "--out", tmp_path / "run"]
    told = refused(
        capsys, "fit", "hopper", "--groups", "friction", "--method", "gauss-newton", "--holdout", "0", *words
    )
    assert "row 17" in told
    assert not (tmp_path / "run").exists()


def _changed(log: dict[str, np.ndarray], name: str, array: bytes) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **log)
    out = io.BytesIO()
    with zipfile.ZipFile(buffer) as old, zipfile.ZipFile(out, "w") as new:
        for member in old.namelist():
            new.writestr(member, array if member == f"{name}.npy" else old.read(member))
    return out.getvalue()


def _header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + 1) + text.encode() + b"\n" + bytes(64)


def _field(log: dict[str, np.ndarray], offset: int, value: int) -> bytes:
    """A log whose archive has ``value`` at ``offset`` of every header: 6 the flags, 8 the method of compression."""
    data = bytearray(_changed(log, "", b""))
    for signature, more in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
        place = data.find(signature)
        while place >= 0:
            struct.pack_into("<H", data, place + offset + more, value)
            place = data.find(signature, place + 4)
    return bytes(data)


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (%s, 6)}"
NPZ = {
    "encrypted": lambda log: _field(log, 6, 1),
    "unknown compression": lambda log: _field(log, 8, 99),
    "huge shape": lambda log: _changed(log, "q", _header(HUGE % "900000000000")),
    "shape beyond whole numbers": lambda log: _changed(log, "q", _header(HUGE % ("9" * 30))),
    "malformed header": lambda log: _changed(log, "q", _header("{'descr': (")),
    "deep header": lambda log: _changed(log, "q", _header("(" * 5000)),
    "names are a number": lambda log: log | {"joint_names": np.asarray(3.0)},
    "deep source": lambda log: log | {"source": np.asarray("[" * 100_000)},
    "source is a list": lambda log: log | {"source": np.asarray("[1]")},
    "lengths of strings": lambda log: {"q": log["q"], "v": log["v"], "lengths": np.array(["60"]), "dt": log["dt"]},
    "lengths beyond": lambda log: {"q": log["q"], "lengths": np.array([2**63 - 1, 2**63 - 1, 62]), "dt": log["dt"]},
    "no dt": lambda log: {"q": log["q"], "v": log["v"], "lengths": np.array([60])},
}  # fmt: skip


@pytest.mark.parametrize("damage", NPZ)
def test_damaged_logs_are_one_line(tmp_path, log, damage):
    made = NPZ[damage](log)
    if isinstance(made, dict):
        np.savez(tmp_path / "log.npz", **made)
    else:
        (tmp_path / "log.npz").write_bytes(made)
    with pytest.raises(UserError, match=r"log\.npz") as caught:
        Transitions.load(tmp_path / "log.npz")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "words",
    [
        "train hopper --out text.xml/run --derivative barrier:kappa=1e300",
        "train hopper --out text.xml/run --derivative bundle:samples=1e9",
        f"record hopper --steps 3 --out log.npz --seed {'9' * 5000}",
        "sweep config.yaml --seeds 0:99999999999",
        f"info {'x' * 5000}.xml",
        f"info {'a/' * 2500}b.xml",
        f"record hopper --steps 3 --out {'x' * 5000}.npz",
        f"error --data {'x' * 5000}.npz --scene hopper hold",
        f"fit hopper --data nowhere.npz --out {'x' * 5000}",
        f"train hopper --out {'x' * 5000}",
        f"evaluate {'x' * 5000}",
        f"error --data nowhere.npz --scene hopper {'x' * 5000}",
        f"fit --config {'x' * 5000}",
        "fit hopper --config",
    ],
    ids=lambda words: words[:60],
)
def test_arguments_beyond_all_bounds_are_one_line(capsys, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.yaml").write_text("command: fit\nsource: hopper\ndata: nowhere.npz\n", encoding="utf-8")
    refused(capsys, *words.split())
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]


MJCF = {
    "unknown encoding": ('<?xml version="1.0" encoding="nonsense"?>', "utf-8", "encoding"),
    "encoding of several bytes": ('<?xml version="1.0" encoding="shift_jis"?>', "utf-8", "encoding"),
    "latin-1 names": ('<?xml version="1.0" encoding="latin-1"?>', "latin-1", "UTF-8"),
    "two thousand million user values": ('<mujoco><size nuser_body="2000000000"/></mujoco>', "", "nuser_body"),
}


@pytest.mark.parametrize("name", MJCF)
def test_scenes_of_another_encoding_or_of_any_size_are_one_line(capsys, tmp_path, name):
    head, encoding, told = MJCF[name]
    text = head + mjcf_files.BALL.replace('"floor"', '"böden"') if encoding else head
    (tmp_path / "scene.xml").write_bytes(text.encode(encoding or "utf-8"))
    assert told in refused(capsys, "info", tmp_path / "scene.xml")


@pytest.mark.parametrize("place", ['pos="0 0 1"', 'size="0.1"'])
def test_numbers_of_a_scene_are_those_of_a_robot(tmp_path, place):
    for value in ("nan nan nan", "inf", "1e300"):
        text = mjcf_files.BALL.replace(place, f'{place.split("=")[0]}="{value}"')
        (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
        with pytest.raises(UserError, match=r"scene\.xml"):
            Scene.from_mjcf(tmp_path / "scene.xml")
