"""The viewer's page: viser serves it, with the scenes, the input cameras and what to click."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.address import Address
from styl3r_cli.viewer.origins import own_pages_only
from styl3r_cli.viewer.splats import least_scales, to_splats
from styl3r_cli.viewer.start import View, first_view, vertical_fov, view_of

if TYPE_CHECKING:
    import viser

# The keys move by 2 units a second, and nothing nearer than 0.01 is drawn: viser is made for
# rooms in metres. In those, what a scene's first camera looks at is this far away.
METRES = 4.0
FARTHEST = 1e5  # metres from the camera; viser's 1000 would cut off some skies
FRUSTUM = 0.06  # an input camera's size, as a share of the first one's depth
FRUSTUM_COLOUR = (255, 190, 60)  # seen on bright and on dark scenes
LINE = 2.0  # pixels
HELP = """\
**Drag** to turn, with the right button to shift, **wheel** to go nearer.
**W A S D Q E** and arrow keys walk. **Click an input camera** to see through it.
"""


@contextmanager
def serving(
    scenes: Mapping[str, Gaussians], cameras: Sequence[Camera], address: Address
) -> Iterator[str]:
    """Serve the page for as long as the context lasts.

    Args:
        scenes: one or two by name; the first is shown at first, and decides about distances.
        cameras: the input views; the page starts at the first one.
        address: a free one.

    Yields:
        Where a browser on this machine finds the page.

    Raises:
        UsageError: this version of viser could be talked to by any web site.
    """
    import rich
    import viser

    rich.get_console().quiet = True  # viser prints to standard output, which is for results
    # A browser that goes away half-way is no event; the library would print tracebacks.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    with own_pages_only(address.private):
        server = viser.ViserServer(host=address.host, port=address.port, verbose=False)
    try:
        first = next(iter(scenes.values()))
        start = first_view(first, cameras)
        Page(server, METRES / start.depth, start).fill(scenes, cameras, first)
        yield address.url(server.get_port())
    finally:
        server.stop()


class Page:
    """What is on the page.

    Attributes:
        server: viser's.
        metres: a scene unit in viser's units.
        start: the first view.
    """

    def __init__(self, server: viser.ViserServer, metres: float, start: View) -> None:
        self.server, self.metres, self.start = server, metres, start

    def fill(
        self, scenes: Mapping[str, Gaussians], cameras: Sequence[Camera], first: Gaussians
    ) -> None:
        """Put everything on it."""
        self.server.request_share_url = _no_tunnel  # type: ignore[method-assign]
        self.server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_width="small"
        )
        self.server.gui.set_panel_label("styl3r view")
        # Black, as `styl3r render` has it; transparent parts look the same.
        self.server.scene.set_background_image(np.zeros((1, 1, 3), np.uint8), format="png")
        self._set_start()
        self._add_scenes(scenes)
        self._add_cameras(cameras, first)
        self.server.gui.add_markdown(HELP)

    def _set_start(self) -> None:
        self.server.scene.set_up_direction(self.start.up)
        camera = self.server.initial_camera
        camera.position = self.start.position * self.metres
        camera.look_at = self.start.look_at * self.metres
        camera.up = self.start.up
        camera.fov = self.start.fov
        camera.far = FARTHEST

    def _add_scenes(self, scenes: Mapping[str, Gaussians]) -> None:
        nodes = {}
        for index, (name, gaussians) in enumerate(scenes.items()):
            splats = to_splats(gaussians, least_scales(gaussians, self.start))
            nodes[name] = self.server.scene.add_gaussian_splats(
                f"/scene_{index}",
                splats.centers,
                splats.covariances,
                splats.rgbs,
                splats.opacities,
                scale=splats.scale * self.metres,
                visible=index == 0,
            )
        if len(nodes) < 2:
            return
        choice = self.server.gui.add_button_group("Scene", list(nodes))

        @choice.on_click
        def _(_event: object) -> None:
            with self.server.atomic():
                for name, node in nodes.items():
                    node.visible = name == choice.value

    def _add_cameras(self, cameras: Sequence[Camera], first: Gaussians) -> None:
        if not cameras:
            return
        size = FRUSTUM * self.start.depth * self.metres
        frusta = [self._add_frustum(i, camera, size) for i, camera in enumerate(cameras)]
        for frustum, camera in zip(frusta, cameras, strict=True):
            self._look_when_clicked(frustum, view_of(camera, first, self.start.up), frusta)
        shown = self.server.gui.add_checkbox("Input cameras", initial_value=False)

        @shown.on_update
        def _(_event: object) -> None:
            for frustum in frusta:
                frustum.visible = shown.value

    def _add_frustum(self, index: int, camera: Camera, size: float) -> viser.CameraFrustumHandle:
        return self.server.scene.add_camera_frustum(
            f"/cameras/{index}",
            vertical_fov(camera),
            camera.width / camera.fx * camera.fy / camera.height,  # of angles: pixels may be oblong
            scale=size,
            thickness=LINE,
            thickness_units="screen",
            variant="filled",  # of lines alone, only the lines could be clicked
            color=FRUSTUM_COLOUR,
            wxyz=poses.from_camera(camera)[:4],
            position=poses.centre(camera.extrinsics) * self.metres,
            visible=False,
        )

    def _look_when_clicked(
        self,
        frustum: viser.CameraFrustumHandle,
        view: View,
        frusta: Sequence[viser.CameraFrustumHandle],
    ) -> None:
        @frustum.on_click
        def _(event: viser.SceneNodePointerEvent) -> None:
            with self.server.atomic():
                for each in frusta:  # one's faces would tint what is seen through it
                    each.visible = each is not frustum
            self._look(event.client.camera, view)

    def _look(self, camera: viser.CameraHandle, view: View) -> None:
        with camera.client.atomic():
            camera.up_direction = view.up
            camera.position = view.position * self.metres
            camera.look_at = view.look_at * self.metres
            camera.fov = view.fov


def _no_tunnel(verbose: bool = True) -> None:
    """In place of viser's public address for a page, which anything in a browser can ask for."""
