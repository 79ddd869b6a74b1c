"""A model folder into one of another precision: checked, compared in pictures, all or nothing."""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

import onnx

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, OutputError
from styl3r_cli.files import TEMP_PREFIX
from styl3r_cli.manifest import APPEARANCE, MANIFEST, STRUCTURE, Manifest
from styl3r_cli.names import real_path
from styl3r_export.quantise import integers, storage
from styl3r_export.quantise.calibration import Sample, feeds_of
from styl3r_export.quantise.loss import Loss, rendered_loss
from styl3r_export.quantise.variants import VARIANTS, find_large

# Entered with a name; the command's console shows how long it takes.
Stage = Callable[[str], AbstractContextManager[object]]
# Graphs beyond this many bytes of weights keep them in a file of their own: a protobuf message
# cannot pass 2 GiB, and weights inside one are in memory twice while they load (full's peak in the
# precision "mixed" is 3.2 GB so, and 2.5 GB with files of their own).
EXTERNAL_ABOVE = 256 << 20
EXACT = ("fp32", "fp16")  # what other precisions are made from


def convert_folder(
    source: Path,
    target: Path,
    precision: str,
    samples: Sequence[Sample],
    *,
    verify: bool = True,
    stage: Stage = nullcontext,
) -> tuple[Manifest, list[Loss]]:
    """Write a model folder of another precision.

    Args:
        source: a model folder, fp32 or fp16.
        target: a new folder, an empty one, or an earlier export, which is replaced.
        precision: one of VARIANTS.
        samples: photos and styles, to calibrate with and to compare pictures of.
        verify: compare pictures of both models before anything is put in place.
        stage: is entered with a name around each part of the work.

    Returns:
        The new manifest, and what each sample's pictures lost (none without verification).

    Raises:
        ModelError: the source is damaged or quantised already, or the result breaks a scene.
        OutputError: the target is in use by something else, or cannot be written.
    """
    check_target(target)
    manifest = _exact_manifest(source)
    feeds = feeds_of(source, samples) if VARIANTS[precision].calibrated else {}
    losses: list[Loss] = []
    with replacing(target) as temporary:
        for name in (STRUCTURE, APPEARANCE):
            with stage(f"{precision} {name}"):
                _convert(source / name, temporary / name, precision, feeds.get(name, []))
        files = manifests.describe_files(temporary)
        result = Manifest(
            manifest.model, manifest.model_version, manifest.weights_id, precision, files
        )
        (temporary / MANIFEST).write_text(result.to_json(), encoding="utf-8")
        if verify:
            with stage("pictures of both"):
                losses = rendered_loss(source, temporary, samples)
            _refuse_broken(precision, losses)
    return result, losses


def _exact_manifest(source: Path) -> Manifest:
    manifest = manifests.read_manifest(source)
    if manifest.precision not in EXACT:
        message = f"{source}: is {manifest.precision} already"
        raise ModelError(f"{message}; start from the fp32 or fp16 model")
    for name in manifest.files:
        manifests.check_file(source, name, manifest)
    return manifest


def _refuse_broken(precision: str, losses: Sequence[Loss]) -> None:
    for loss in losses:
        if loss.broken:
            raise ModelError(
                f"{precision} breaks the scene of {loss.sample}: its pictures keep "
                f"{loss.worst:.1f} dB; nothing written (--no-verify writes it all the same)"
            )


def _convert(source: Path, target: Path, precision: str, feeds: Sequence[integers.Feeds]) -> None:
    """One graph in another precision."""
    model = onnx.load(source)
    storage.widen(model.graph)
    _name_nodes(model.graph)
    large = find_large(model.graph)
    if precision == "fp16":
        storage.halve(model.graph, large.weights)
    elif precision == "w8":
        storage.store_as_integers(model.graph, large.multiplied | large.convolved)
    elif precision == "w4":
        model = integers.pack_matrices(model, large.matrices)
        storage.store_as_integers(model.graph, large.convolved)
    elif precision == "mixed" and source.name == STRUCTURE:
        model = _looks_in_integers(model, feeds)
    elif precision != "fp32":
        model = _in_integers(model, precision, feeds)
    if precision not in EXACT:  # what loops read can only be halved
        storage.halve(model.graph, large.rest)
    for property_ in model.metadata_props:
        if property_.key == manifests.PROP_PRECISION:
            property_.value = precision
    _save(model, target)


