"""From columns to a log: units; a regular grid; velocities; frames; several files; faults on the way."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Transitions, UserError
from cmbrl.cli.main import main
from cmbrl.data.importing import Frames, Imported, Options, import_logs
from cmbrl.data.importing.grid import Counts, Series, clean, to_grid, usual_step
from cmbrl.data.importing.velocities import smoothed
from cmbrl.data.plausible.frames import to_world
from cmbrl.data.position_log import PositionLog
from cmbrl.models.source import load_source
from cmbrl.registry import load_task
from cmbrl.scene import Scene

from .robots import JOINTS, arm_file, position_log, simulate

ROWS, DT = 600, 0.005
Import = Callable[..., Imported]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("importing")
    arm_file(folder, servo=True)
    arm_file(folder, servo=False)
    return folder


@pytest.fixture(scope="module")
def scene(place: Path) -> Scene:
    return Scene.from_mjcf(place / "arm_servo.xml")


@pytest.fixture(scope="module")
def log(place: Path) -> PositionLog:
    return position_log(place / "arm_servo.xml", rows=ROWS)


@pytest.fixture
def imported(tmp_path: Path, log: PositionLog, scene: Scene) -> Import:
    """``imported(options, t=..., keep=..., **columns)``: the arm's log as an npz, with other columns, read."""

    def run(options: Options | None = None, keep: np.ndarray | None = None, **columns: np.ndarray) -> Imported:
        table = {"time": DT * np.arange(ROWS), "q": log.position, "target": log.command, **columns}
        rows = np.arange(ROWS) if keep is None else keep
        table = {name: array[rows] if array.ndim else array for name, array in table.items()}
        np.savez(tmp_path / "log.npz", joint_names=np.array(JOINTS), **table)
        return import_logs([tmp_path / "log.npz"], scene, options)

    return run


def test_units(imported: Import, log: PositionLog) -> None:
    found = imported(
        Options({"target.elbow": "elbow.command:rev", "time": "time:ms"}, angles="deg"),
        time=1e3 * DT * np.arange(ROWS), q=np.degrees(log.position),
        target=log.command / [np.pi / 180, 2 * np.pi, np.pi / 180],
    ).log  # fmt: skip
    np.testing.assert_allclose(found.position, log.position)
    np.testing.assert_allclose(found.command, log.command)
    assert found.dt == pytest.approx(DT)
    with pytest.raises(UserError, match=r"samples are 5e\+06 s apart: is the unit of time right"):
        imported(time=np.arange(ROWS) * 5_000_000)
    assert imported(Options({"time": "time:ns"}), time=np.arange(ROWS) * 5_000_000).log.dt == pytest.approx(DT)


def test_other_signs_zeros_and_shares_of_a_range(imported: Import, log: PositionLog) -> None:
    """An elbow that counts degrees the other way from 30, and a wrist of -100 to 100 of its range of +-2.5 rad."""
    columns = {"q": log.position.copy(), "target": log.command.copy()}
    given = {}
    for name, quantity in (("q", "position"), ("target", "command")):
        columns[name][:, 1] = 30.0 - np.degrees(columns[name][:, 1])
        columns[name][:, 2] *= 100.0 / 2.5
        given |= {f"{name}.elbow": f"elbow.{quantity}:-deg+30", f"{name}.wrist": f"wrist.{quantity}:+-percent"}
    found = imported(Options(given), **columns).log
    np.testing.assert_allclose(found.position, log.position)
    np.testing.assert_allclose(found.command, log.command)


