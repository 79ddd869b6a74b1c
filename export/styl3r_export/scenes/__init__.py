"""Procedural training scenes: photographs with exact cameras and depth."""

from styl3r_export.scenes.generate import SceneViews, generate
from styl3r_export.scenes.textures import TextureBank

__all__ = ["SceneViews", "TextureBank", "generate"]
