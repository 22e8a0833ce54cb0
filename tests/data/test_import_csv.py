"""CSV files as loggers of laboratories write them: units in headers, other encodings, lines before and between rows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import Imported, import_logs
from cmbrl.data.importing.columns.named_units import normal, split
from cmbrl.data.importing.columns.targets import Target, match
from cmbrl.data.position_log import PositionLog
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log

ROWS, DT = 400, 0.005


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    file = arm_file(tmp_path_factory.mktemp("arm"), servo=True)
    return SimpleNamespace(log=position_log(file, rows=ROWS), scene=Scene.from_mjcf(file))


@pytest.mark.parametrize(
    ("column", "target"),
    [
        ("Elbow [°]", Target("elbow", "position", np.pi / 180)),
        ("elbow position (mrad)", Target("elbow", "position", 1e-3)),
        ("elbow_pos_mrad", Target("elbow", "position", 1e-3)),
        ("Elbow Velocity [°/s]", Target("elbow", "velocity", np.pi / 180)),
        ("elbow [1/min]", Target("elbow", "velocity", np.pi / 30)),
        ("Elbow Torque [mNm]", Target("elbow", "torque", 1e-3)),
        ("elbow [N·m]", Target("elbow", "torque")),
        ("elbow target [%]", Target("elbow", "command", 0.05, -2.5)),
        ("elbow_pos_percent", Target("elbow", "position", 0.05, -2.5)),
        ("elbow_pos_degree", Target("elbow", "position", np.pi / 180)),
        ("elbow_turns", Target("elbow", "position", 2 * np.pi)),
        ("elbow_pos_mdeg", Target("elbow", "position", np.pi / 180e3)),
        ("elbow_pos_cdeg", Target("elbow", "position", np.pi / 18e3)),
        ("elbow torque [N cm]", Target("elbow", "torque", 1e-2)),
        ("elbow position [in]", None),  # a hinge
        ("elbow_vel_dps", Target("elbow", "velocity", np.pi / 180)),
        ("elbow_vel_rps", None),  # turns or radians
        ("elbow_torque_mA", None),
        ("elbow torque [A]", None),  # a motor's current
        ("elbow position [counts]", None),
        ("elbow_pos_ticks", None),
        ("elbow position [mm]", None),  # a hinge
        ("elbow position (measured)", Target("elbow", "position")),
    ],
)
def test_names_tell_units(column: str, target: Target | None, arm: SimpleNamespace) -> None:
    found = match([column], {}, arm.scene).get(column)
    assert (found is None) == (target is None)
    if found is not None and target is not None:
        assert found.key == target.key
        assert (found.factor, found.zero) == pytest.approx((target.factor, target.zero))


def test_units_of_bodies_and_of_nothing(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(
        '<mujoco><worldbody><body name="box"><freejoint name="box"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    found = match(["x [mm]", "qw [-]", "box.vz [mm/s]"], {}, Scene.from_mjcf(tmp_path / "box.xml"))
    assert {(t.quantity, t.factor) for t in found.values()} == {("x", 1e-3), ("qw", 1.0), ("vz", 1e-3)}
    assert (normal("deg/sec"), normal("U/min"), normal("left")) == ("deg/s", "rpm", None)
    assert (split("q[0]"), split("Torque (Nm)")) == (("q[0]", None), ("Torque", "Nm"))


HEADER = ["Time [s]", *(f"{name} {word} [°]" for name in JOINTS for word in ("position", "target"))]
Edit = Callable[[list[str]], list[str]]


def lines(arm: SimpleNamespace, times: Callable[[int], str] = lambda k: f"{DT * k:.3f}".replace(".", ",")) -> list[str]:
    """A header and a row per sample, with semicolons and decimal commas."""
    found = [";".join(HEADER)]
    for k in range(ROWS):
        both = np.degrees(np.column_stack([arm.log.position[k], arm.log.command[k]])).ravel()
        found.append(";".join([times(k), *(f"{x:.9f}".replace(".", ",") for x in both)]))
    return found


def read(path: Path, text: list[str], arm: SimpleNamespace, encoding: str = "utf-8") -> Imported:
    path.write_bytes("\r\n".join(text).encode(encoding))
    return import_logs([path], arm.scene)


def same(found: Imported, arm: SimpleNamespace, rows: slice = slice(None), tolerance: float = 1e-9) -> None:
    assert isinstance(found.log, PositionLog)
    np.testing.assert_allclose(found.log.position, arm.log.position[rows], atol=tolerance)
    np.testing.assert_allclose(found.log.command, arm.log.command[rows], atol=tolerance)
    assert found.log.dt == pytest.approx(DT, rel=1e-3)


def below(text: list[str]) -> list[str]:
    names = [name.partition(" [")[0] for name in text[0].split(";")]
    return [";".join(names), ";".join(["s", *["°"] * 6]), *text[1:]]


@pytest.mark.parametrize(
    ("edit", "note"),
    [
        (lambda text: text, ""),
        (below, ""),
        (lambda text: ["Logger;DAQ 4", "Rate;200 Hz", "", *text], "2 lines before the header are passed over"),
        (lambda text: [*text[:9], "# operator: stop", *text[9:]], ""),
        (lambda text: [text[0], *(f"{line};" for line in text[1:])], ""),
        (lambda text: [f"{line};" for line in text], ""),
        (lambda text: [*text, "1,99"], "the last line was not written to its end"),
        (lambda text: [*text, "End of log"], "the last line was not written to its end"),
    ],
    ids=["plain", "units below", "preamble", "comment", "separators at ends", "and of the header", "cut", "end"],
)
def test_what_loggers_write_around_the_rows(edit: Edit, note: str, arm: SimpleNamespace, tmp_path: Path) -> None:
    found = read(tmp_path / "log.csv", edit(lines(arm)), arm)
    same(found, arm)
    assert not note or any(note in each for each in found.notes)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
def test_encodings(encoding: str, arm: SimpleNamespace, tmp_path: Path) -> None:
    same(read(tmp_path / "log.csv", lines(arm), arm, encoding), arm)


def test_few_rows_that_were_cut_are_lost(arm: SimpleNamespace, tmp_path: Path) -> None:
    text = lines(arm)
    found = read(tmp_path / "log.csv", [*text[:200], text[200][:30], *text[201:]], arm)
    same(found, arm, tolerance=0.02)
    assert any("taken for lost: 1 row with another number of fields" in note for note in found.notes)
    cut = [line if k % 20 else line[:30] for k, line in enumerate(text, start=1)]
    with pytest.raises(UserError, match=r"row 20 has 3 fields, the header 7; repair the row"):
        read(tmp_path / "log.csv", cut, arm)


@pytest.mark.parametrize(
    "times",
    [
        lambda k: f"31.12.2026 23:59:{59 + DT * k:06.3f}" if k < 200 else f"1.1.2027 00:00:{DT * k - 1:06.3f}",
        lambda k: f"23:59:{59 + DT * k:06.3f}" if k < 200 else f"00:00:{DT * k - 1:06.3f}",
        lambda k: f"2026-12-31 23:59:{DT * k:06.3f}",
    ],
    ids=["day first", "time of day, past midnight", "ISO"],
)
@pytest.mark.parametrize("name", ["Timestamp", "Zeitstempel"])
def test_the_only_column_of_dates_is_the_time(
    times: Callable[[int], str], name: str, arm: SimpleNamespace, tmp_path: Path
) -> None:
    text = lines(arm, times)
    same(read(tmp_path / "log.csv", [text[0].replace("Time [s]", name), *text[1:]], arm), arm)


@pytest.mark.parametrize("digits", [2, 1])
def test_rows_that_share_a_time_of_few_digits_are_spread(digits: int, arm: SimpleNamespace, tmp_path: Path) -> None:
    found = read(tmp_path / "log.csv", lines(arm, lambda k: f"{DT * k:.{digits}f}"), arm)
    same(found, arm)
    assert any("they are taken 0.005 s apart" in note for note in found.notes)


def test_rows_that_share_a_time_and_tell_other_columns_are_not(arm: SimpleNamespace, tmp_path: Path) -> None:
    """Two topics in one table, and messages that were written twice."""
    text = lines(arm)
    halves = [text[0]]
    for line in text[1:]:
        time, *fields = line.split(";")
        halves += [";".join([time, *(x if (k % 2) == part else "" for k, x in enumerate(fields))]) for part in (0, 1)]
    found = read(tmp_path / "log.csv", halves, arm)
    same(found, arm)
    assert not any("apart" in note for note in found.notes)
    found = read(tmp_path / "log.csv", [text[0], *(line for line in text[1:] for _ in range(2))], arm)
    same(found, arm)
    assert any("400 samples that repeat a time were dropped" in note for note in found.notes)