def test_stamps_that_jitter_beside_a_topic_that_begins_between_them() -> None:
    rng = np.random.default_rng(0)
    stamps = 10.0 + DT * (np.arange(ROWS) + 0.12 * rng.standard_normal(ROWS))
    keep = np.delete(np.arange(ROWS), [100, 200, 201])
    rows = np.arange(ROWS, dtype=float)[keep, None]
    own = {"q": Series(stamps[keep], rows), "u": Series(stamps[keep], rows, "held")}
    late = Series(stamps[0] + DT * (0.5 + np.arange(ROWS)), np.zeros((ROWS, 1)))
    counts = Counts()
    (found,) = to_grid({(k, ""): one for k, one in {**own, "late": late}.items()}, [("q", "")], DT, 10, counts)
    row = np.round(found["q", ""])
    assert np.abs(found["q", ""] - row).mean() < 0.15
    assert (row != found["u", ""]).sum() <= 10
    assert counts.lost == 3


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_stamps_that_jitter_tell_the_step(lost: float) -> None:
    """By a third of a step to either side, as those of a computer that does other things: to a thousandth of it."""
    rng = np.random.default_rng(3)
    stamps = 7.0 + DT * (np.arange(2000) + rng.uniform(-0.3, 0.3, 2000))
    parts = np.split(stamps[rng.random(2000) >= lost], [700])
    series = [Series(part, part[:, None]) for part in (parts[0], np.concatenate([parts[1][:500], parts[1][600:]]))]
    assert abs(usual_step(series) / DT - 1.0) < 1e-3


def test_lost_and_late_samples_are_filled_in_and_told(imported: Import, log: PositionLog) -> None:
    rng = np.random.default_rng(0)
    lost = np.sort(rng.choice(np.arange(5, ROWS - 5), 40, replace=False))
    found = imported(keep=np.delete(np.arange(ROWS), lost))
    assert len(found.log) == ROWS
    assert f"40 of {ROWS} samples were resampled to a regular grid, 40 of them were lost" in " ".join(found.notes)
    np.testing.assert_allclose(found.log.position, log.position, atol=0.02)
    late = DT * np.arange(ROWS) + np.concatenate([[0.0], rng.uniform(-0.2, 0.2, ROWS - 2), [0.0]]) * DT
    moved = np.column_stack([np.interp(late, DT * np.arange(ROWS), column) for column in log.position.T])
    found = imported(time=late, q=moved)
    np.testing.assert_allclose(found.log.position[5:-5], log.position[5 : len(found.log) - 5], atol=0.02)
    assert "were resampled" in " ".join(found.notes)
    double = np.sort(np.concatenate([np.arange(ROWS), [7, 8, 9]]))
    found = imported(keep=double)
    assert "3 samples that repeat a time were dropped" in found.notes
    np.testing.assert_allclose(found.log.position, log.position)


def test_samples_that_are_no_numbers_are_told(imported: Import, log: PositionLog) -> None:
    q = log.position.copy()
    q[20:30:5, 1] = np.nan
    found = imported(q=q)
    assert "no numbers, or beyond 1e12, were filled in, or left out where many are: 2 of" in " ".join(found.notes)
    np.testing.assert_allclose(found.log.position, log.position, atol=0.02)
    cut = log.position.copy()
    cut[-1, 1] = 9.2e149  # of a last line that was not written to its end
    found = imported(q=cut)
    assert "or beyond 1e12, were filled in, or left out where many are: 1 of" in " ".join(found.notes)
    np.testing.assert_allclose(found.log.position[:-1], log.position[: len(found.log) - 1], atol=1e-6)


def test_gaps_end_episodes(imported: Import) -> None:
    found = imported(keep=np.delete(np.arange(ROWS), np.arange(200, 240)))
    assert found.log.n_episodes == 2
    assert len(found.log) == ROWS - 40
    assert "1 gap of more than 10 samples, where an episode ends" in found.notes
    joined = imported(Options(gap=50), keep=np.delete(np.arange(ROWS), np.arange(200, 240))).log
    assert (joined.n_episodes, len(joined)) == (1, ROWS)


def test_a_time_that_restarts_is_two_recordings(imported: Import, log: PositionLog) -> None:
    time = DT * np.concatenate([np.arange(300), np.arange(300)])
    with pytest.raises(
        UserError, match=r"the time of q.\w+ falls from 1.495 to 0 s after row 299: two recordings in one"
    ):
        imported(time=time)
    found = imported(time=time, episode=np.repeat([4, 7], 300)).log
    assert found.n_episodes == 2
    np.testing.assert_allclose(found.position, log.position)


