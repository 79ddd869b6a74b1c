"""A scene with its cameras, given one style after another; colours that survive being drawn."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.pipeline import Repairs, Scene, Stylizer, assemble

if TYPE_CHECKING:  # they bring numba, which takes a while
    from styl3r_cli.compaction import Compaction, Compactor
    from styl3r_cli.fitting.views import ViewsFit
    from styl3r_cli.overlaps import Overlaps

# Shapes of merged Gaussians are left as they are: fitting them takes as long again.
RESHAPES = 0
# How much strokes are sharpened before they are drawn, over their difference from a blur of
# EMPHASIS_BLUR pixels. Fitting sharpens on its own. Of 0.8, 1.2 and 1.6, on 32 pairs and 28 fours
# of real photos: style is nearest with 1.2 (by 5 % of the distance), frames agree better the less
# there is (by 5 % a step, in every scene). Strokes that are not fitted get as much more as before.
FITTED_EMPHASIS, PLAIN_EMPHASIS = 1.0, 1.3
EMPHASIS_BLUR = 1.0  # standard deviation, about that of a Gaussian on the screen


class Painter:
    """Colours for one scene, fitted to what its views should look like.

    A model whose colours are pictures says what each view should show. Drawn, that picture is
    blurred: Gaussians are wider than a pixel, and two views of one surface lie in two layers, one
    over the other. And each view is painted for itself, so that one surface has other strokes in
    each. The painter lays Gaussians on the surfaces as discs, brings the views' tones together,
    takes one view's Gaussians and strokes for a surface, sharpens the strokes as much as drawing
    blurs them, and solves for the colours whose drawing comes closest to the pictures of all views
    (a frame is linear in the colours). What does not depend on the style is worked out once.

    Example:
        >>> painter = Painter(stylizer, *locate_views(scene, photos))
        >>> gaussians, repairs = painter([load_style(path).image])
    """

    def __init__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        recovered: Recovered,
        threads: int | None = None,
        fitted: bool = True,
    ) -> None:
        """Get ready; nothing is computed yet.

        Args:
            stylizer: the model that encoded the scene.
            scene: from its `encode`.
            recovered: the views' cameras. A view whose camera was not found is not fitted to.
            threads: None for every core.
            fitted: whether to fit at all.

        Colours of a model that trained them through a renderer are always left as they are.
        """
        self.stylizer, self.scene, self.recovered = stylizer, scene, recovered
        self.threads = threads
        self.pictures = stylizer.model.paints_pictures
        self.fitted = fitted and self.pictures

    def __call__(
        self,
        styles: Sequence[FloatArray] = (),
        weights: Sequence[float] | None = None,
        strength: float = 1.0,
    ) -> tuple[Gaussians, Repairs]:
        """The scene in a style; arguments and errors as `Stylizer.colours`.

        One Gaussian a pixel, without those that repeat what another view shows.
        """
        colours = self.stylizer.colours(self.scene, styles, weights, strength)
        finite = bool(np.isfinite(colours).all())
        if self.pictures and finite:
            colours = self._together(colours, strength)
        gaussians, repairs = self._assemble(colours)
        if self.fitted and finite:
            gaussians = self._fit.apply(gaussians, colours, strength)
        return gaussians, repairs

    def _together(self, pictures: FloatArray, strength: float) -> FloatArray:
        """The views' pictures, (N, H, W, 3), as those of one scene."""
        from styl3r_cli.harmony import harmonised

        pictures = harmonised(pictures, self._overlaps)
        if not strength:  # resampling would blur photos
            return pictures
        pictures = self._overlaps.paint_once(pictures, strength)
        amount = FITTED_EMPHASIS if self.fitted else PLAIN_EMPHASIS
        return emphasised(pictures, strength * amount)

    def compact(self, gaussians: Gaussians, decibels: float) -> Compaction:
        """As few Gaussians as show a style, that this gave, to so many decibels.

        Measured from the views and halfway between them. The scene is looked at once for all of
        its styles, from its views once for fitting and compacting.

        Args:
            gaussians: from `__call__`.
            decibels: PSNR against all of them, from the camera that differs most.
        """
        from styl3r_cli.compaction import Compactor, witnesses

        compactor = self._compactor
        if len(gaussians) == len(compactor.known.scene):
            return compactor.keep_decibels(gaussians.colours, decibels)
        cameras = witnesses(self.recovered.cameras, gaussians)  # some had no finite colour
        compactor = Compactor(gaussians, cameras, self.threads, reshapes=RESHAPES)
        return compactor.keep_decibels(gaussians.colours, decibels)

    @cached_property
    def _compactor(self) -> Compactor:
        from styl3r_cli.compaction import Compactor, witnesses

        plain, _ = self._assemble(self.scene.images.transpose(0, 2, 3, 1))
        traced = self._fit.traced if self.fitted else []
        cameras = witnesses(self.recovered.cameras, plain)
        return Compactor(plain, cameras, self.threads, traced, reshapes=RESHAPES)

    @cached_property
    def _overlaps(self) -> Overlaps:
        from styl3r_cli.overlaps import Overlaps

        return Overlaps(self.scene, self.recovered)

    @cached_property
    def pixels(self) -> NDArray[np.bool_]:
        """(N, H, W), whose Gaussians the scene consists of."""
        if not self.pictures:
            return np.ones(self.scene.opacities.shape, np.bool_)
        return self._overlaps.kept

    @cached_property
    def _geometry(self) -> Scene:
        """The scene as discs on its surfaces, each as opaque as all that it stands for."""
        from styl3r_cli.surfels import surfels

        opacities = self._overlaps.opacities(self.scene.opacities)
        return replace(surfels(self.scene, self.recovered), opacities=opacities)

    def _assemble(self, colours: FloatArray) -> tuple[Gaussians, Repairs]:
        """The scene's Gaussians in these colours, (N, H, W, 3), each surface's once."""
        if not self.pictures:
            return assemble(self.scene, colours)
        return assemble(self._geometry, colours, self.pixels)

    @cached_property
    def _fit(self) -> ViewsFit:
        from styl3r_cli.fitting.views import ViewsFit

        # Any colours would do to begin with.
        plain, _ = self._assemble(self.scene.images.transpose(0, 2, 3, 1))
        visible = self.scene.opacities > 0
        return ViewsFit(plain, self.recovered, self._overlaps.own, visible, self.threads)


