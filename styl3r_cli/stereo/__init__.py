"""Depths from what views see of each other: plane sweeps, semi-global matching, cross-checks."""
