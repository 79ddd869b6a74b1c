"""The splat renderer's differentiable twins in torch: a clear one and a fast one."""

from styl3r_export.splatting.fast import splat

__all__ = ["splat"]
