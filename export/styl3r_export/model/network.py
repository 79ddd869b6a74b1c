"""Styl3R: the dual-branch network, structure and appearance (paper section 3; spec section 1)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.adapter import (
    CameraHead,
    Geometry,
    Pose,
    colours_from_sh,
    free_geometry,
    log_depth,
    log_error_of,
    pose_of_motion,
    ray_geometry,
    seen_from,
)
from styl3r_export.model.backbone import Backbone
from styl3r_export.model.config import CONFIGS, PATCH, ModelConfig
from styl3r_export.model.dpt import STRUCTURE_CHANNELS, GaussianTrunk, Head, PointTrunk
from styl3r_export.model.edges import snap
from styl3r_export.model.flow import Flows
from styl3r_export.model.matching import StarMatching
from styl3r_export.model.refinement import refine
from styl3r_export.model.stem import Pyramid
from styl3r_export.model.strokes import Strokes
from styl3r_export.model.stylizer import TokenStylizer


class StructureOutput(NamedTuple):
    """What the structure branch gives for the N views of one scene (one Gaussian a pixel)."""

    means: Float[Tensor, "views H W 3"]
    scales: Float[Tensor, "views H W 3"]
    rotations: Float[Tensor, "views H W 4"]
    opacities: Float[Tensor, "views H W"]
    content_tokens: Float[Tensor, "views tokens dim"]


class Content(NamedTuple):
    """The content encoder's output for a batch of scenes."""

    tokens: Float[Tensor, "batch views tokens dim"]
    pyramid: Pyramid | None  # the stem's maps, (batch * views) first


class RayDecoding(NamedTuple):
    """What a network with points on rays knows before it makes Gaussians; training reads it."""

    depth: Float[Tensor, "batch views H W"]  # along the view's z axis
    pose: Pose
    decoded: Float[Tensor, "batch views H W"]  # the depth before it was pulled to the matches
    log_error: Float[Tensor, "batch views H W"]  # log of that depth's expected relative error
    guessed: Pose  # before the decoded depths were matched
    trust: Float[Tensor, "batch views"]  # in [0, 1]: whether the view's camera was found
    flows: Flows
    hooks: tuple[Tensor, ...]  # (batch * views, patches, dim) each


class Structure(NamedTuple):
    """The structure branch's Gaussians, and how they came about where points lie on rays."""

    geometry: Geometry
    rays: RayDecoding | None


# Correction of log depth, and log of its relative error (20 %), before any training.
UNTRAINED_DEPTH = (0.0, -1.6)
# Opacity logit, raw scales and quaternion of the Gaussians before any training: opacity 0.95,
# standard deviation 0.56 px.
UNTRAINED_STRUCTURE = (3.0, -1.0, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0)


@torch.no_grad()
def zero_output(head: Head, bias: float | tuple[float, ...]) -> None:
    """Make a head's output the given constants, whatever comes in."""
    last = head.get_submodule("dpt.head.4")
    assert isinstance(last, nn.Conv2d)
    assert last.bias is not None
    last.weight.zero_()
    last.bias.copy_(torch.as_tensor(bias).expand_as(last.bias))


def to_network(images: Tensor) -> Tensor:
    """Pictures in [0, 1] to the content encoder's [-1, 1]."""
    return images * 2 - 1


