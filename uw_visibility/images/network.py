# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Networks in ONNX from images to one map or image: check, loading and inference.

Models are untrusted: only their graph is run. Models that would read other files or run other code
are refused by the file's bytes, before onnxruntime parses them, so that the check does not depend
on installed versions. onnxruntime is imported when a network is loaded, not before.
"""

from __future__ import annotations

import functools
import hashlib
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from uw_visibility.config.files import check_regular, read_regular
from uw_visibility.config.schema import NetworkConfig, PipelineConfig
from uw_visibility.errors import InputError, needing, printable, refusing

ONNX = "onnx"
"""Name of the matcher and of the restorer that are networks."""

# Largest message of protocol buffers, and so of a model without external data, bytes.
_LARGEST_FILE = (1 << 31) - 1
# Largest constant that is computed at loading, bytes; larger ones are computed in a run, within the
# memory limit.
_LARGEST_CONSTANT = 64 << 20
_LARGEST_SIDE = 1 << 14
_PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
# Normalisation of R, G and B, 0..1, in torchvision's models.
_IMAGENET_MEAN = np.array((0.485, 0.456, 0.406), np.float32)
_IMAGENET_STDDEV = np.array((0.229, 0.224, 0.225), np.float32)


class NetworkError(InputError):
    """A network failed on a frame; the message names the network and the reason."""


class ImageInput(NamedTuple):
    """Input of a network for one image, as its model declares it."""

    name: str
    dtype: type
    channels: int  # 1 or 3
    channels_last: bool
    size: tuple[int | None, int | None]  # height and width, px; None for any


class Model(NamedTuple):
    """A checked and loaded model."""

    name: str  # of the file
    session: Any
    inputs: tuple[ImageInput, ...]


class Network:
    """Network for images of one size, with a test run at construction.

    Images larger than a model's fixed size are resized to it, or cut into tiles
    (`NetworkConfig.large_images`); smaller ones are padded at the right and lower border by
    replication.

    `section` is that of the parameters, for messages; `images` the number of input images: 2 for
    the disparity map of a pair, 1 for a restored image; `shape` their height and width, px;
    `threads` the number of CPU threads; `disparity` the largest one, px: a strip of this width at
    the left border of a left tile is not in the right tile.

    Raises `InputError` if onnxruntime is missing, or the model is unsuitable; `NetworkError` if it
    cannot be run.
    """

    def __init__(
        self, config: NetworkConfig, section: str, images: int, shape: tuple[int, int],
        threads: int, disparity: int = 0,
    ) -> None:
        self._config, self._section = config, section
        self._model = load(config, section, images, threads)
        first = self._model.inputs[0]
        self.channels = first.channels
        if self.channels == 1 and config.pixel_values == "imagenet":
            raise InputError(
                f"{section}.pixel_values is imagenet, for RGB images, but {self._model.name} takes "
                "grey ones: give another value")
        self._restores = images == 1
        self._shape = shape
        self._inner = tuple(
            min(side or n, n) for side, n in zip(first.size, shape, strict=True))
        multiple = config.size_multiple
        self._outer = tuple(
            side or -(-n // multiple) * multiple
            for side, n in zip(first.size, self._inner, strict=True))
        self._tiles = self._find_tiles(disparity) if config.large_images == "tiled" else []
        # No time limit at the first run, in which devices compile and allocate. Values of the
        # output are not checked, since the images are blank.
        self._limit = threading.TIMEOUT_MAX
        self._make(*[np.zeros((*self._inner, self.channels), np.float32)] * images)
        self._limit = config.time_limit

    @property
    def columns_per_px(self) -> float:
        """Columns of the images per column of the network, a factor on its disparities."""
        return 1.0 if self._tiles else self._shape[1] / self._inner[1]

    def run(self, *images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network on images (H, W, C), 0..1, with `channels`.

        Returns the network's map of a pair, (H, W), in its own px, or the restored image, 0..1,
        (H, W, 3); finite. Raises `NetworkError` if it fails, takes too long, or returns another
        type or shape, or NaN or infinity.
        """
        if self._inner == self._shape:
            return self._run(*images)
        if self._tiles:
            return self._run_tiles(*images)
        made = self._run(*[
            cv2.resize(image, self._inner[::-1], interpolation=cv2.INTER_AREA)
            .reshape(*self._inner, self.channels) for image in images])
        # Disparities interpolated between two surfaces would be on neither.
        how = cv2.INTER_NEAREST if made.ndim == 2 else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(made, self._shape[::-1], interpolation=how))

    def _find_tiles(self, disparity: int) -> list[tuple[tuple[slice, slice], NDArray[np.float32]]]:
        """Return the places of all tiles, and the weights of their pixels.

        A weight is the product of the distances to the tile's borders inside of the image.
        """
        axes = []
        for n, side, beyond in zip(self._shape, self._inner, (0, disparity), strict=True):
            # Tiles overlap by a quarter of their side, plus the strip without partners.
            step = side - side // 4 - beyond
            if n > side and step < side // 4:
                raise InputError(
                    f"{self._section}.large_images: tiles are {side} px wide, less than twice the "
                    f"largest disparity, {beyond} px: set {self._section}.max_disparity to at most "
                    f"{side // 2}, or {self._section}.large_images to resized")
            count = 1 - (side - n) // max(step, 1)
            at = np.arange(1, side + 1, dtype=np.float32)
            axes.append([
                (slice(start, start + side), np.maximum(np.minimum(
                    at - beyond if start else np.inf, at[::-1] if start + side < n else side), 1))
                for start in np.linspace(0, n - side, count).astype(int).tolist()])
        return [
            ((rows, columns), np.outer(across, along).astype(np.float32))
            for rows, across in axes[0] for columns, along in axes[1]]

    def _run_tiles(self, *images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network on each tile; blend images, take maps from the tile of largest weight."""
        whole = np.zeros((*self._shape, self.channels if self._restores else 1), np.float32)
        total = np.zeros((*self._shape, 1), np.float32)
        for place, weights in self._tiles:
            made = self._run(*(image[place] for image in images))
            made = made.reshape(*self._inner, -1)
            weight = weights[..., np.newaxis]
            if self._restores:
                whole[place] += weight * made
                total[place] += weight
            else:
                np.copyto(whole[place], made, where=weight > total[place])
                np.maximum(total[place], weight, out=total[place])
        if self._restores:
            whole /= total
        return whole[..., 0] if whole.shape[2] == 1 else whole

    def _run(self, *images: NDArray[np.float32]) -> NDArray[np.float32]:
        """Run the network on images of its own size."""
        made = self._make(*images)
        if not np.isfinite(made).all():
            raise self._error("gave values that are NaN or infinite")
        height, width = self._inner
        made = made[:height, :width]
        if self._restores and self._config.pixel_values != "imagenet":
            low, high = self._limits()
            made = (made - np.float32(low)) / np.float32(high - low)
        return made

    def _make(self, *images: NDArray[np.float32]) -> NDArray[np.float32]:
        feeds = {
            each.name: self._tensor(image, each)
            for each, image in zip(self._model.inputs, images, strict=True)}
        return self._image(self._timed(feeds))

    def channels_of(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return an image, RGB or grey, with the `channels` that the network takes."""
        if self.channels == 1 and image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if image.ndim == 2:
            image = np.repeat(image[..., np.newaxis], self.channels, axis=2)
        return image

    def _limits(self) -> tuple[int, int]:
        """Pixel values of black and white."""
        low, high = self._config.pixel_values.split("..")
        return int(low), int(high)

    def _tensor(self, image: NDArray[np.float32], to: ImageInput) -> NDArray[Any]:
        below, beside = (n - m for n, m in zip(self._outer, self._inner, strict=True))
        image = cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE)
        image = image.reshape(*self._outer, to.channels)
        if self._config.pixel_values == "imagenet":
            image = (image - _IMAGENET_MEAN) / _IMAGENET_STDDEV
        else:
            low, high = self._limits()
            image = low + (high - low) * image
        ordered = image if to.channels_last else np.moveaxis(image, 2, 0)
        return np.ascontiguousarray(ordered[np.newaxis], to.dtype)

    def _timed(self, feeds: dict[str, NDArray[Any]]) -> NDArray[Any]:
        """Run the session within the time limit; an operator is not interrupted."""
        import onnxruntime

        options = onnxruntime.RunOptions()
        over = threading.Event()

        def end() -> None:
            over.set()
            options.terminate = True

        timer = threading.Timer(self._limit, end)
        timer.start()
        try:
            made, = self._model.session.run(None, feeds, options)
        # The error's type depends on the device, without another common base.
        except Exception as error:
            if over.is_set():
                raise self._error(
                    f"took longer than {self._section}.time_limit, {self._limit:g} s") from error
            more = (
                f" (increase {self._section}.network_memory)"
                if "Available memory" in str(error) else "")
            raise self._error(f"failed: {error}{more}") from error
        finally:
            timer.cancel()
        return np.asarray(made)

    def _image(self, made: NDArray[Any]) -> NDArray[np.float32]:
        """Check type and shape of the network's output; return it as a map or an image."""
        channels, (height, width) = self.channels if self._restores else 1, self._outer
        wanted: list[tuple[int, ...]] = [
            (1, channels, height, width), (1, height, width, channels)]
        if channels == 1:
            wanted += [(1, height, width), (height, width)]
        if made.dtype not in _TYPES.values() or made.shape not in wanted:
            raise self._error(
                f"gave {made.dtype} of shape {made.shape}: it must give float32 or float16 of "
                f"shape {' or '.join(map(str, wanted))}, "
                f"{'the restored image' if self._restores else 'left-referenced disparity, px'}")
        if channels == 1:
            return made.reshape(height, width).astype(np.float32)
        if made.shape == wanted[0]:
            made = np.moveaxis(made, 1, 3)
        return np.ascontiguousarray(made[0], np.float32)

    def _error(self, what: str) -> NetworkError:
        return NetworkError(f"{self._section}.model: the network {self._model.name} {what}")


