"""Cameras: the type, their recovery from point maps, camera files, camera paths."""
