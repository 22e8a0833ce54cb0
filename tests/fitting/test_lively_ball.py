"""A ball that bounces high: its contact's damping ratio is a twentieth of the file's."""

import mujoco
import numpy as np

import cmbrl

BALL = """<mujoco><option timestep="0.002"/><worldbody><geom name="floor" type="plane" size="5 5 .1" {soft}/>
  <body name="ball" pos="0 0 1"><joint type="slide" axis="0 0 1"/><geom type="sphere" size=".06" mass=".2" {soft}/>
  </body></worldbody></mujoco>"""
STEPS, PER = 120, 50


def _thrown(heights: np.ndarray) -> cmbrl.Transitions:
    """What MuJoCo sees of balls of stiffness 4000 and damping 6, per kilogram, a sample every .01 s."""
    model = mujoco.MjModel.from_xml_string(BALL.format(soft='solref="-4000 -6"'))
    model.opt.timestep = 0.01 / PER
    states = np.empty((len(heights), STEPS + 1, 2))
    for episode, height in zip(states, heights, strict=True):
        data = mujoco.MjData(model)
        data.qpos[0] = height - 1.0
        for row in episode:
            row[:] = data.qpos[0], data.qvel[0]
            mujoco.mj_step(model, data, PER)
    q, v = states[..., :1], states[..., 1:]
    rows = {"q": q[:, :-1], "v": v[:, :-1], "q_next": q[:, 1:], "v_next": v[:, 1:]}
    episode = np.repeat(np.arange(len(heights)), STEPS)
    return cmbrl.Transitions(
        **{name: x.reshape(-1, 1) for name, x in rows.items()}, u=np.empty((len(episode), 0)), episode=episode, dt=0.01
    )


def test_a_fit_finds_how_high_a_ball_bounces() -> None:
    model = cmbrl.ComplementarityModel(cmbrl.Scene.from_mjcf(BALL.format(soft="")))
    rng = np.random.default_rng(0)
    log, other = _thrown(rng.uniform(0.4, 1.2, 12)), _thrown(rng.uniform(0.4, 1.2, 6))
    fit = cmbrl.fit(model, log, groups=["softness_time", "softness_damping"], horizon=10)
    assert 0.03 < fit.parameters["softness_damping.ball_geom0"].value < 0.08  # 3 / sqrt(4000)
    q = np.array([other.q[::STEPS], other.v[::STEPS]])
    errors = []
    for tried in (model.for_log(0.01), fit.model):
        a, b = q
        for _ in range(STEPS):
            step = tried.predict(a, b, np.empty((len(a), 0)))
            a, b = step.q_next, step.v_next
        errors.append(float(np.abs(a - other.q_next[STEPS - 1 :: STEPS]).mean()))
    assert errors[1] < 0.3 * errors[0]