def load(config: NetworkConfig, section: str, images: int, threads: int) -> Model:
    """Check and load a model with a number of input images; the last models are cached.

    Raises `InputError` as `Network` does.
    """
    if not config.model:
        raise InputError(f"parameter {section}.model is empty: give the path of an ONNX file")
    stamp = _stamp(config.model)
    with needing("onnx", f"{section}.model"):
        _limit_memory(config.network_memory, section)
    return _load(config.model, stamp, config.providers, section, images, threads)


# More than one model per section, since a change of parameters may be undone.
@functools.lru_cache(maxsize=4)
def _load(
    path: str, stamp: tuple[int, ...], providers: str, section: str, images: int, threads: int
) -> Model:
    import onnxruntime

    content = read_regular(path, _LARGEST_FILE, "model")
    name = printable(Path(path).name)
    check_content(content, name)
    wanted = _named_providers(providers, section, onnxruntime.get_available_providers())
    options = onnxruntime.SessionOptions()
    # Its errors contain what it would log.
    options.log_severity_level = 4
    options.intra_op_num_threads = threads
    options.use_deterministic_compute = True
    for key, value in (
        ("session.load_model_format", "ONNX"),
        ("session.use_env_allocators", "1"),
        ("optimization.constant_folding_max_output_size_in_bytes", str(_LARGEST_CONSTANT)),
    ):
        options.add_session_config_entry(key, value)
    # The type of an error depends on the device, and names may not be UTF-8.
    with refusing(f"model {name} cannot be loaded", Exception):
        # Its own fallback would change the providers, with a note on standard output only.
        session = onnxruntime.InferenceSession(
            content, options, providers=wanted, enable_fallback=0)
        session.disable_fallback()
        lacking = [each for each in wanted if each not in session.get_providers()]
        if lacking:
            raise InputError(
                f"{section}.providers: {lacking[0]} does not start: check its libraries and "
                "device, or leave it out")
        inputs = tuple(_image_input(each, name) for each in session.get_inputs())
        outputs = [f"{each.name} {each.shape}" for each in session.get_outputs()]
    if len(inputs) != images or len({each[1:] for each in inputs}) != 1 or len(outputs) != 1:
        raise InputError(
            f"model {name} has the inputs {[tuple(each) for each in inputs]} and the outputs "
            f"{', '.join(outputs)}: it must have {images} of one layout, and one output")
    # Inputs are left and right in order, unless their names say the opposite.
    if images == 2 and "right" in inputs[0].name.lower() and "left" in inputs[1].name.lower():
        inputs = inputs[::-1]
    return Model(name, session, inputs)


