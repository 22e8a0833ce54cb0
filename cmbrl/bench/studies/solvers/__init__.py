"""Contact solvers on the same problems: speed against residual, and derivatives against the exact one."""
