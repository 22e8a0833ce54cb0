"""Learners on short windows of many episodes: what SHAC and FOPG share."""
