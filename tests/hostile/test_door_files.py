"""Logs and scenes that a hostile user found once: each is refused in one line that names the file, within seconds."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest

from cmbrl import Scene, Transitions
from cmbrl.errors import UserError

from . import judge, mjcf_files
from .judge import refused


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
    kind, told = judge.outcome(lambda: judge.fresh_command("info", str(tmp_path / "scene.xml")), seconds=10.0)
    assert (kind, "10000 elements" in told) == (judge.REFUSED, True), told


def test_too_many_pairs_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr("cmbrl.scene.collision.mixing.MOST_PAIRS", 10)
    inside = '<replicate count="9" offset="1 0 0"><body><freejoint/><geom size=".1"/></body></replicate>'
    text = mjcf_files.BALL.replace("</worldbody>", f"{inside}</worldbody>")
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match="more than 10 pairs of geoms"):
        Scene.from_mjcf(tmp_path / "scene.xml")


def test_a_number_without_a_name_is_no_rounding(tmp_path):
    text = mjcf_files.BALL.replace("</mujoco>", '<custom><numeric name="" data="0.01"/></custom></mujoco>')
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    assert Scene.from_mjcf(tmp_path / "scene.xml").nv == 6


def test_a_few_copies_are_made(tmp_path):
    copies = '<replicate count="3" offset="1 0 0"><body><freejoint/><geom size=".1"/></body></replicate>'
    (tmp_path / "inside.xml").write_text(f"<mujoco><worldbody>{copies}</worldbody></mujoco>", encoding="utf-8")
    text = mjcf_files.BALL.replace("</mujoco>", '<include file="inside.xml"/></mujoco>')
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    assert Scene.from_mjcf(tmp_path / "scene.xml").nv == 24


@pytest.mark.parametrize("value", [1e300, 1e9, 1e5])
def test_a_value_beyond_any_robot_names_its_row(tmp_path, log, value):
    v = log["v"].copy()
    v[17, 2] = value
    np.savez(tmp_path / "log.npz", **(log | {"v": v}))
    words = ["--data", tmp_path / "log.npz", "--out", tmp_path / "run"]
    told = refused("fit", "hopper", "--groups", "friction", "--method", "gauss-newton", "--holdout", "0", *words)
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


MJCF = {
    "latin-1 names": ('<?xml version="1.0" encoding="latin-1"?>', "latin-1", "UTF-8"),
    "two thousand million user values": ('<mujoco><size nuser_body="2000000000"/></mujoco>', "", "nuser_body"),
}


@pytest.mark.parametrize("name", MJCF)
def test_scenes_of_another_encoding_or_of_any_size_are_one_line(tmp_path, name):
    head, encoding, told = MJCF[name]
    text = head + mjcf_files.BALL.replace('"floor"', '"böden"') if encoding else head
    (tmp_path / "scene.xml").write_bytes(text.encode(encoding or "utf-8"))
    assert told in refused("info", tmp_path / "scene.xml")


@pytest.mark.parametrize("place", ['pos="0 0 1"', 'size="0.1"'])
def test_numbers_of_a_scene_are_those_of_a_robot(tmp_path, place):
    for value in ("nan nan nan", "inf", "1e300"):
        text = mjcf_files.BALL.replace(place, f'{place.split("=")[0]}="{value}"')
        (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
        with pytest.raises(UserError, match=r"scene\.xml"):
            Scene.from_mjcf(tmp_path / "scene.xml")