def emphasised(pictures: FloatArray, amount: float) -> FloatArray:
    """Pictures (N, H, W, 3) with what is finer than EMPHASIS_BLUR louder by `amount`.

    An unsharp mask; values stay within [0, 1].
    """
    import cv2

    blurred = [cv2.GaussianBlur(picture, (0, 0), EMPHASIS_BLUR) for picture in pictures]
    detail = pictures - np.asarray(blurred, np.float32)
    return np.clip(pictures + np.float32(amount) * detail, 0, 1)


def warm_up(compact: bool = False) -> None:
    """Load the compiled code of fitting in a thread, while the network is being read and run.

    Also that of compacting, if it will be used. That takes half a second (and some more the first
    time, when it is compiled). Whatever goes wrong with it goes wrong again, and is reported, where
    the code is used.
    """

    def load() -> None:
        from styl3r_cli.cameras.camera import Camera

        one, three = np.ones(1, np.float32), np.ones((1, 3), np.float32)
        dot = Gaussians(three, three, np.ones((1, 4), np.float32), one, three)
        camera = Camera(np.eye(4), 1.0, 1.0, 0.5, 0.5, 1, 1)
        with suppress(Exception):
            from styl3r_cli.fitting.tracing import look
            from styl3r_cli.fitting.views import fitted

            fitted(dot, look(dot, [camera], 1), [(three, one[:, None])], 1)
        if compact:
            with suppress(Exception):
                from styl3r_cli.compaction import Compactor

                dots = dot.select(np.zeros(3, np.intp))
                compactor = Compactor(dots, [camera], 1, reshapes=RESHAPES)
                compactor.keep_count(dots.colours, 2)

    threading.Thread(target=load, name="warm up").start()
