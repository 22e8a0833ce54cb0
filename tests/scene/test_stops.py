"""Stops of joints and ends of tendons: what parameters make of them is what a file says by its limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cmbrl
from cmbrl.bench.studies.derivatives.differences import compare
from cmbrl.contact import Barrier
from cmbrl.models.complementarity import ComplementarityModel
from cmbrl.scene import Scene
from cmbrl.scene.writing.fitted_file import fitted_file
from cmbrl.system import MujocoSystem

ARM = """<mujoco><option timestep=".002"/><compiler angle="degree"/>
<default><joint axis="0 1 0" range="-20 20" limited="true" solreflimit="{ref}" solimplimit="{imp}"/></default>
<worldbody><body><joint name="shoulder"/><geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
<body pos=".3 0 0"><joint name="elbow" damping=".05"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/></body>
</body></worldbody><actuator><motor joint="shoulder" gear="8"/><motor joint="elbow" gear="3"/></actuator></mujoco>"""
STRING = """<mujoco><option timestep=".002"/><worldbody><site name="hand" pos="0 0 1"/><body name="ball" pos="0 0 .8">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/><geom size=".03" mass=".2"/>
<site name="ball"/></body></worldbody><tendon><spatial name="string" limited="true" range="0 {length}"
solreflimit="{ref}"><site site="hand"/><site site="ball"/></spatial></tendon></mujoco>"""
USUAL = ".9 .95 .001"


def arm(folder: Path, ref: str = ".02 1", imp: str = USUAL) -> Scene:
    file = folder / f"{ref} {imp}.xml"
    file.write_text(ARM.format(ref=ref, imp=imp), encoding="utf-8")
    return Scene.from_mjcf(file)


def with_stops(scene: Scene, **factors: float) -> np.ndarray:
    names = [p.name for p in scene.parameters]
    theta = scene.parameter_vector()
    for group, factor in factors.items():
        theta[names.index(f"{group}.joints")] = factor
    return theta


def states(count: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Near and beyond the stops, and free."""
    rng = np.random.default_rng(0)
    return 0.36 * rng.uniform(-1, 1, (count, 2)), 3 * rng.standard_normal((count, 2)), rng.uniform(-1, 1, (count, 2))


@pytest.mark.parametrize(
    ("ref", "imp", "factors", "other_ref", "other_imp"),
    [
        (".02 1", USUAL, {"stop_time": 3.0, "stop_damping": 0.5}, ".06 .5", USUAL),
        ("-4000 -60", USUAL, {"stop_time": 2.0}, "-1000 -30", USUAL),
        ("-4000 -60", USUAL, {"stop_damping": 0.5}, "-16000 -60", USUAL),
        # A tenth of the compliance, (1 - d)/d, and the same forces: K d and B stay.
        (".02 1", ".9 .9 .001", {"stop_softness": 0.1}, f"{0.02 * 0.9 * 91 / 90!r} {(90 / 91 / 0.9) ** 0.5!r}", None),
    ],
)
def test_they_are_those_of_another_file(
    tmp_path: Path, ref: str, imp: str, factors: dict[str, float], other_ref: str, other_imp: str | None
) -> None:
    scene, other = arm(tmp_path, ref, imp), arm(tmp_path, other_ref, other_imp or f"{90 / 91!r} {90 / 91!r} .001")
    q, v, u = states()
    ours = ComplementarityModel(scene, 2, parameters=with_stops(scene, **factors)).predict(q, v, u)
    theirs = ComplementarityModel(other, 2).predict(q, v, u)
    plain = ComplementarityModel(scene, 2).predict(q, v, u)
    np.testing.assert_allclose(ours.v_next, theirs.v_next, rtol=1e-9, atol=1e-9)
    assert np.abs(ours.v_next - plain.v_next).max() > 0.05