def _in_integers(
    model: onnx.ModelProto, precision: str, feeds: Sequence[integers.Feeds]
) -> onnx.ModelProto:
    """Integer products; what convolutions stay float32 are stored in 8 bits."""
    large = find_large(model.graph)
    properties = list(model.metadata_props)
    with tempfile.TemporaryDirectory() as folder:
        path, source = Path(folder) / "graph.onnx", Path(folder) / "float32.onnx"
        # Products first: calibration needs copies of the graph, which are then four times smaller
        # (over 2 GB they could not be made), and sees the values that the products really give.
        if large.matrices:
            onnx.save_model(model, source, save_as_external_data=True, location="weights")
            integers.multiply_integers(source, large.matrices, path)
            model = onnx.load(path)
        if VARIANTS[precision].calibrated and large.head_convolutions:
            integers.calibrate_convolutions(model, large.head_convolutions, feeds, path)
            model = onnx.load(path)
    _set_properties(model, properties)
    storage.store_as_integers(model.graph, find_large(model.graph).convolved)
    return model


def _looks_in_integers(model: onnx.ModelProto, feeds: Sequence[integers.Feeds]) -> onnx.ModelProto:
    """Integer convolutions in the heads that decide on Gaussians' looks, places in float32.

    Matrices are stored in 16 bits; convolutions that stay float32 are few, and faster as they are.
    """
    large = find_large(model.graph)
    properties = list(model.metadata_props)
    storage.store_as_long_integers(model, large.multiplied)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "graph.onnx"
        if large.look_convolutions:
            integers.calibrate_convolutions(model, large.look_convolutions, feeds, path)
            model = onnx.load(path)
    _set_properties(model, properties)
    return model


def _set_properties(
    model: onnx.ModelProto, properties: Sequence[onnx.StringStringEntryProto]
) -> None:
    """Give back what a quantiser dropped."""
    del model.metadata_props[:]
    model.metadata_props.extend(properties)


def _name_nodes(graph: onnx.GraphProto) -> None:
    """A name for every node, since quantisers choose by it."""
    for index, node in enumerate(graph.node):
        node.name = node.name or f"{node.op_type}_{index}"


def _save(model: onnx.ModelProto, path: Path) -> None:
    """One file, and one beside it where the weights are too many for a protobuf message."""
    external = sum(len(tensor.raw_data) for tensor in model.graph.initializer) > EXTERNAL_ABOVE
    location = f"{path.name}.data" if external else None
    onnx.save_model(model, path, save_as_external_data=external, location=location)
    if location:  # it is made for its owner's eyes only
        (path.parent / location).chmod(path.stat().st_mode & 0o777)


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """A temporary folder beside another, which it replaces when the block ends without an error.

    Raises:
        OutputError: the folder is in use by something else, or cannot be written.
    """
    check_target(folder)
    folder = real_path(folder)  # a link keeps pointing where it points
    temporary = folder.parent / f"{TEMP_PREFIX}{secrets.token_hex(6)}"
    try:
        temporary.mkdir()
        yield temporary
        publish(temporary, folder)
    except OSError as error:
        raise OutputError(f"cannot write {folder}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # some umasks keep a folder's own maker out of it
            temporary.chmod(0o700)
        shutil.rmtree(temporary, ignore_errors=True)


def check_target(folder: Path) -> None:
    """Make sure that an export may go to a folder.

    Raises:
        OutputError: it is a file, its parent does not exist, it is write-protected, the current
            one, or it holds something else: all that is in it goes.
    """
    try:
        if folder.is_dir():
            _check_earlier(folder)
        elif folder.exists():
            raise OutputError(f"cannot write {folder}: it is a file; name a folder")
        elif not real_path(folder).parent.is_dir():
            raise OutputError(f"cannot write {folder}: {folder.parent} does not exist")
    except OSError as error:
        raise OutputError(f"cannot write {folder}: {error.strerror or error}") from error


def _check_earlier(folder: Path) -> None:
    """Make sure that a folder may be replaced as a whole."""
    known = _exported(folder)
    others = {path.name for path in folder.iterdir() if path.is_dir() or path.name not in known}
    if others:
        message = f"cannot write {folder}: the folder holds something else ({min(others)})"
        raise OutputError(f"{message}; name a new or an empty one")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"cannot write {folder}: the folder is write-protected")
    if folder.samefile(os.curdir):
        raise OutputError(f"cannot write {folder}: it is the current folder, and is replaced")


def _exported(folder: Path) -> set[str]:
    """The names of what an export wrote into a folder; other programs have manifests, too."""
    try:
        return {MANIFEST, *manifests.read_manifest(folder).files}
    except ModelError:
        return set()


def publish(temporary: Path, folder: Path) -> None:
    """Put the finished folder in its place; an earlier export goes only when it is there."""
    earlier = folder.parent / f"{temporary.name}-earlier"
    replaced = folder.is_dir()
    if replaced:
        folder.replace(earlier)
    try:
        temporary.replace(folder)
    except BaseException:
        if replaced:
            earlier.replace(folder)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
