"""What the section says about its charts."""

TEXT = (
    "Every solver gets the same problems (M, J, free velocity, gap term, friction, compliance) and is scored by our "
    "residuals on the velocity and the impulses that it returns, never by its own flag. 'Solved' means that natural "
    "map, momentum balance and penetration of the exact Signorini-Coulomb law are all below the level. Only the solve "
    "is timed, as processor time: arrays are laid out before, answers read after; what a solver's own interface does "
    "in a call, such as factorising M, counts. 'ours', pgs and admm are this package's (pgs and admm are loops in "
    "Python: compare their iterations, not their time); 'desaxce' repeats a convex solver until the slip agrees, "
    "which is exact in the plane and with second-order cones; with daqp and proxqp in space a friction pyramid of "
    "eight edges stays, and with it its error. 'ours softened' has kappa for its tolerance: its residual is a bias "
    "that it is meant to have. One problem is left out of all counts: two rigid walls that overlap have no solution."
)
CAPTIONS = {
    "work_precision.png": (
        "Time against residual on the exact law",
        "Median microseconds of a solve, one problem at a time, against the 90th percentile of the residual (largest "
        "of natural map, momentum balance, penetration) over the problems of a family; each curve is a sweep of the "
        "tolerance. Full lines aim at the exact law, dashed ones at the convex relaxation, the dotted one at our "
        "softened law. In the grey band an answer is worth nothing.",
    ),
    "profile.png": (
        "Performance profiles",
        "Share of all feasible problems that a solver brings below the level, against the time it takes relative to "
        "the fastest solver of that problem. What is missing at the right edge has failed; the legend counts it.",
    ),
    "relaxed.png": (
        "The relaxation on its own law",
        "As above, but for what the convex relaxation asks: no power between impulse and velocity, momentum balance, "
        "no penetration. Through qpsolvers and cvxpy the time includes what these add to a call.",
    ),
    "kappa.png": (
        "What kappa costs and buys",
        "Our softened law on a point mass: bias of a resting one and largest second derivative of the impulse, "
        "measured (markers) and in closed form (lines).",
    ),
    "gradients.png": (
        "Differentiable rivals",
        "One vector-Jacobian product with dv'/dv_free: time against error to the exact derivative of the law that "
        "each one solves. Full markers: exact law or round cones; hollow: friction pyramids of the relaxation. The "
        "softened curve is judged by the hard law: its error is the bias of kappa.",
    ),
}
