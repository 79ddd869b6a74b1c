"""What each stage trains, on what, and by which losses."""

from __future__ import annotations

import torch
from torch import Tensor

from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.geometry import WEIGHTS, flow_losses, geometry_losses
from styl3r_export.model import Styl3r
from styl3r_export.model.network import to_network

# Parts that the geometry stage leaves alone: it makes neither Gaussians nor colours.
APPEARANCE = ("token_stylizer.", "gaussian_appearance_head.", "strokes.")
ATTRIBUTES = ("gaussian_param_head.",)
# What finds matches, before anything decodes them; decoders read the stem's maps too.
FLOW = ("matching.flow.",)
MATCHES = ("backbone.stem.", *FLOW)
# What draws in a style's code.
DRAWING = ("strokes.content_encoder.", "strokes.decoder.")
# Present in every checkpoint, used by nothing.
UNUSED = ("mask_token", "refinenet4.resConfUnit1")


def used(name: str) -> bool:
    """Whether any output depends on the parameter."""
    return not any(part in name for part in UNUSED)


def geometry_trains(name: str) -> bool:
    """Everything that depth, cameras and matches depend on."""
    return used(name) and not name.startswith(APPEARANCE + ATTRIBUTES)


def decoders_train(name: str) -> bool:
    """The geometry without its matches."""
    return geometry_trains(name) and not name.startswith(MATCHES)


def matches_train(name: str) -> bool:
    """What finds matches, and nothing that decodes them."""
    return used(name) and name.startswith(MATCHES)


def flow_trains(name: str) -> bool:
    """What finds matches, without the maps that decoders read too."""
    return used(name) and name.startswith(FLOW)


def novel_views_train(name: str) -> bool:
    """The geometry and the Gaussians' other attributes; colours are the photos' own."""
    return used(name) and not name.startswith(APPEARANCE)


def attributes_train(name: str) -> bool:
    """Opacities, scales and rotations alone."""
    return used(name) and name.startswith(ATTRIBUTES)


def geometry_step(model: Styl3r, batch: Batch) -> dict[str, Tensor]:
    """Weighted losses of one batch of the geometry stage."""
    content = model.encode(batch.images, batch.intrinsics)
    out = model.decode_rays(content, batch.images, batch.intrinsics, refined_too=False)
    with torch.autocast(batch.images.device.type, enabled=False):
        losses = geometry_losses(out, batch)
    return weighted(losses)


def matches_step(model: Styl3r, batch: Batch) -> dict[str, Tensor]:
    """The geometry stage's losses of the matches alone: nothing decodes them."""
    pictures = to_network(batch.images)
    maps = model.backbone.stem(pictures.flatten(0, 1)).eighth.unflatten(0, pictures.shape[:2])
    flows = model.matching.both_flows(maps, pictures)
    with torch.autocast(batch.images.device.type, enabled=False):
        losses = flow_losses(flows, batch)
    return weighted(losses)


def weighted(losses: dict[str, Tensor]) -> dict[str, Tensor]:
    """Losses times their weights."""
    return {name: WEIGHTS[name] * value for name, value in losses.items()}


def appearance_trains(name: str) -> bool:
    """The appearance branch; the content encoder and all of the structure stay as they are."""
    return used(name) and name.startswith(APPEARANCE)


def drawing_trains(name: str) -> bool:
    """What draws strokes; what styles are to it stays as it is."""
    return used(name) and name.startswith(DRAWING)
