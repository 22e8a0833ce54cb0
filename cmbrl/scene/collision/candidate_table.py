"""Contact candidates as columns: a scene may have millions, and loops over them would take minutes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import chain
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from cmbrl.scene.collision.contact_records import ON_PLANE, Candidate, ContactKind, ContactLaw
from cmbrl.scene.records import Array

Numbers = NDArray[np.int64]


class CandidateTable:
    """The ``candidates`` of a scene, in order, with what they have in columns of n = len(candidates) rows."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = candidates
        self.kind = self._integers("kind")  # of ContactKind
        self.when = self._integers("when")  # of When
        self.geoms = self._pairs("geoms")  # (n, 2) of the file
        self.bodies = np.column_stack([self._integers("body_a"), self._integers("body_b")])
        self.radii = np.column_stack([self._doubles("radius_a"), self._doubles("radius_b")])
        self.weight = self._doubles("weight")
        self.laws: list[ContactLaw]  #: each once
        self.laws, self.law = self._shared("law")  # and the number of each candidate's, (n,)

    def __len__(self) -> int:
        return len(self.candidates)

    @cached_property
    def on_plane(self) -> NDArray[np.bool_]:
        """(n,) whether they are of a shape and a plane of the world."""
        return np.isin(self.kind, [int(kind) for kind in ON_PLANE])

    @cached_property
    def pairs(self) -> tuple[Numbers, Numbers]:
        """Pairs of geoms (m, 2) as they come, and the number of each candidate's."""
        return self.pairs_of(np.arange(len(self)))

    def pairs_of(self, rows: Numbers) -> tuple[Numbers, Numbers]:
        """Of some candidates only."""
        most = int(self.geoms.max(initial=0)) + 1
        _, first, which = np.unique(self.geoms[rows] @ [most, 1], return_index=True, return_inverse=True)
        order = np.argsort(first)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        return self.geoms[rows[first[order]]], rank[which]

    def of_laws(self, field: str) -> Array:
        """A number or a row of numbers of each candidate's law."""
        values = np.array([getattr(law, field) for law in self.laws], dtype=np.float64)
        return values[self.law]

    def vectors(self, field: str, shape: tuple[int, ...]) -> Array:
        """(n, *shape) of a field whose arrays are shared by candidates."""
        if not self.candidates:
            return np.zeros((0, *shape))
        arrays, which = self._shared(field)
        return np.asarray(np.array(arrays, dtype=np.float64)[which])

    def rows(self, kind: ContactKind) -> Numbers:
        """Those of a kind, rising."""
        return np.flatnonzero(self.kind == kind)

    def _shared(self, field: str) -> tuple[list, Numbers]:
        """The objects of a field, each once, and the number of each candidate's."""
        values = list(map(attrgetter(field), self.candidates))
        _, first, which = np.unique(
            np.fromiter(map(id, values), dtype=np.int64, count=len(values)), return_index=True, return_inverse=True
        )
        return [values[k] for k in first], which

    def _integers(self, field: str) -> Numbers:
        return np.fromiter(map(attrgetter(field), self.candidates), dtype=np.int64, count=len(self.candidates))

    def _pairs(self, field: str) -> Numbers:
        values = chain.from_iterable(map(attrgetter(field), self.candidates))
        return np.fromiter(values, dtype=np.int64, count=2 * len(self.candidates)).reshape(-1, 2)

    def _doubles(self, field: str) -> Array:
        return np.fromiter(map(attrgetter(field), self.candidates), dtype=np.float64, count=len(self.candidates))


def merge_points(table: CandidateTable) -> tuple[CandidateTable, int]:
    """Merges coinciding candidates of a pair of geoms, adding their weights; returns them and the number removed.

    Those of hulls stay: they are places for what touches.
    """
    candidates = table.candidates
    size = len(candidates[0].pos_a) if candidates else 0
    where = np.hstack([table.vectors(field, (size,)) for field in ("pos_a", "axis_a", "pos_b", "axis_b")])
    turned = (table.kind == ContactKind.DISC_PLANE)[:, None] * table.vectors("along", (3,))
    where = np.hstack([where, turned, table.radii[:, :1]])
    where = np.hstack([np.round(where, 9) + 0.0, table.kind[:, None], table.when[:, None]])
    mixed = table.pairs[1] + np.zeros(len(candidates))  # a number that coinciding ones have in common
    for column, factor in zip(where.T, np.sqrt(np.arange(2, 2 + where.shape[1])), strict=True):
        mixed = mixed * 1.0009765625 + column * factor
    _, which, count = np.unique(mixed, return_inverse=True, return_counts=True)
    doubtful = np.flatnonzero((count[which] > 1) & (table.kind != ContactKind.HULLS))
    first: dict[tuple[object, ...], int] = {}
    weight, kept = table.weight.copy(), np.ones(len(candidates), dtype=bool)
    for k in doubtful.tolist():
        key = candidates[k].geoms, *where[k].tolist()
        if (same := first.setdefault(key, k)) != k:
            weight[same] += weight[k]
            kept[k] = False
    if kept.all():
        return table, 0
    merged = list(candidates)
    for k in np.flatnonzero(kept & (weight != table.weight)).tolist():
        merged[k] = merged[k]._replace(weight=float(weight[k]))
    return CandidateTable([merged[k] for k in np.flatnonzero(kept).tolist()]), int(len(kept) - kept.sum())
