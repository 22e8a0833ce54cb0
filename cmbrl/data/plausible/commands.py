"""Commands against motion: swapped joints, a wrong sign, saturation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbrl.data.plausible.answers import ROWS, Responses, hidden, of_noise, responses, slowly, steered
from cmbrl.data.plausible.finding import Finding
from cmbrl.data.plausible.motion import LAG, Motion

SATURATED = 0.2  #: share of samples at a limit that is worth a warning
FOLLOWS = 0.5  #: correlation of a position with its target
NEAR_BEST = 0.1  #: of a correlation: joints that move alike follow each other's targets as well
SIGNIFICANT = 10.0  #: standard errors
_ALSO = 3.0  # the same of positions alone
_LATE, _MORE = (1, 2, 3), 2.0  # samples that a command may act late by; times as surely as the wrong way
_LIGHTER = 5.0  # times lighter than by the file
LONG = 5 * LAG  #: [s] of shorter logs every trend follows every other at some lag


def servos(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Positions that follow another target than their own, or follow it backwards."""
    best, worst, slope = answers
    if len(motion.now) < ROWS or len(motion.now) * motion.dt < LONG:
        return
    best = np.nan_to_num(best)  # no joint follows a target that rests
    own, count = np.diagonal(best), len(motion.drivers)
    for a in range(count):
        for b in range(a + 1, count):
            across = min(best[a, b], best[b, a])
            if across > 0.5 and max(own[a], own[b]) < across - 0.3 and _mutual(best, a, b):
                yield _pair(motion, a, b)
    for m in range(count):
        if -worst[m, m] > 0.5 and best[m, m] < 0.4 * -worst[m, m] and -2.0 < slope[m, m] < -0.4:
            yield Finding(
                f"{motion.position_of(motion.drivers[m].coordinate)} moves against {motion.command_of(m)} (correlation "
                f"{worst[m, m]:.2f}): a sign error; negate one of the two columns"
            )


def _mutual(best: np.ndarray, a: int, b: int) -> bool:
    """Whether two joints follow each other's targets as well as they follow any, and these targets move no other more.

    In a gait all joints move in one rhythm, and each follows many targets at some lag.
    """
    pairs = ((a, b), (b, a))
    return all(best[i, j] > max(best[i].max(), best[:, j].max()) - NEAR_BEST for i, j in pairs)


def _pair(motion: Motion, a: int, b: int) -> Finding:
    first, second = (motion.coordinates[motion.drivers[m].coordinate].name for m in (a, b))
    return Finding(
        f"{motion.command_of(a)} explains the motion of joint {second!r}, and {motion.command_of(b)} that of joint "
        f"{first!r}, better than their own: {motion.kind} or {motion.command} of the two are swapped"
    )


