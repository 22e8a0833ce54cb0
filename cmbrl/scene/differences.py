"""What a scene models in another way than MuJoCo, in words and with its size, for ``cmbrl info``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.collision.candidate_table import CandidateTable
from cmbrl.scene.collision.contact_records import ContactKind, When
from cmbrl.scene.collision.height_fields import field_differences
from cmbrl.scene.collision.shapes import hull_points, hull_vertices
from cmbrl.scene.collision.stand_ins import StandIn
from cmbrl.scene.forces.force_laws import ForceLaw, read_force_law
from cmbrl.scene.forces.gyro import gyro_arrays
from cmbrl.scene.forces.tendons import armature_of, force_range
from cmbrl.scene.records import Array, LeftOut, Tendon
from cmbrl.scene.source.mjcf import early, limits_act, name_of

_MESH = mujoco.mjtGeom.mjGEOM_MESH
_HINGE, _SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
_SHAPES = {int(kind): kind.name.removeprefix("mjGEOM_").lower() for kind in mujoco.mjtGeom.__members__.values()}
_MESH_POINTS = 4  # of MuJoCo's contact between a mesh and a plane
_ROUNDS = 300  # of Frank-Wolfe
_FLAT_SIDE = 1e-5  # of a mesh's size: how far points of one side may be apart; MuJoCo keeps vertices as floats
_FLAT_TILT = 1e-3  # [rad] of a rim; the core's kFlat
_RIM_ERROR = 0.18 * _FLAT_TILT  # of the radius: the most that the point of a nearly flat rim is too high


def differences(
    model: mujoco.MjModel,
    candidates: CandidateTable,
    stand_ins: Mapping[int, StandIn],
    tendons: list[Tendon],
    contact_law: str,
    integrator: str,
    boxes: int = 0,
) -> tuple[LeftOut, ...]:
    """Approximations of shapes, then differences of the laws; nothing that the file does not use.

    ``boxes``: how many bodies feel the drag of a fluid.
    """
    drag = [LeftOut("fluid", "drag", "that of the file's masses and inertias, whatever a fit makes of them")]
    return (
        *_shapes(model, candidates),
        *_stand_ins(model, candidates, stand_ins),
        *_boxes(model, candidates),
        *_laws(model, candidates, contact_law),
        *_limits(model),
        *_tendons(model, tendons, integrator),
        *_stepping(model, integrator, contact_law),
        *_solver(model, contact_law),
        *(drag if boxes else []),
    )


def _firsts(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where each different row of natural numbers comes first, in this order."""
    columns = rows.shape[1] if rows.ndim > 1 else 1
    keys = rows.reshape(len(rows), columns) @ (1 + int(rows.max(initial=0))) ** np.arange(columns)
    return np.sort(np.unique(keys, return_index=True)[1])


def _shapes(model: mujoco.MjModel, candidates: CandidateTable) -> Iterator[LeftOut]:
    on_plane = np.flatnonzero(candidates.on_plane)
    read: dict[int, tuple[float, int]] = {}  # of meshes, which many geoms may have
    for row in _firsts(candidates.geoms[on_plane, 0]):
        geom, dimension = int(candidates.geoms[on_plane[row], 0]), len(candidates.candidates[on_plane[row]].pos_a)
        name, mesh = name_of(model, "geom", geom), int(model.geom_dataid[geom])
        if model.geom_type[geom] != _MESH:
            continue
        when = " where rows look ahead" if dimension == 3 else ""
        if mesh not in read:
            read[mesh] = hull_error(model, mesh), flat_side(model, mesh)
        error, most = read[mesh]
        if error > 0:
            count, kept = len(hull_vertices(model, mesh)), len(hull_points(model, mesh))
            outside = f"others lie up to {_millimetres(error)} outside"
            why = f"it touches by {kept} of its hull's {count} vertices{when}; {outside}"
            yield LeftOut("mesh", name, why)
        if most > _MESH_POINTS:
            why = (
                f"a flat side touches with {most} points{when}; in MuJoCo with at most {_MESH_POINTS}, which are softer"
            )
            yield LeftOut("mesh", name, why)
    grounds = candidates.geoms[:, 1]
    yield from field_differences(model, grounds[_firsts(grounds)].tolist(), candidates)
    rims = candidates.geoms[candidates.rows(ContactKind.RIM_PLANE), 0]
    for geom in rims[_firsts(rims)].tolist():
        tilt, depth = 1e3 * _FLAT_TILT, _millimetres(_RIM_ERROR * model.geom_size[geom, 0])
        low = f"tilted by less than {tilt:g} mrad it may sink in by {depth}"
        why = f"where rows look ahead, it stands on feet inside its rim; {low}"
        yield LeftOut("cylinder", name_of(model, "geom", geom), why)
    segments = candidates.rows(ContactKind.SEGMENT_SEGMENT)
    acting = np.column_stack([candidates.geoms[segments], candidates.when[segments]])
    for *geoms, acts in acting[_firsts(acting)].tolist():
        why = "one point of contact; MuJoCo has two where capsules lie side by side"
        if np.any(model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_BOX):
            why = "each edge of the box touches by itself, near a corner two or three; MuJoCo has one or two points"
            why = f"where rows look ahead: {why}" if acts == When.AHEAD else why
        yield LeftOut("capsules", " - ".join(name_of(model, "geom", geom) for geom in geoms), why)