# Memory limit of the process, GiB, which onnxruntime accepts only once.
_bound: list[float] = []
_BOUNDING = threading.Lock()


def _limit_memory(most: float, section: str) -> None:
    """Limit the main memory of all networks of the process together, GiB."""
    import onnxruntime

    with _BOUNDING:
        if not _bound:
            onnxruntime.disable_telemetry_events()
            onnxruntime.create_and_register_allocator(
                onnxruntime.OrtMemoryInfo(
                    "Cpu", onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0,
                    onnxruntime.OrtMemType.DEFAULT),
                onnxruntime.OrtArenaCfg({"max_mem": int(most * (1 << 30))}))
            _bound.append(most)
    if most != _bound[0]:
        raise InputError(
            f"{section}.network_memory is {most:g} GiB, and networks of this process have "
            f"{_bound[0]:g} GiB: give both sections the same value, and restart to change it")


def _named_providers(text: str, section: str, available: list[str]) -> list[str]:
    names = [name.strip().lower() for name in text.split(",")]
    here = [name for name, provider in _PROVIDERS.items() if provider in available]
    for name in names:
        if name not in here:
            raise InputError(
                f"parameter {section}.providers names {name!r}: this onnxruntime has "
                f"{', '.join(here)}")
    return [_PROVIDERS[name] for name in names]