def forces(motion: Motion, answers: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Iterator[Finding]:
    """Joints that accelerate against their force, or by that of another joint.

    Accelerations answer to forces by the inverse of the inertia, averaged over poses and contacts. That is positive
    definite whatever the masses are. So its diagonal is positive, and the product of what two joints answer to each
    other's forces is smaller than that of what they answer to their own. A light joint under a stiff servo is where it
    was told to be within a step, and its acceleration shows the other joints' forces instead of its own: two servos are
    swapped only if each joint also follows the other's target more than its own.

    A controller that damps brakes the more the faster a joint is. What the logged velocity has by noise is then no part
    of the command, but of the acceleration, and both look opposed. So a fault has to remain without what noise does,
    and nothing is told where noise is most of what is left. Nor is it of a robot that stands on its feet by commands
    that answer to its state: there the floor pushes back, and joints move with or against their torques by chance.

    Where a command acts some samples late, what the last step tells of it may be most of what it does: over SLOW joints
    move by it all the same.
    """
    chosen = [m for m, driver in enumerate(motion.drivers) if not driver.position or motion.v_now is not None]
    best = np.nan_to_num(answers[0])
    follows = np.diagonal(best) > FOLLOWS  # a servo that does so is told by ``servos``
    told = chosen and not (motion.stands and steered(motion, chosen))
    fitted = responses(motion, chosen) if told else None
    if fitted is None:
        return
    loud = hidden(motion, chosen, fitted[3])
    swapped, wrong = _faults(motion, chosen, best, follows, fitted)
    swapped, wrong = [x for x in swapped if not loud[list(x)].any()], [i for i in wrong if not loud[i]]
    if swapped or wrong:
        without = fitted[0] - 2.0 * of_noise(motion, chosen), *fitted[1:]  # noise may be most of what a command tells
        remain = _faults(motion, chosen, best, follows, without)
        swapped, wrong = [x for x in swapped if x in remain[0]], [x for x in wrong if x in remain[1]]
    slow = slowly(motion, chosen) if wrong else np.zeros((1, len(chosen)))
    yield from (_pair(motion, chosen[i], chosen[j]) for i, j in swapped)
    for i in wrong:
        m, ratio = chosen[i], fitted[0][i, i] / fitted[1][i, i]
        joint = motion.coordinates[motion.drivers[m].coordinate].name
        light = abs(fitted[0][i, i]) > _LIGHTER * motion.drivers[m].push * motion.dt
        if motion.v_now is None and slow[0, i] > -SIGNIFICANT:  # over few samples a coarse encoder tells its counts
            continue
        if (light and slow[:, i].max() > max(_ALSO, -slow[:, i].min())) or _later(motion, chosen, i) > -_MORE * ratio:
            continue
        sure = not light or bool(slow[0, i] < -_ALSO)
        cause = "; negate one of the two columns" if sure else "? Or does the torque answer to noise? The fit decides"
        yield Finding(
            f"{motion.command_of(m)} pushes joint {joint!r} the wrong way ({ratio:.0f} standard errors): a sign error "
            f"in {motion.command}, or in its positions{cause}",
            sure=sure,
        )


def _later(motion: Motion, chosen: list[int], i: int) -> float:
    """How surely, in standard errors, joint ``i`` moves by its own command some samples late."""
    found = [responses(motion.later(by), chosen) for by in _LATE]
    return max((float(one[0][i, i] / one[1][i, i]) for one in found if one is not None), default=0.0)


def _faults(
    motion: Motion, chosen: list[int], best: np.ndarray, follows: np.ndarray, fitted: Responses
) -> tuple[list[tuple[int, int]], list[int]]:
    """Pairs of ``chosen`` drivers that are swapped, by place, and those whose force acts the wrong way."""
    gain, error, spread, rest = fitted  # (joint, command); (joint, command); (command,); (joint,)

    def servos_alone(a: int, b: int) -> bool:
        return motion.drivers[a].position and motion.drivers[b].position

    def prefer_each_other(a: int, b: int) -> bool:
        return bool(min(best[a, b] - best[b, b], best[b, a] - best[a, a]) > 0.0)

    size = gain * spread  # change that a usual command makes
    sure = np.abs(gain) > SIGNIFICANT * error
    swapped = [
        (i, j)
        for i in range(len(chosen))
        for j in range(i + 1, len(chosen))
        if sure[i, j] and sure[j, i] and min(gain[i, j], gain[j, i]) > 0
        and gain[i, j] * gain[j, i] > 1.1 * abs(gain[i, i] * gain[j, j])
        and (not servos_alone(chosen[i], chosen[j]) or prefer_each_other(chosen[i], chosen[j]))
    ]  # fmt: skip
    wrong = [
        i for i, m in enumerate(chosen)
        if sure[i, i] and size[i, i] < -0.3 * rest[i] and not swapped and not follows[m]
    ]  # fmt: skip
    return swapped, wrong


def saturation(motion: Motion) -> Iterator[Finding]:
    """A warning for commands that often are at the limit, where they tell little."""
    shares = {}
    for m, driver in enumerate(motion.drivers):
        if np.isfinite([driver.low, driver.high]).all() and driver.high > driver.low:
            u, room = motion.u[:, m], 1e-6 * (driver.high - driver.low)
            shares[m] = float(np.mean((u <= driver.low + room) | (u >= driver.high - room)))
    often = [m for m, share in shares.items() if share > SATURATED]
    if often:
        worst = max(often, key=shares.__getitem__)
        low, high = motion.drivers[worst].low, motion.drivers[worst].high
        more = f" (and {len(often) - 1} more)" if len(often) > 1 else ""
        yield Finding(
            f"{motion.command_of(worst)}{more} is at or beyond its limits {low:g} and {high:g} in {shares[worst]:.0%} "
            "of the samples: saturated, such rows tell little about the motor",
            sure=False,
        )
