"""Policy gradients through contact: bias, variance and cost of every estimator."""
