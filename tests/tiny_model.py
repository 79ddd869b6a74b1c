"""A model small enough to read: its geometry and colours are known in closed form."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from styl3r_cli import manifest as manifests

if TYPE_CHECKING:
    import onnx

# View n sees the world from (BASELINE * n, 0, 0), looking along z. A pixel's depth is
# 2 + its photo's brightness, so that the point maps are neither flat nor the same everywhere.
BASELINE = 0.25
STRUCTURE_GRAPH = """
<ir_version: 10, opset_import: ["" : 18]>
structure (float[N,3,H,W] images, float[N,3,3] intrinsics)
  => (float[N,H,W,3] means, float[N,H,W,3] scales, float[N,H,W,4] rotations,
      float[N,H,W] opacities, float[N,L,3] content_tokens)
{
  zero = Constant <value_int = 0> ()
  one = Constant <value_int = 1> ()
  views = Shape <start = 0, end = 1> (images)
  view_count = Squeeze (views)
  height = Shape <start = 2, end = 3> (images)
  row_count = Squeeze (height)
  width = Shape <start = 3, end = 4> (images)
  column_count = Squeeze (width)
  half = Constant <value_float = 0.5> ()
  view_range = Range (zero, view_count, one)
  view_float = Cast <to = 1> (view_range)
  baseline = Constant <value_float = BASELINE> ()
  shift = Mul (view_float, baseline)
  column_axes = Constant <value_ints = [1, 2]> ()
  shift_x = Unsqueeze (shift, column_axes)
  row_range = Range (zero, row_count, one)
  row_float = Cast <to = 1> (row_range)
  row_centre = Add (row_float, half)
  rows = Cast <to = 1> (row_count)
  v_flat = Div (row_centre, rows)
  v_axes = Constant <value_ints = [0, 2]> ()
  v = Unsqueeze (v_flat, v_axes)
  column_range = Range (zero, column_count, one)
  column_float = Cast <to = 1> (column_range)
  column_centre = Add (column_float, half)
  columns = Cast <to = 1> (column_count)
  u_flat = Div (column_centre, columns)
  u_axes = Constant <value_ints = [0, 1]> ()
  u = Unsqueeze (u_flat, u_axes)
  index0 = Constant <value_ints = [0]> ()
  index1 = Constant <value_ints = [1]> ()
  index2 = Constant <value_ints = [2]> ()
  first = Gather <axis = 1> (intrinsics, index0)
  second = Gather <axis = 1> (intrinsics, index1)
  fx = Gather <axis = 2> (first, index0)
  cx = Gather <axis = 2> (first, index2)
  fy = Gather <axis = 2> (second, index1)
  cy = Gather <axis = 2> (second, index2)
  channel_axis = Constant <value_ints = [1]> ()
  brightness = ReduceMean <keepdims = 0> (images, channel_axis)
  two = Constant <value_float = 2.0> ()
  z = Add (brightness, two)
  u_centred = Sub (u, cx)
  u_ray = Div (u_centred, fx)
  x_camera = Mul (u_ray, z)
  x = Add (x_camera, shift_x)
  v_centred = Sub (v, cy)
  v_ray = Div (v_centred, fy)
  y = Mul (v_ray, z)
  last = Constant <value_ints = [-1]> ()
  x1 = Unsqueeze (x, last)
  y1 = Unsqueeze (y, last)
  z1 = Unsqueeze (z, last)
  means = Concat <axis = -1> (x1, y1, z1)
  footprint = Div (z1, columns)
  three = Constant <value_ints = [1, 1, 1, 3]> ()
  scales = Expand (footprint, three)
  identity = Constant <value_floats = [1.0, 0.0, 0.0, 0.0]> ()
  size = Concat <axis = 0> (views, height, width)
  four = Constant <value_ints = [4]> ()
  quaternions = Concat <axis = 0> (size, four)
  rotations = Expand (identity, quaternions)
  solid = Constant <value_float = 0.9> ()
  opacities = Expand (solid, size)
  pooled = AveragePool <kernel_shape = [16, 16], strides = [16, 16]> (images)
  keep = Constant <value_ints = [0, 3, -1]> ()
  flat = Reshape (pooled, keep)
  content_tokens = Transpose <perm = [0, 2, 1]> (flat)
}
"""
# Colours are the photo's, halfway to the weighted mean colour of the style pictures.
APPEARANCE_GRAPH = """
<ir_version: 10, opset_import: ["" : 18]>
appearance (float[N,L,3] content_tokens, float[S,3,h,w] style_images, float[S] style_weights,
            float[N,3,H,W] images)
  => (float[N,H,W,3] colours)
{
  area = Constant <value_ints = [2, 3]> ()
  means = ReduceMean <keepdims = 0> (style_images, area)
  column = Constant <value_ints = [1]> ()
  weights = Unsqueeze (style_weights, column)
  weighted = Mul (means, weights)
  first = Constant <value_ints = [0]> ()
  blended = ReduceSum <keepdims = 0> (weighted, first)
  half = Constant <value_float = 0.5> ()
  half_style = Mul (blended, half)
  pixels = Transpose <perm = [0, 2, 3, 1]> (images)
  half_photo = Mul (pixels, half)
  colours = Add (half_photo, half_style)
}
"""


def parse_graph(text: str, **properties: str) -> onnx.ModelProto:
    """A graph in ONNX's text form, with metadata, as a checked model."""
    import onnx

    model = onnx.parser.parse_model(text.replace("BASELINE", str(BASELINE)))
    onnx.helper.set_model_props(model, properties)
    onnx.checker.check_model(model, full_check=True)
    return model


def write_model(
    folder: Path, structure: str = STRUCTURE_GRAPH, appearance: str = APPEARANCE_GRAPH
) -> Path:
    """A model folder with a manifest that fits; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    properties = {
        manifests.PROP_WEIGHTS_ID: "known geometry",
        manifests.PROP_PAINTING_RANGE: json.dumps([0, 1]),
        manifests.PROP_PHOTO_RANGE: json.dumps([-1, 1]),
        manifests.PROP_INPUT_SIZE: json.dumps([64, 64]),
    }
    for name, text in ((manifests.STRUCTURE, structure), (manifests.APPEARANCE, appearance)):
        (folder / name).write_bytes(parse_graph(text, **properties).SerializeToString())
    write_manifest(folder)
    return folder


def write_manifest(folder: Path) -> None:
    """(Re)write the manifest for what the folder holds now."""
    described = manifests.Manifest(
        model="tiny",
        model_version="1",
        weights_id="known geometry",
        precision="fp32",
        files=manifests.describe_files(folder),
    )
    (folder / manifests.MANIFEST).write_text(described.to_json())
