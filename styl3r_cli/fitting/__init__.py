"""Colours that make drawn Gaussians look like given pictures: rendering as least squares."""
