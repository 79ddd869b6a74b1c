"""Photos and a painting become stylized 3D Gaussians: the runtime, free of torch."""

__version__ = "0.1.0"