def test_commands_hold_and_quaternions_turn() -> None:
    """Two clocks: the grid is that of positions; the other series are read at its times."""
    counts = Counts()
    slow = np.arange(0, 1.01, 0.1)
    half, signs = 0.5 * slow, (-1.0) ** np.arange(11)[:, None]
    turning = np.column_stack([np.cos(half), 0 * half, np.sin(half), 0 * half])
    series = {
        ("a", "position"): Series(np.arange(0, 1.001, 0.01), np.arange(0, 1.001, 0.01)[:, None]),
        ("a", "command"): Series(slow, np.arange(11.0)[:, None], "held"),
        ("b", "quaternion"): clean("b", "f", slow, signs * turning, "turn", counts),
    }
    (episode,) = to_grid(series, [("a", "position")], 0.01, 20, counts)
    t = 0.01 * np.arange(101)
    np.testing.assert_array_equal(episode["a", "command"][:, 0], np.floor(10 * t + 1e-9))
    turned = episode["b", "quaternion"]
    np.testing.assert_allclose(
        turned * np.sign(turned[:, :1]), np.column_stack([np.cos(t / 2), 0 * t, np.sin(t / 2), 0 * t]), atol=1e-12
    )
    assert counts.resampled == 0


def test_estimated_velocities_are_those_of_a_parabola() -> None:
    robot = load_source("cube_toss").scene
    t = 0.01 * np.arange(30)[:, None]
    spin = np.array([0.3, -2.0, 1.0])
    half = np.linalg.norm(spin) * t / 2
    turn = np.hstack([np.cos(half), np.sin(half) * spin / np.linalg.norm(spin)])
    q = np.hstack([[1.0, 2.0, 3.0] + [4.0, 5.0, 6.0] * t - [0, 0, 4.905] * t**2, turn])
    v = smoothed(q, 0.01, 7, robot)
    np.testing.assert_allclose(v[:, :3], ([4.0, 5.0, 6.0] - [0, 0, 9.81] * t)[3:-3], atol=1e-10)
    np.testing.assert_allclose(v[:, 3:], np.tile(spin, (24, 1)), atol=1e-10)


