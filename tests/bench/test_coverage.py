"""The study of intervals: a small fit of a hidden robot, and the shares in its tables."""

from cmbrl.bench.studies.coverage.cells import CHOSEN_ON, FIRST_DRAW, QUICK, cell
from cmbrl.bench.studies.coverage.study import by_family, by_group
from cmbrl.bench.studies.hidden.plan import FLOOR


def test_a_fit_is_judged_by_the_truth_of_its_robot():
    found = cell("hopper", FLOOR, FIRST_DRAW, QUICK)
    softness = next(p for p in found["parameters"] if p["name"] == "softness_time.foot_geom")
    assert 0.01 < softness["truth"] < softness["nominal"] == 0.02
    assert all(p["holds"] == (p["low"] <= p["truth"] <= p["high"]) for p in found["parameters"])
    assert found["fitted"] > len(found["parameters"]) > 10
    assert FIRST_DRAW not in CHOSEN_ON


def test_shares_by_family_and_group():
    def parameter(group, holds):
        return {"name": f"{group}.a", "group": group, "nominal": 2.0, "low": 1.0, "high": 3.0, "holds": holds}

    def fit(scene, shares):
        parameters = [parameter(group, k < held) for group, held in shares.items() for k in range(5)]
        return {"scene": scene, "family": FLOOR, "draw": 0, "seconds": 4.0, "parameters": parameters}

    cells = [fit("hopper", {"mass": 5, "friction": 3}), fit("cheetah", {"mass": 4, "friction": 5})]
    rows = [dict(zip(by_family(cells).columns, row, strict=True)) for row in by_family(cells).rows]
    assert [(row["robot"], row["fits"], row["hold the truth"]) for row in rows] == [
        ("hopper", 1, 0.8), ("cheetah", 1, 0.9), ("all", 2, 0.85),
    ]  # fmt: skip
    assert (rows[2]["of contacts"], rows[2]["of the rest"], rows[2]["by fit"]) == (0.8, 0.9, "0.80, 0.90")
    assert rows[2]["median half-width / file"] == 0.5
    assert by_group(cells).rows == [[FLOOR, "friction", 10, 0.8], [FLOOR, "mass", 10, 0.9]]