class Styl3r(nn.Module):
    """Photos without poses and style pictures to stylized 3D Gaussians."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        rays = config.points == "rays"
        self.backbone = Backbone(config)
        self.downstream_head1 = Head(PointTrunk(config, 2 if rays else 3))
        self.gaussian_param_head = Head(GaussianTrunk(config, STRUCTURE_CHANNELS, with_image=True))
        if rays:  # depth along a view's own rays is the same task for every view
            self.matching = StarMatching(config)
            self.camera_head = CameraHead(config.decoder_dim)
        else:
            self.downstream_head2 = Head(PointTrunk(config, 3))
            self.gaussian_param_head2 = Head(
                GaussianTrunk(config, STRUCTURE_CHANNELS, with_image=True)
            )
        if config.colours == "strokes":
            self.strokes = Strokes(config.smooth_strokes)
        else:
            self.token_stylizer = TokenStylizer(config)
            self.gaussian_appearance_head = Head(GaussianTrunk(config, 3, with_image=False))
        if rays:  # untrained heads: the matches' depths, opaque Gaussians the size of a pixel
            zero_output(self.downstream_head1, UNTRAINED_DEPTH)
            zero_output(self.gaussian_param_head, UNTRAINED_STRUCTURE)

    # ------------------------------------------------------------------ one scene (public)

    def structure(
        self, images: Float[Tensor, "views 3 H W"], intrinsics: Float[Tensor, "views 3 3"]
    ) -> StructureOutput:
        """Geometry of one scene, and the content tokens that `appearance` needs.

        Args:
            images: 2 to 8 views, sRGB in [0, 1]; H and W multiples of 16.
            intrinsics: normalised by width and height.

        Returns:
            Gaussians in the first view's frame (OpenCV axes), and content tokens.

        Raises:
            ValueError: fewer than two views, or a side that is no multiple of 16.
        """
        if images.shape[0] < 2:
            raise ValueError("at least 2 views are needed, got 1")
        check_sides(images)
        if self.config.points == "rays":
            return self._around_the_middle(images, intrinsics)
        content = self.encode(images[None], intrinsics[None])
        out = self.decode_structure(content, images[None], intrinsics[None])
        means, scales, rotations, opacities = (t.squeeze(0) for t in out.geometry)
        return StructureOutput(means, scales, rotations, opacities, content.tokens.squeeze(0))

    def _around_the_middle(self, images: Tensor, intrinsics: Tensor) -> StructureOutput:
        """The middle view matched with all others, then everything moved to the first's frame.

        Photos of one place come in the order of a walk, more or less, and the middle one shares
        most with the others: of four views the depths are a sixth better than around the first.
        """
        order, back = middle_first(images)
        images, intrinsics = images[order][None], intrinsics[order][None]
        content = self.encode(images, intrinsics)
        out = self.decode_structure(content, images, intrinsics)
        assert out.rays is not None
        geometry = seen_from(out.geometry, out.rays.pose, back[:1])
        means, scales, rotations, opacities = (t.squeeze(0)[back] for t in geometry)
        tokens = content.tokens.squeeze(0)[back]
        return StructureOutput(means, scales, rotations, opacities, tokens)

    def appearance(
        self,
        content_tokens: Float[Tensor, "views tokens dim"],
        style_images: Float[Tensor, "styles 3 h w"],
        style_weights: Float[Tensor, " styles"],
        images: Float[Tensor, "views 3 H W"],
    ) -> Float[Tensor, "views H W 3"]:
        """Colours (sRGB) of one scene's Gaussians.

        Args:
            content_tokens: from `structure`.
            style_images: paintings in [0, 1]; a content photo standing in for a style in
                [-1, 1] (spec section 7).
            style_weights: weights of the styles' tokens, summing to 1.
            images: the views again, sRGB in [0, 1] (the published colour head does not read
                their values, only their size).

        Raises:
            ValueError: a side that is no multiple of 16.
        """
        check_sides(images)
        check_sides(style_images)
        colours = self.decode_appearance(
            content_tokens[None], style_images[None], style_weights[None], images[None]
        )
        return colours.squeeze(0)

    # ------------------------------------------------------------------ batches of scenes

    def encode(
        self,
        images: Float[Tensor, "batch views 3 H W"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> Content:
        """Content tokens of every view; images in [0, 1]."""
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        maps = to_network(images).flatten(0, 1)
        pyramid = None
        if self.config.stem == "pyramid":
            pyramid = self.backbone.stem(maps)
            maps = pyramid.eighth
        tokens = self.backbone.encode(maps, intrinsics.flatten(0, 1), rows, columns)
        return Content(tokens.unflatten(0, images.shape[:2]), pyramid)

    def decode_structure(
        self,
        content: Content,
        images: Float[Tensor, "batch views 3 H W"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> Structure:
        """Geometry of a batch of scenes."""
        if self.config.points == "rays":
            return self._ray_structure(content, images, intrinsics)
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        hooks, _ = self.backbone.decode(content.tokens, rows, columns)
        pictures = to_network(images)
        points = self._per_view(self.downstream_head1, self.downstream_head2, hooks, rows, columns)
        params = self._per_view(
            self.gaussian_param_head, self.gaussian_param_head2, hooks, rows, columns, pictures
        )
        return Structure(free_geometry(points, params), None)

    def decode_rays(
        self,
        content: Content,
        images: Float[Tensor, "batch views 3 H W"],
        intrinsics: Float[Tensor, "batch views 3 3"],
        refined_too: bool = True,
    ) -> RayDecoding:
        """Depth, confidence and cameras of a network whose points lie on rays.

        Without `refined_too` depths and cameras stay as decoded: all that their losses need.
        """
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        assert content.pyramid is not None
        maps = content.pyramid.eighth.unflatten(0, images.shape[:2])
        tokens, pairs = self.matching(maps, to_network(images), intrinsics)
        hooks, camera = self.backbone.decode(content.tokens, rows, columns, tokens)
        flat = tuple(h.flatten(0, 1) for h in hooks)
        raw = self.downstream_head1(flat, rows, columns, content.pyramid)
        raw = raw.unflatten(0, images.shape[:2])
        # What the matches triangulate is the start; the head corrects it and draws its edges.
        coarse = F.interpolate(pairs.log_depth, scale_factor=8, mode="bilinear")
        depth, log_error = log_depth(raw[:, :, 0] + coarse).exp(), log_error_of(raw[:, :, 1])
        guess = self.camera_head(camera, pairs.motion)
        # What refinement changes is a constant to training: the gradient of a bundle adjustment
        # is far larger than anything else where views hardly move.
        motion, refined, trust = guess, depth, torch.ones_like(depth[..., 0, 0])
        if refined_too:
            with torch.no_grad():
                motion, refined, trust = refine(guess, depth, log_error, pairs.sides)
                refined = snap(refined, motion, images, intrinsics)
            refined = depth * (refined / depth).detach()
        batch = images.shape[0]
        return RayDecoding(
            refined, pose_of_motion(motion, batch), depth, log_error,
            pose_of_motion(guess, batch), trust, pairs.flows, flat,
        )  # fmt: skip

    def _ray_structure(self, content: Content, images: Tensor, intrinsics: Tensor) -> Structure:
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        rays = self.decode_rays(content, images, intrinsics)
        pictures = to_network(images).flatten(0, 1)
        params = self.gaussian_param_head(rays.hooks, rows, columns, pictures, content.pyramid)
        params = params.unflatten(0, images.shape[:2])
        geometry = ray_geometry(rays.depth, params, intrinsics, rays.pose)
        # A view in the wrong place would be a second, shifted copy of the scene: it fades away.
        faded = geometry.opacities * rays.trust[..., None, None]
        return Structure(geometry._replace(opacities=faded), rays)

    @staticmethod
    def _per_view(
        first: Head,
        rest: Head,
        hooks: tuple[Tensor, ...],
        rows: int,
        columns: int,
        images: Tensor | None = None,
    ) -> Float[Tensor, "batch views channels H W"]:
        """The first view through its own head, the others through theirs."""
        batch, views = hooks[0].shape[:2]
        extra = () if images is None else (images[:, 0],)
        out0 = first(tuple(h[:, 0] for h in hooks), rows, columns, *extra)
        extra = () if images is None else (images[:, 1:].flatten(0, 1),)
        out = rest(tuple(h[:, 1:].flatten(0, 1) for h in hooks), rows, columns, *extra)
        out = out.unflatten(0, (batch, views - 1))
        return _cat_views(out0, out)

    def decode_appearance(
        self,
        content_tokens: Float[Tensor, "batch views tokens dim"] | None,
        style_images: Float[Tensor, "batch styles 3 h w"],
        style_weights: Float[Tensor, "batch styles"],
        images: Float[Tensor, "batch views 3 H W"],
    ) -> Float[Tensor, "batch views H W 3"]:
        """Colours of a batch of scenes; "strokes" need no tokens."""
        if self.config.colours == "strokes":
            colours = self.strokes(images, style_images, style_weights).movedim(2, -1)
            # What leaves sRGB's range every viewer would clamp in a way of its own.
            return colours if self.training else colours.clamp(0, 1)
        assert content_tokens is not None
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        style, rope = self.token_stylizer.encode(style_images.flatten(0, 1))
        style = style.unflatten(0, style_images.shape[:2])
        style = (style * style_weights[:, :, None, None]).sum(dim=1)
        hooks = self.token_stylizer.decode(content_tokens, style, rope, rows, columns)
        raw = self.gaussian_appearance_head(tuple(h.flatten(0, 1) for h in hooks), rows, columns)
        return colours_from_sh(raw.unflatten(0, images.shape[:2]))


def check_sides(images: Float[Tensor, "batch 3 height width"]) -> None:
    """Make sure that pictures divide into patches; a remainder would be dropped silently."""
    height, width = images.shape[-2:]
    if height % PATCH or width % PATCH:
        raise ValueError(f"sides must be multiples of {PATCH}, got {height} x {width}")


def middle_first(views: Float[Tensor, "views ..."]) -> tuple[Tensor, Tensor]:
    """Indices that bring the middle view to the front, and those that undo it."""
    index = torch.arange(views.shape[0], device=views.device)
    # A tensor, since in a traced graph the number of views is not known.
    middle = torch.div(index[-1:], 2, rounding_mode="floor")
    order = torch.where(index <= middle, index - 1, index)
    order = torch.where(index == 0, middle, order)
    back = torch.where(index < middle, index + 1, index)
    return order, torch.where(index == middle, index * 0, back)


def _cat_views(first: Tensor, rest: Tensor) -> Tensor:
    """(batch, ...) and (batch, views - 1, ...) to (batch, views, ...)."""
    return torch.cat((first[:, None], rest), dim=1)


def build(config: str | ModelConfig = "full") -> Styl3r:
    """The network in eval mode, with torch's random initial weights.

    Args:
        config: "full" (the published sizes), "mini", or a configuration.

    Raises:
        ValueError: the name is not a known configuration.
    """
    if isinstance(config, str):
        if config not in CONFIGS:
            raise ValueError(f"no configuration {config!r}; there are {', '.join(CONFIGS)}")
        config = CONFIGS[config]
    return Styl3r(config).eval()