def test_slopes_do_not_reach_across_an_impact(tmp_path: Path) -> None:
    """A ball that bounces, by a capture with noise: rows before an impact tell the velocity before it."""
    body = '<body><joint name="z" type="slide" axis="0 0 1"/><geom size=".05"/></body>'
    (tmp_path / "ball.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    time, bounce, g = 0.01 * np.arange(100), 0.505, 9.81
    v = np.where(time < bounce, -g * time, 0.8 * g * bounce - g * (time - bounce))
    z = np.where(time < bounce, 1.3 - 0.5 * g * time**2, 0.0)
    after = time - bounce
    z = np.where(after >= 0.0, 1.3 - 0.5 * g * bounce**2 + 0.8 * g * bounce * after - 0.5 * g * after**2, z)
    q = (z + 3e-4 * np.random.default_rng(0).normal(size=len(z)))[:, None]
    found = smoothed(q, 0.01, 5, Scene.from_mjcf(tmp_path / "ball.xml"))[:, 0]
    off = np.abs(found - v[2:-2])
    near = np.abs(time[2:-2] - bounce) < 0.03
    assert off[near].max() < 0.15
    assert off[~near].max() < 0.05
    assert (2 * (z[52] - z[48]) + z[51] - z[49]) / 0.1 - v[50] > 2.0  # central differences miss that much there


def test_transitions_from_positions_alone(place: Path, tmp_path: Path, scene: Scene, log: PositionLog) -> None:
    command = log.command
    q, v = simulate(place / "arm_servo.xml", command)
    np.savez(tmp_path / "log.npz", joint_names=np.array(JOINTS), time=DT * np.arange(ROWS), q=q, target=command)
    found = import_logs([tmp_path / "log.npz"], scene, Options(kind="transitions"))
    assert isinstance(found.log, Transitions)
    assert len(found.log) == ROWS - 5
    np.testing.assert_allclose(found.log.q, q[2:-3])
    np.testing.assert_allclose(found.log.u, command[2:-3])
    assert np.sqrt(np.mean((found.log.v - v[2:-3]) ** 2)) < 0.1 * v.std()
    told = "estimated: central differences over a Savitzky-Golay window of 5 samples"
    assert any(told in note for note in found.notes)


def test_torques_become_controls_by_gear(place: Path, tmp_path: Path) -> None:
    motors = Scene.from_mjcf(place / "arm_motor.xml")
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, (ROWS // 4, 3)), 4, axis=0)
    q, v = simulate(place / "arm_motor.xml", u)
    table = {"joint_names": np.array(JOINTS), "time": DT * np.arange(ROWS), "q": q, "dq": v, "tau": 3 * u}  # gear 3
    np.savez(tmp_path / "log.npz", **table)
    found = import_logs([tmp_path / "log.npz"], motors).log
    assert isinstance(found, Transitions)
    np.testing.assert_allclose(found.u, u[:-1])
    np.testing.assert_allclose(found.v, v[:-1])
    del table["dq"]
    np.savez(tmp_path / "log.npz", **table)
    positions = import_logs([tmp_path / "log.npz"], motors).log
    assert isinstance(positions, PositionLog)
    assert positions.command_kind == "torque"
    np.testing.assert_allclose(positions.command, 3 * u)
    del table["tau"]
    np.savez(tmp_path / "log.npz", **table)
    with pytest.raises(UserError, match=r"no column for actuator 'shoulder': map one by --map COLUMN=shoulder.torque"):
        import_logs([tmp_path / "log.npz"], motors)


def test_torques_over_a_file_with_servos_ask_for_a_log_of_positions(place: Path, tmp_path: Path) -> None:
    servos, u = Scene.from_mjcf(place / "arm_servo.xml"), np.zeros((ROWS, 3))
    q, v = simulate(place / "arm_motor.xml", u)
    np.savez(tmp_path / "log.npz", joint_names=np.array(JOINTS), time=DT * np.arange(ROWS), q=q, dq=v, tau=u)
    with pytest.raises(UserError, match=r"no column for actuator 'shoulder', a servo .* give --as positions, which"):
        import_logs([tmp_path / "log.npz"], servos)
    found = import_logs([tmp_path / "log.npz"], servos, Options(kind="positions")).log
    assert isinstance(found, PositionLog)
    assert found.command_kind == "torque"


def test_frames_of_the_base_are_asked_for_and_checked(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    recorded = load_task("g1").record(400, 0, "random", None, None)
    robot = load_source("g1").scene
    rows = np.flatnonzero(recorded.episode == 0)
    q, v = recorded.q[rows], recorded.v[rows]
    names = [name for name in robot.joint_names if name != "root"]
    base = ["x", "y", "z", "qw", "qx", "qy", "qz"]
    table = {f"base.{name}": q[:, k] for k, name in enumerate(base)}
    table |= {f"q.{name}": q[:, 7 + k] for k, name in enumerate(names)}
    table |= {f"v.{name}": v[:, 6 + k] for k, name in enumerate(names)}
    table |= {f"ctrl.{name}": recorded.u[rows, k] for k, name in enumerate(robot.actuator_names)}
    table |= {f"base.{name}": v[:, k] for k, name in enumerate(("vx", "vy", "vz"))}
    world = to_world(q[:, 3:7], v[:, 3:6])
    columns = {f"v.{name}": f"{name}.velocity" for name in names}

    def run(spin: np.ndarray, frame: str | None) -> Imported:
        given = table | {f"base.{name}": spin[:, k] for k, name in enumerate(("wx", "wy", "wz"))}
        np.savez(tmp_path / "log.npz", dt=recorded.dt, **given)
        return import_logs([tmp_path / "log.npz"], robot, Options(columns, frames=Frames(frame)))

    with pytest.raises(UserError, match="give --angular-velocity body or world"):
        run(world, None)
    for spin, frame in ((world, "world"), (v[:, 3:6], "body")):
        np.testing.assert_allclose(run(spin, frame).log.v, v[:-1], atol=1e-9)


def test_the_other_frame_is_refused(tmp_path: Path) -> None:
    robot = load_source("cube_toss").scene
    rng, rows, dt = np.random.default_rng(5), 100, 0.005
    first = rng.standard_normal(4)
    spin = np.array([4.0, -2.0, 3.0])
    t = dt * np.arange(rows)
    q = np.zeros((rows, 7))
    q[:, :3], q[0, 3:] = [0, 0, 5] - np.outer(t**2, [0, 0, 4.905]), first / np.linalg.norm(first)
    for k in range(1, rows):  # spins about an axis of the world
        q[k] = robot.integrate(q[k - 1], np.concatenate([q[k, :3] - q[k - 1, :3], dt * _to_body(q[k - 1, 3:], spin)]))
    names = ("x", "y", "z", "qw", "qx", "qy", "qz")
    table = {name: q[:, k] for k, name in enumerate(names)}
    table |= {name: np.full(rows, spin[k]) for k, name in enumerate(("wx", "wy", "wz"))}
    np.savez(tmp_path / "log.npz", dt=dt, **table)
    with pytest.raises(UserError, match=r"give --angular-velocity body or world; the positions fit 'world'"):
        import_logs([tmp_path / "log.npz"], robot)
    with pytest.raises(UserError, match=r"--angular-velocity body: .* in the axes of the world better"):
        import_logs([tmp_path / "log.npz"], robot, Options(frames=Frames("body")))
    turned = {name: table[of] for name, of in zip(("qw", "qx", "qy", "qz"), ("qx", "qy", "qz", "qw"), strict=True)}
    np.savez(tmp_path / "turned.npz", dt=dt, **(table | turned))
    with pytest.raises(UserError, match=r"cube.qw to cube.qz .* another way: the numbers are x y z w, and were taken"):
        import_logs([tmp_path / "turned.npz"], robot, Options(frames=Frames("world")))
    found = import_logs([tmp_path / "log.npz"], robot, Options(frames=Frames("world")))
    assert isinstance(found.log, Transitions)
    assert any("velocities of cube (linear) are estimated" in note for note in found.notes)
    body = np.array([_to_body(one, spin) for one in found.log.q[:, 3:]])
    np.testing.assert_allclose(found.log.v[:, 3:], body, atol=1e-9)


def _to_body(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    from cmbrl.scene.manifold import quaternion_matrix

    return quaternion_matrix(quaternion).T @ vector


def test_several_files_are_one_log(place: Path, tmp_path: Path, log: PositionLog, scene: Scene) -> None:
    for k in range(2):
        rows = slice(300 * k, 300 * (k + 1))
        np.savez(
            tmp_path / f"{k}.npz", joint_names=np.array(JOINTS), time=DT * np.arange(300) + 50, q=log.position[rows],
            target=log.command[rows],
        )  # fmt: skip
    out = tmp_path / "out.npz"
    files = [str(tmp_path / "0.npz"), str(tmp_path / "1.npz")]
    assert main(["import", *files, "--scene", str(place / "arm_servo.xml"), "--kp", "50", "--out", str(out)]) == 0
    found = PositionLog.load(out)
    np.testing.assert_allclose(found.position, log.position)
    assert found.n_episodes == 2
    assert found.kp is not None
    assert found.kp.tolist() == [50.0, 50.0, 50.0]
    np.savez(
        tmp_path / "1.npz", joint_names=np.array(JOINTS), time=DT * np.arange(ROWS), q=log.position, dq=log.position
    )
    with pytest.raises(UserError, match=r"has other columns than .*: two robots\? Import logs of one robot"):
        import_logs(files, scene)


def test_the_command_writes_all_or_nothing(
    place: Path, tmp_path: Path, log: PositionLog, capsys: pytest.CaptureFixture[str]
) -> None:
    table = {"joint_names": np.array(JOINTS), "time": DT * np.arange(ROWS), "q": log.position, "target": log.command}
    np.savez(tmp_path / "log.npz", **table)
    np.savez(tmp_path / "wrong.npz", **{**table, "q": log.position * [1, -1, 1]})
    (tmp_path / "map.yaml").write_text("q.elbow: elbow.position:rad\n")
    words = ["--scene", str(place / "arm_servo.xml"), "--out", str(tmp_path / "out.npz")]
    before = sorted(tmp_path.iterdir())
    assert main(["import", str(tmp_path / "wrong.npz"), *words]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "joint_position of joint 'elbow' moves against commanded_position of 'elbow'" in told
    assert sorted(tmp_path.iterdir()) == before
    assert main(["import", str(tmp_path / "log.npz"), *words, "--map", str(tmp_path / "map.yaml"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["kind"], told["rows"], told["episodes"]) == ("positions", ROWS, 1)
    assert main(["import", str(tmp_path / "log.npz"), *words, "--map", "q.elbow"]) == 2
    assert "q.elbow: no such file" in capsys.readouterr().err
    assert main(["import", str(tmp_path / "log.npz"), *words[:2], "--out", str(tmp_path / "out.csv")]) == 2
