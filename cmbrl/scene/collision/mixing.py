"""Which geoms collide, and with which parameters, by MuJoCo's rules (its documentation, "Computation > Collision")."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from cmbrl.errors import UserError
from cmbrl.scene.collision.contact_records import ContactLaw
from cmbrl.scene.records import Array
from cmbrl.scene.source.mjcf import name_of
from cmbrl.scene.source.solref import acting, note_if_mixed
from cmbrl.scene.source.support import Gate

LEAST_FRICTION = 1e-5  #: MuJoCo's
_LEAST = 1e-6  # of the inverse weight of a free body
MOST_PAIRS = 600_000  #: a thousand bodies that may all touch each other


def collision_pairs(model: mujoco.MjModel) -> Iterator[tuple[int, int, int]]:
    """Pairs (first geom, second geom, explicit pair or -1) that pass MuJoCo's filters and can move.

    Raises UserError for more than MOST_PAIRS of them.
    """
    off = mujoco.mjtDisableBit
    if model.opt.disableflags & (off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT):
        return
    weld = model.body_weldid
    explicit = set()
    for k in range(model.npair):
        pair = sorted((int(model.pair_geom1[k]), int(model.pair_geom2[k])))
        explicit.add(tuple(pair))
        if weld[model.geom_bodyid[pair[0]]] != weld[model.geom_bodyid[pair[1]]]:
            yield pair[0], pair[1], k
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    filter_parent = not model.opt.disableflags & off.mjDSBL_FILTERPARENT
    body, types, affinity = model.geom_bodyid, model.geom_contype, model.geom_conaffinity
    welds = weld[body]
    parents = weld[model.body_parentid[welds]]
    count = len(explicit)
    for first in range(model.ngeom):
        rest = slice(first + 1, None)
        free = welds[rest] != welds[first]
        free &= ((types[first] & affinity[rest]) | (types[rest] & affinity[first])) != 0
        if filter_parent and welds[first]:
            free &= (welds[rest] == 0) | ((welds[first] != parents[rest]) & (welds[rest] != parents[first]))
        for second in (first + 1 + np.flatnonzero(free)).tolist():
            bodies = int(body[first]), int(body[second])
            if (first, second) in explicit or excluded & {bodies, bodies[::-1]}:
                continue
            count += 1
            if count > MOST_PAIRS:
                raise UserError(
                    f"more than {MOST_PAIRS} pairs of geoms may collide: leave out those that never do, by contype and "
                    "conaffinity or by <exclude>"
                )
            yield first, second, -1


@dataclass(frozen=True)
class Mixed:
    """What MuJoCo gives a contact of two geoms: condim, friction (5,), solref, solimp, and the margin that acts.

    From a gap of ``margin + gap`` on there is a contact, at which adhesion pulls.
    """

    dim: int
    friction: Array
    solref: Array
    solimp: Array
    margin: float
    gap: float


def mixed(model: mujoco.MjModel, first: int, second: int, pair: int) -> Mixed:
    """From an explicit pair, or mixed from both geoms by priority and solmix; ``pair`` is -1 without one."""
    if pair >= 0:
        dim, friction = int(model.pair_dim[pair]), model.pair_friction[pair]
        solref, solimp = model.pair_solref[pair], model.pair_solimp[pair]
        gap = model.pair_gap[pair]
        margin = model.pair_margin[pair] - (0.0 if _margins_add() else gap)
    else:
        rank = int(model.geom_priority[first]) - int(model.geom_priority[second])
        dims = model.geom_condim[first], model.geom_condim[second]
        mix = _solmix(float(model.geom_solmix[first]), float(model.geom_solmix[second]))
        if rank:
            chosen = first if rank > 0 else second
            mix, dim = float(rank > 0), int(model.geom_condim[chosen])
            friction = _friction(model.geom_friction[chosen])
        else:
            dim = int(max(dims))
            friction = _friction(np.maximum(model.geom_friction[first], model.geom_friction[second]))
        refs = model.geom_solref[first], model.geom_solref[second]
        standard = refs[0][0] > 0 and refs[1][0] > 0
        solref = mix * refs[0] + (1 - mix) * refs[1] if standard or rank else np.minimum(*refs)
        solimp = mix * model.geom_solimp[first] + (1 - mix) * model.geom_solimp[second]
        margins, gaps = model.geom_margin[[first, second]], model.geom_gap[[first, second]]
        gap = gaps.sum() if _margins_add() else gaps.max()
        margin = margins.sum() if _margins_add() else margins.max() - gap
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        solref, solimp = model.opt.o_solref, model.opt.o_solimp
        margin, friction = model.opt.o_margin, model.opt.o_friction
    return Mixed(dim, friction.copy(), solref.copy(), solimp.copy(), float(margin), float(gap))


def contact_law(model: mujoco.MjModel, first: int, second: int, pair: int, gate: Gate) -> ContactLaw:
    """The parameters of one contact, as the scene has them; the gate is told of what it has not."""
    label = pair_label(model, first, second)
    if pair >= 0 and np.any(acting(model.pair_solreffriction[pair], (0.0, 0.0))):
        gate.note("solreffriction", label, "friction uses the solref of the normal direction")
    own = mixed(model, first, second, pair)
    note_if_mixed(own.solref, "contact", label, gate)
    dim, friction = own.dim, own.friction
    if dim > 3 and "condim" in gate.ignore:
        lost = "torsional friction" if dim == 4 else "torsional and rolling friction"
        gate.refuse("condim", label, f"condim {dim} as 3: no {lost}")
        dim = 3
    ratios = [1.0, 1.0]
    for k, (least, one, other) in enumerate(((3, 0, 1), (6, 3, 4))):
        if dim < least or friction[one] == friction[other]:
            continue
        why = f"{'friction' if one == 0 else 'rolling friction'} {friction[one]:g} {friction[other]:g}"
        if not gate.drops("friction_anisotropic", label, why, "the first applies"):
            friction[[one, other]] = np.maximum(friction[[one, other]], LEAST_FRICTION)
            ratios[k] = float(friction[other] / friction[one])
    bodies = [int(model.geom_bodyid[geom]) for geom in (first, second)]
    weight = sum(inverse_weight(model, body) for body in bodies)
    reach = own.margin + (own.gap if adhesive_bodies(model).intersection(bodies) else 0.0)
    slide = float(friction[0]) if dim > 1 else 0.0
    spin, roll = (max(float(friction[k]), LEAST_FRICTION) if dim > k else 0.0 for k in (2, 3))
    return ContactLaw(
        dim, slide, acting(own.solref), own.solimp, own.margin, weight, spin, roll, reach, (ratios[0], ratios[1])
    )


def inverse_weight(model: mujoco.MjModel, body: int) -> float:
    """MuJoCo's translational inverse weight of a body [1/kg], with a floor above its own, which a solve can bear.

    It is 0 where the joints only turn the body about its centre of mass: a turntable, a wheel on a fixed axle.
    """
    weld = int(model.body_weldid[body])
    mass = float(model.body_subtreemass[weld]) if weld else 0.0
    return max(float(model.body_invweight0[body, 0]), _LEAST / mass if mass > 0 else 0.0)


def adhesive_bodies(model: mujoco.MjModel) -> set[int]:
    """Bodies that an actuator pulls towards what they touch."""
    return set(model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY, 0].tolist())


def pair_label(model: mujoco.MjModel, first: int, second: int) -> str:
    """Names of both geoms, for messages."""
    return f"{name_of(model, 'geom', first)} - {name_of(model, 'geom', second)}"


def _friction(geom: np.ndarray) -> np.ndarray:
    return geom[[0, 0, 1, 2, 2]]


def _solmix(first: float, second: float) -> float:
    tiny = mujoco.mjMINVAL
    if first >= tiny and second >= tiny:
        return first / (first + second)
    return 0.5 if first < tiny and second < tiny else float(first >= tiny)


@lru_cache(maxsize=1)
def _margins_add() -> bool:
    """Whether this MuJoCo adds two margins (since 3.9) or subtracts the gap from the larger; found by trying."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='1' margin='.25'/>"
        "<body pos='2 0 0'><freejoint/><geom size='1' margin='.5'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return bool(data.contact.includemargin[0] > 0.6)
