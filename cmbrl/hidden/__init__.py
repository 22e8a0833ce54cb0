"""Robots that are not those of their file, for any task whose real system is MuJoCo: what would a fit be worth?

``cmbrl train walker2d@payload:3`` names draw 3 of a family of hidden systems. Policies and logs meet that robot, and
models still start from the file. Families are "parameters", "payload", "floor" (:mod:`.changes`) and "outside", what no
file tells (:mod:`.flaws`).
"""
