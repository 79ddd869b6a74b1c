"""From files to the images and intrinsics that the graphs read."""

from styl3r_cli.photos.expand import expand
from styl3r_cli.photos.load import MAX_VIEWS, MIN_VIEWS, Photos, Style, load_photos, load_style

__all__ = ["MAX_VIEWS", "MIN_VIEWS", "Photos", "Style", "expand", "load_photos", "load_style"]
