"""Radiance RGBE (`.hdr`, `.pic`) bytes -> linear radiance.

Host code used by `images.py`: flat, old-style and new-style run-length-coded pixels, as in Ward's "Real Pixels" and the
Radiance reference manual. The new style is decoded packet by packet on byte strings, the rest by array operations.
"""

import re

import numpy as np

from jaxrefl.scene.errors import SceneError

_RESOLUTION = re.compile(rb"([+-])Y (\d+) ([+-])X (\d+)")


def decode_hdr(data: bytes, *, name: str = "image") -> np.ndarray:
    r"""Decode a Radiance RGBE picture.

    $$ L = m \, 2^{e - 136} / \textstyle\prod \mathrm{EXPOSURE} $$

    with mantissa byte `m` and exponent byte `e`; a pixel with `e = 0` is black.

    Args:
        data: The whole file.
        name: What to call the image in errors.
    Returns:
        [h w 3] float32 linear RGB, row 0 on top.
    Raises:
        SceneError: If the data is truncated or broken, or the pixels are XYZE or stored column by column.
    Edge cases: bytes after the last pixel are ignored.
    Source: Ward, "Real Pixels", Graphics Gems II, 1991.
    Differs from the source: mantissas are not shifted by one half, so that 0 stays 0 (as in most current readers).
    """
    header, end, pixels = data.partition(b"\n\n")
    if not header.startswith(b"#?") or not end:
        raise SceneError(f"{name}: expected a Radiance header that ends with an empty line")
    lines = header.split(b"\n")
    for line in lines:
        if line.startswith(b"FORMAT=") and line.strip() != b"FORMAT=32-bit_rle_rgbe":
            raise SceneError(f"{name}: expected FORMAT=32-bit_rle_rgbe, got {line.decode(errors='replace')}")
    size, _, pixels = pixels.partition(b"\n")
    match = _RESOLUTION.fullmatch(size.strip())
    if match is None:
        raise SceneError(
            f"{name}: expected a resolution like '-Y 512 +X 1024', got {size[:40].decode(errors='replace')!r}"
        )
    height, width = int(match[2]), int(match[4])
    if height < 1 or width < 1:
        raise SceneError(f"{name}: expected at least one pixel, got {width} x {height}")

    is_new_style = 8 <= width < 32768 and pixels[:2] == b"\x02\x02" and len(pixels) > 2 and pixels[2] < 128
    rgbe = (_new_style if is_new_style else _old_style)(pixels, height, width, name)
    scale = np.ldexp(np.float32(1), rgbe[..., 3].astype(np.int32) - 136)
    radiance = rgbe[..., :3].astype(np.float32) * np.where(rgbe[..., 3] > 0, scale, np.float32(0))[..., None]
    radiance = radiance[:: 1 if match[1] == b"-" else -1, :: 1 if match[3] == b"+" else -1]
    return np.ascontiguousarray(radiance / np.float32(_exposure(lines, name)))


def _exposure(lines: list[bytes], name: str) -> float:
    product = 1.0
    for line in lines:
        if line.startswith(b"EXPOSURE="):
            try:
                product *= float(line[len(b"EXPOSURE=") :])
            except ValueError:
                product = -1.0
            if not 0 < product < np.inf:
                raise SceneError(f"{name}: expected a positive EXPOSURE, got {line.decode(errors='replace')}")
    return product


def _new_style(data: bytes, height: int, width: int, name: str) -> np.ndarray:
    """Scan lines of four run-length-coded planes: [height width 4] uint8."""
    start = bytes([2, 2, width >> 8, width & 255])
    out, at = bytearray(), 0
    for row in range(height):
        if data[at : at + 4] != start:
            what = (
                "the file is truncated"
                if len(data) < at + 4
                else f"expected the start of a scan line of {width} pixels"
            )
            raise SceneError(f"{name}: broken Radiance data in row {row}: {what}")
        at += 4
        for plane in range(1, 5):
            full = (4 * row + plane) * width
            while len(out) < full:
                code = data[at] if at < len(data) else 0
                if code > 128:
                    out += data[at + 1 : at + 2] * (code - 128)
                    at += 2
                else:
                    out += data[at + 1 : at + 1 + code]
                    at += 1 + code
                if code == 0 or at > len(data):
                    what = "the file is truncated" if at >= len(data) else "a run of length 0"
                    raise SceneError(f"{name}: broken Radiance data in row {row}: {what}")
            if len(out) > full:
                raise SceneError(f"{name}: broken Radiance data in row {row}: a run goes past the end of the row")
    return np.frombuffer(out, np.uint8).reshape(height, 4, width).transpose(0, 2, 1)


def _old_style(data: bytes, height: int, width: int, name: str) -> np.ndarray:
    """Flat pixels, where (1, 1, 1, n) repeats the pixel before it n times: [height width 4] uint8."""
    stored = np.frombuffer(data, np.uint8, len(data) // 4 * 4).reshape(-1, 4)[: height * width]
    repeats = (stored[:, :3] == 1).all(-1)
    index = np.arange(len(stored))
    last = np.maximum.accumulate(np.where(repeats, -1, index))  # the pixel that is repeated
    if len(last) and last[0] < 0:
        raise SceneError(f"{name}: broken Radiance data: the first pixel repeats one that does not exist")
    # Repeats in a row are the bytes of one count, the lowest first; more than 4 bytes cannot occur in a real picture.
    shift = np.minimum(index - last - 1, 4) * 8
    count = np.where(repeats, stored[:, 3].astype(np.int64) << np.maximum(shift, 0), 1)
    kept = np.searchsorted(np.cumsum(np.minimum(count, height * width)), height * width) + 1
    rgbe = np.repeat(stored[last[:kept]], np.minimum(count[:kept], height * width), axis=0)[: height * width]
    if len(rgbe) < height * width:
        raise SceneError(f"{name}: the file is truncated: {len(rgbe)} of {height * width} pixels")
    return rgbe.reshape(height, width, 4)