def _stand_ins(
    model: mujoco.MjModel, candidates: CandidateTable, stand_ins: Mapping[int, StandIn]
) -> Iterator[LeftOut]:
    touching: dict[int, set[int]] = {}
    as_it_is = candidates.on_plane | (candidates.kind == ContactKind.HULLS)
    acting = np.column_stack([candidates.geoms, candidates.when])[~as_it_is]
    acting = np.concatenate([acting[:, [0, 2]], acting[:, [1, 2]]])
    for geom, when in acting[_firsts(acting)].tolist():
        touching.setdefault(geom, set()).add(when)
    for geom, found in stand_ins.items():
        stands_in = touching.get(geom, set()) - {When.CLOSED}
        if not stands_in:
            continue
        kind = _SHAPES[int(model.geom_type[geom])]
        where = "" if When.ALWAYS in stands_in else "where rows look ahead, "
        why = f"{where}touches other shapes as a {found.shape.kind}, which errs by up to {_millimetres(found.error)}"
        yield LeftOut(kind, name_of(model, "geom", geom), why)


def _boxes(model: mujoco.MjModel, candidates: CandidateTable) -> Iterator[LeftOut]:
    pairs, touching = candidates.pairs[0], candidates.pairs_of(candidates.rows(ContactKind.HULLS))[0]
    geoms_of = np.sort(pairs[np.all(model.geom_type[pairs] == mujoco.mjtGeom.mjGEOM_BOX, axis=1)], axis=1)
    hulls = {*map(tuple, np.sort(touching, axis=1).tolist())}
    for geoms in map(tuple, geoms_of[_firsts(geoms_of)].tolist()):
        if geoms in hulls:
            why = "where rows look ahead, corners do, edges that cross act once closed"
        else:
            why = "corners touch sides; edges that cross do not touch"
        yield LeftOut("boxes", " - ".join(name_of(model, "geom", geom) for geom in geoms), why)


def _laws(model: mujoco.MjModel, candidates: CandidateTable, contact_law: str) -> Iterator[LeftOut]:
    if contact_law != "mujoco" or not any(law.dim > 1 for law in candidates.laws):
        return
    if model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        why = (
            "round instead of the file's pyramid, with the softness that the pyramid has while it sticks; the pyramid "
            "itself with sliding 'convex'"
        )
        yield LeftOut("friction", "cone", why)
    why = (
        "MuJoCo's normal force grows with the speed of sliding, up to a hop; here it does not (exact Coulomb), unless "
        "a model has sliding 'convex'"
    )
    yield LeftOut("friction", "sliding", why)


def _limits(model: mujoco.MjModel) -> Iterator[LeftOut]:
    """Ranges whose ends are so near that both act at once in MuJoCo."""
    of_joints = (model.jnt_limited != 0) & np.isin(model.jnt_type, (_HINGE, _SLIDE)), model.jnt_range, model.jnt_margin
    of_tendons = model.tendon_limited != 0, model.tendon_range, model.tendon_margin
    for kind, (limited, ends, margin) in (("joint", of_joints), ("tendon", of_tendons)):
        for k in np.flatnonzero(limited & (ends[:, 1] - ends[:, 0] < 2 * margin)) if limits_act(model) else ():
            why = "its range is shorter than two margins, and both ends act at once; here the nearer one does"
            yield LeftOut(f"{kind} limit", name_of(model, kind, int(k)), why)