def test_a_fitted_file_has_them(tmp_path: Path) -> None:
    scene = arm(tmp_path)
    theta = with_stops(scene, stop_time=0.3, stop_damping=2.0, stop_softness=0.2)
    written = fitted_file(scene, theta, {})
    assert written.missing == ()
    (tmp_path / "fitted.xml").write_text(written.text)
    q, v, u = states()
    own = ComplementarityModel(scene, parameters=theta).predict(q, v, u)
    read = ComplementarityModel(Scene.from_mjcf(tmp_path / "fitted.xml")).predict(q, v, u)
    np.testing.assert_allclose(own.v_next, read.v_next, atol=1e-2 * np.abs(own.v_next).max())


def test_a_string_of_another_length_and_softness(tmp_path: Path) -> None:
    """As in another file; derivatives are those of differences, and a fitted file has both."""
    (tmp_path / "string.xml").write_text(STRING.format(length=0.3, ref=".02 1"))
    scene, other = (
        Scene.from_mjcf(each) for each in (tmp_path / "string.xml", STRING.format(length=0.315, ref=".05 .6"))
    )
    at = {"stop.string": 0.015, "stop_time.tendons": 2.5, "stop_damping.tendons": 0.6}
    theta = np.array([at.get(p.name, p.nominal) for p in scene.parameters])
    rng = np.random.default_rng(0)
    angle, away = rng.uniform(-1, 1, 40), rng.uniform(0.29, 0.33, 40)
    q, v = np.column_stack([away * np.sin(angle), 0.2 - away * np.cos(angle)]), rng.standard_normal((40, 2))
    u = np.zeros((40, 0))
    model = ComplementarityModel(scene, 2, parameters=theta)
    theirs = ComplementarityModel(other, 2).predict(q, v, u).v_next
    np.testing.assert_allclose(model.predict(q, v, u).v_next, theirs, rtol=1e-9, atol=1e-9)
    assert np.abs(ComplementarityModel(scene, 2).predict(q, v, u).v_next - theirs).max() > 0.05
    smooth = ComplementarityModel(scene, 2, parameters=theta, smoothing=Barrier(1e-4), path_tolerance=1e-12)
    assert compare(smooth, q, v, u, 400)["median"] < 1e-6
    written = fitted_file(scene, theta, {})
    assert written.missing == ()
    (tmp_path / "fitted.xml").write_text(written.text)
    read = ComplementarityModel(Scene.from_mjcf(tmp_path / "fitted.xml"), 2).predict(q, v, u)
    np.testing.assert_allclose(read.v_next, theirs, rtol=1e-6, atol=1e-6)


def test_a_fit_finds_how_hard_they_are(tmp_path: Path) -> None:
    """A log in MuJoCo of an arm whose stops are five times as slow as in its file."""
    scene = arm(tmp_path)
    robot = MujocoSystem(arm(tmp_path, ".1 1").path, 5)
    rng, rows, episodes = np.random.default_rng(0), [], 8
    for episode in range(episodes):
        q, v = rng.uniform(-0.2, 0.2, 2), np.zeros(2)
        robot.reset(q, v)
        for u in np.repeat(rng.uniform(-1, 1, (8, 2)), 5, axis=0):
            after = robot.step(u)
            rows.append((q, v, u, *after, episode))
            q, v = after
    q, v, u, q_next, v_next, episode_of = (np.array(x) for x in zip(*rows, strict=True))
    log = cmbrl.Transitions(q=q, v=v, u=u, q_next=q_next, v_next=v_next, dt=0.01, episode=episode_of)
    result = cmbrl.fit(ComplementarityModel(scene, 5), log, seed=0)
    rmse = {which: result.report["loss"][f"held out, {which}"]["rmse"] for which in ("nominal", "fitted")}
    assert rmse["fitted"] < 0.05 * rmse["nominal"]
    found = result.parameters["stop_time.joints"]
    assert found.value == pytest.approx(5.0, rel=0.05)
