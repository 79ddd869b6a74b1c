"""A contact sheet: for each scene its views in a row, then view 0's depth."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.generate import SceneViews, generate
from styl3r_export.scenes.textures import TextureBank

#: Scenes side by side on a sheet.
COLUMNS = 3


def depth_picture(depth: NDArray[np.float32], sky: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Inverse depth in colours (BGR), sky black."""
    inverse = 1 / depth
    low, high = np.percentile(inverse, [2, 98])
    codes = np.clip((inverse - low) / max(high - low, 1e-9) * 255, 0, 255).astype(np.uint8)
    picture = cv2.applyColorMap(codes, cv2.COLORMAP_TURBO)
    picture[sky] = 0
    return picture


def _row(scene: SceneViews) -> NDArray[np.uint8]:
    codes = (scene.images.transpose(0, 2, 3, 1)[..., ::-1] * 255 + 0.5).astype(np.uint8)
    return np.concatenate([*codes, depth_picture(scene.depth[0], scene.sky[0])], 1)


def write_sheet(
    path: Path, count: int, seed: int, views: int, size: tuple[int, int], textures: TextureBank,
    kind: str | None = None,
) -> None:  # fmt: skip
    """Generate scenes and write the sheet as PNG."""
    rows = [_row(generate(seed + k, views, size, textures, kind)) for k in range(count)]
    rows += [np.zeros_like(rows[0])] * (-count % COLUMNS)
    lines = [np.concatenate(rows[k : k + COLUMNS], 1) for k in range(0, len(rows), COLUMNS)]
    cv2.imwrite(str(path), np.concatenate(lines))