def _tendons(model: mujoco.MjModel, tendons: list[Tendon], integrator: str) -> Iterator[LeftOut]:
    """Of tendons with a force range, and of those over several branches.

    Terms between branches are not in MuJoCo's mass matrix.
    """
    for tendon in tendons:
        if integrator != "euler" and np.isfinite(force_range(model, tendon.source)[0]):
            why = "where its force range clamps, velocity gains end; in MuJoCo they damp on"
            yield LeftOut("tendon", tendon.name, why)
        chain, dof = set(), tendon.dofs[-1]
        while dof >= 0:
            chain.add(dof)
            dof = int(model.dof_parentid[dof])
        if chain.issuperset(tendon.dofs):
            continue
        driven = model.actuator_trnid[model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON, 0] == tendon.source
        damped = integrator != "euler" and (model.tendon_damping[tendon.source] or np.any(driven))
        if armature_of(model, tendon.source) or damped:
            why = "its armature and implicit damping couple branches of the tree too; MuJoCo leaves those terms out"
            yield LeftOut("tendon", tendon.name, why)


def _stepping(model: mujoco.MjModel, integrator: str, contact_law: str) -> Iterator[LeftOut]:
    if integrator == "rk4":
        why = (
            "by default stepped by leapfrog or midpoint (second order), where velocity gains and damping act at the "
            "next velocity: 2 to 9 times as fast, and off by what `cmbrl check` tells; a model or fit with "
            "integrator='rk4' takes MuJoCo's steps"
        )
        yield LeftOut("integrator", "RK4", why)
        return
    of_mujoco = f"at steps longer than {model.opt.timestep:g} s, or where damping is very strong and rows look ahead, "
    when = of_mujoco if contact_law == "mujoco" else ""
    laws = [read_force_law(model, k) for k in range(len(model.actuator_trntype))]
    servos = integrator == "implicit" and any(isinstance(law, ForceLaw) and law.bias[2] for law in laws)
    if np.any(model.dof_damping) or servos:
        why = f"{when}damping is implicit in the contact solve too; MuJoCo adds it afterwards"
        yield LeftOut("integrator", integrator, why)
    if gyro_arrays(model)["ngyro"]:
        why = f"{when}Coriolis, centrifugal and gyroscopic forces are explicit"
        yield LeftOut("integrator", integrator, why)


def _solver(model: mujoco.MjModel, contact_law: str) -> Iterator[LeftOut]:
    if contact_law == "mujoco" and (told := early(model.opt)):
        yield LeftOut("iterations", "solver", f"{told}; here contacts and limits are solved to the end")


def flat_side(model: mujoco.MjModel, mesh: int) -> int:
    """The most kept vertices of a mesh that lie in one face of its hull; 0 if MuJoCo has not kept its faces."""
    graph = int(model.mesh_graphadr[mesh])
    if graph < 0:
        return 0
    vertices, faces = (int(x) for x in model.mesh_graph[graph : graph + 2])
    start = graph + 2 + 3 * vertices + 3 * faces  # after edge addresses, vertex numbers and edges
    corners = model.mesh_graph[start : start + 3 * faces].reshape(-1, 3) + model.mesh_vertadr[mesh]
    a, b, c = np.asarray(model.mesh_vert[corners], dtype=np.float64).transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    kept = hull_points(model, mesh)
    height = kept @ normal.T - np.sum(a * normal, axis=1)
    return int((np.abs(height) < _FLAT_SIDE * np.ptp(kept)).sum(axis=0).max(initial=0))


def _millimetres(length: float) -> str:
    return f"{float(f'{1e3 * length:.2g}'):g} mm"


def hull_error(model: mujoco.MjModel, mesh: int) -> float:
    """Largest distance [m] of a vertex of a mesh's hull from the hull of the vertices that are kept, from above.

    Within one per cent: Frank-Wolfe iterations for the nearest points of the vertices that may still be the farthest.
    """
    points, kept = hull_vertices(model, mesh), hull_points(model, mesh)
    if len(points) == len(kept):
        return 0.0
    nearest: Array = np.repeat(kept.mean(axis=0)[None], len(points), axis=0)
    upper = np.zeros(0)
    for _ in range(_ROUNDS):
        away = points - nearest
        support = kept[np.argmax(away @ kept.T, axis=1)]
        upper = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
        lower = (
            np.sum(away * (points - support), axis=1) / upper
        )  # to the plane across the way there that bounds the hull
        if upper.max() <= 1.01 * lower.max():
            break
        far = upper >= lower.max()
        points, nearest, away, towards = points[far], nearest[far], away[far], (support - nearest)[far]
        length = np.maximum(np.sum(towards**2, axis=1), 1e-300)
        nearest = nearest + np.clip(np.sum(away * towards, axis=1) / length, 0.0, 1.0)[:, None] * towards
    return float(upper.max())
