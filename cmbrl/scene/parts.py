"""What a compiled robot consists of: every element is read, and simplified to the plane of motion if there is one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from cmbrl.scene.collision.candidate_table import CandidateTable, merge_points
from cmbrl.scene.collision.contact_records import Candidate
from cmbrl.scene.collision.contacts import ContactBuilder
from cmbrl.scene.collision.glide import with_moving_surfaces
from cmbrl.scene.collision.shapes import Shape, read_shape
from cmbrl.scene.forces.actuators import Actuator, read_actuators
from cmbrl.scene.forces.fluid import Box, oblique_box, read_boxes
from cmbrl.scene.forces.fluid_ellipsoids import Ellipsoid, read_ellipsoids
from cmbrl.scene.forces.joint_forces import Compensation, force_ranges, read_compensation
from cmbrl.scene.forces.linkages import Linkage
from cmbrl.scene.forces.springs import check_joints
from cmbrl.scene.forces.tendons import lines_of, obstacle_of_tendons, read_tendons
from cmbrl.scene.forces.ties import obstacle_of_ties, read_ties
from cmbrl.scene.laws import LawChoice
from cmbrl.scene.records import Tendon, Tie, Tree
from cmbrl.scene.reduction import PlaneOfMotion, find_plane, oblique_pyramid, obstacle_to_plane, project
from cmbrl.scene.source.mjcf import name_of, read_tree
from cmbrl.scene.source.robot_source import Compiled
from cmbrl.scene.source.support import Gate


@dataclass(frozen=True)
class Parts:
    """What a robot consists of, in the plane of motion if there is one."""

    tree: Tree
    plane: PlaneOfMotion | None
    why: str  # the tree moves in a plane, or does not
    contacts: ContactBuilder
    candidates: CandidateTable
    merged: int  # points that were left out because others are at the same place
    grounds: list[Shape]
    still: bool  # surfaces that move are taken to stand
    tendons: list[Tendon]
    ties: list[Tie]
    actuators: list[Actuator]
    linkages: list[Linkage]
    boxes: list[Box]
    ellipsoids: list[Ellipsoid]
    ranges: dict[str, Any]
    compensation: Compensation


def read_parts(compiled: Compiled, gate: Gate, reduce: bool, self_contact: str, law: LawChoice) -> Parts:
    """Reads all elements of the file; raises UserError for those that are not modelled and not ignored."""
    model = compiled.model
    check_joints(model, gate)
    tree = read_tree(model)
    boxes = read_boxes(model, tree, gate)
    ellipsoids = [] if "fluid" in gate.ignore else read_ellipsoids(model, tree)
    plane, why = find_plane(tree, np.asarray(model.opt.gravity)) if reduce else (None, "reduction is off")
    if plane and (oblique := oblique_box(tree, plane, boxes)):
        plane, why = None, oblique
    if plane and ellipsoids:
        plane, why = None, "the fluid lifts ellipsoids"
    normal = plane.axis if plane else None
    mujocos = law.name == "mujoco"  # a model may take it as MuJoCo has it, or with round cones: one scene suits both
    contacts = ContactBuilder(model, tree, normal, gate, plane is not None, mujocos, not reduce, self_contact)
    contacts.build()
    tendons = read_tendons(model, tree, gate)
    lines = lines_of(model, tendons)
    ties = read_ties(model, tree, lines, gate)
    actuators, linkages = read_actuators(model, tree, lines, gate)
    ranges = force_ranges(model, gate)
    compensation = read_compensation(model, tree, gate)
    gate.close()
    pyramids = mujocos and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    if plane and (obstacle := _obstacle(model, tree, plane, contacts.candidates, pyramids, tendons, linkages, ties)):
        plane, why = None, obstacle
        again = Gate(gate.ignore, gate.file)
        contacts = ContactBuilder(model, tree, normal, again, self_contact=self_contact)  # with rims
        contacts.build()
    candidates = [project(tree, plane, c) for c in contacts.candidates] if plane else contacts.candidates
    table, merged = CandidateTable(candidates), 0
    if reduce:
        table, merged = merge_points(table)
    geoms = np.unique(table.geoms[table.on_plane, 1]).tolist()
    grounds = [read_shape(model, geom, tree.frames) for geom in geoms]
    return Parts(
        tree,
        plane,
        why,
        contacts,
        table,
        merged,
        grounds,
        "surface_velocity" in gate.ignore,
        tendons,
        ties,
        actuators,
        linkages,
        boxes,
        ellipsoids,
        ranges,
        compensation,
    )


def _obstacle(
    model: mujoco.MjModel,
    tree: Tree,
    plane: PlaneOfMotion,
    candidates: list[Candidate],
    pyramids: bool,
    tendons: list[Tendon],
    linkages: list[Linkage],
    ties: list[Tie],
) -> str | None:
    """Why what acts on a planar tree needs spatial algebra, naming the first; None if nothing does."""
    if linkages:
        return f"{linkages[0].name} acts along no joint or tendon"
    moving = with_moving_surfaces(model)
    for c in candidates:
        for geom in c.geoms:
            if moving[geom]:
                return f"the surface of {name_of(model, 'geom', geom)} moves"
    for c in candidates:
        names = " - ".join(name_of(model, "geom", geom) for geom in c.geoms)
        if c.law.ratios != (1.0, 1.0):
            return f"friction has a direction ({names})"
        up = read_shape(model, c.geoms[1], tree.frames).rot[:, 2] if c.kind.on_plane else None
        if reason := obstacle_to_plane(tree, plane, c, up):
            return f"{reason} ({names})"
        if pyramids and c.law.dim > 1 and oblique_pyramid(tree, plane, c, up):
            return f"a pyramid of friction is oblique to the plane of motion ({names})"
    return obstacle_of_tendons(tree, plane, tendons) or obstacle_of_ties(tree, plane, ties)