def _image_input(declared: Any, model: str) -> ImageInput:
    """Read the layout of an input; refuse one that is not an image."""
    shape = [n if isinstance(n, int) and n > 0 else None for n in declared.shape]
    places = [at for at in (1, 3) if len(shape) == 4 and shape[at] in (1, 3)]
    sizes = [n for at, n in enumerate(shape) if at and at not in places]
    if (
        declared.type not in _TYPES or len(places) != 1 or shape[0] not in (1, None)
        or any(n is not None and n > _LARGEST_SIDE for n in sizes)
    ):
        raise InputError(
            f"model {model} has the input {declared.name}, {declared.type} of shape "
            f"{declared.shape}: it must be float or float16 of shape [1, C, height, width] or "
            f"[1, height, width, C], with C = 1 or 3 and sides of at most {_LARGEST_SIDE} px")
    at, = places
    height, width = sizes
    channels = 1 if shape[at] == 1 else 3
    return ImageInput(declared.name, _TYPES[declared.type], channels, at == 3, (height, width))


def digests(config: PipelineConfig) -> dict[str, str]:
    """SHA-256 of each model in use, by ``<section>.model_sha256``."""
    used = {
        "stereo": config.stereo.model if config.stereo.matcher == ONNX else "",
        "enhancement": config.enhancement.model if config.enhancement.restorer == ONNX else ""}
    return {
        f"{section}.model_sha256": _digest(path, _stamp(path))
        for section, path in used.items() if path}


@functools.lru_cache(maxsize=4)
def _digest(path: str, stamp: tuple[int, ...]) -> str:
    return hashlib.sha256(read_regular(path, _LARGEST_FILE, "model")).hexdigest()


def _stamp(path: str) -> tuple[int, ...]:
    """Inode, size and modification time, which change with a file's content."""
    check_regular(path, "model")
    found = Path(path).stat()
    return found.st_ino, found.st_size, found.st_mtime_ns


# Messages of onnx.proto that may contain refused fields, by parent message and field number.
_PARTS = {
    ("model", 7): "graph",
    ("graph", 1): "node", ("graph", 5): "tensor",
    ("node", 5): "attribute",
    ("attribute", 5): "tensor", ("attribute", 10): "tensor",
    ("attribute", 6): "graph", ("attribute", 11): "graph",
}
_REFUSED = {
    ("model", 20): "a graph for training",
    ("model", 25): "functions of its own (inline them when it is exported)",
    ("graph", 15): "sparse weights", ("attribute", 22): "sparse weights",
    ("attribute", 23): "sparse weights",
    ("tensor", 13): "weights in another file (export it as one file)",
}


def check_content(content: bytes, name: str) -> None:
    """Refuse a model's file that would read other files, run other code, or take endless memory.

    Reads the wire format of protocol buffers as far as needed for onnx.proto (ONNX 1.23).
    Raises `InputError` with the model's name and the refused content.
    """
    waiting = [("model", memoryview(content))]
    try:
        while waiting:
            kind, message = waiting.pop()
            elements = 1
            for field, value in _fields(message):
                at = kind, field
                if at in _REFUSED or (at == ("tensor", 14) and value != 0):
                    what = _REFUSED.get(at) or _REFUSED["tensor", 13]
                    raise InputError(f"model {name} has {what}: that is refused")
                if at == ("node", 7) and bytes(value) not in (b"", b"ai.onnx"):
                    raise InputError(
                        f"model {name} has operators of the domain {bytes(value).decode()}: give "
                        "a model with ONNX's own operators only")
                if at == ("tensor", 1):
                    elements *= math.prod(
                        [value] if isinstance(value, int) else _numbers(value))
                elif at in _PARTS:
                    waiting.append((_PARTS[at], value))
            # The smallest elements have four bits.
            if kind == "tensor" and elements > 2 * len(message):
                raise InputError(
                    f"model {name} has a tensor of {elements} elements in {len(message)} bytes: "
                    "it is damaged")
    except (IndexError, TypeError, UnicodeDecodeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{name} is not an ONNX model, or it is damaged") from error


def _fields(message: memoryview) -> Iterator[tuple[int, Any]]:
    """Yield the number and the value of each field: an integer, or bytes."""
    at = 0
    while at < len(message):
        key, at = _number(message, at)
        kind = key & 7
        if kind == 0:
            value, at = _number(message, at)
            yield key >> 3, value
            continue
        if kind == 2:
            length, at = _number(message, at)
        elif kind in (1, 5):
            length = 8 if kind == 1 else 4
        else:
            raise ValueError(kind)
        if at + length > len(message):
            raise IndexError(at)
        yield key >> 3, message[at : at + length]
        at += length


def _numbers(packed: memoryview) -> Iterator[int]:
    at = 0
    while at < len(packed):
        value, at = _number(packed, at)
        yield value


def _number(message: memoryview, at: int) -> tuple[int, int]:
    """Read a varint: its value, and the position after it."""
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError(at)
