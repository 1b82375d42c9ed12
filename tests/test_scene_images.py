"""Image files: every pixel mode and coding that occurs, and clear errors for everything else."""

import io
import os
from pathlib import Path

import numpy as np
import OpenEXR
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import radiance_hdr as reference

from jaxrefl.scene import SceneError, read_image, read_radiance
from jaxrefl.scene.images import decode_image, rgba_from_pillow
from jaxrefl.scene.radiance_hdr import decode_hdr

RGBA = np.array([[[255, 0, 0, 255], [0, 128, 7, 0]], [[1, 2, 3, 4], [9, 9, 9, 200]]], np.uint8)


def png(image: PIL.Image.Image, **options) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "png", **options)
    return stream.getvalue()


def runs(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """RGBE pixels with many repetitions, and some zeros."""
    pixels = rng.integers(2, 256, (height * width, 4), dtype=np.uint8)
    pixels = pixels[np.sort(rng.integers(0, height * width, height * width) // 5)]
    pixels[rng.random(len(pixels)) < 0.1] = 0
    return pixels.reshape(height, width, 4)


def test_rgba_is_read_as_stored(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(png(PIL.Image.fromarray(RGBA)))
    np.testing.assert_array_equal(read_image(path), RGBA)


def test_missing_channels_are_filled():
    rgb = decode_image(png(PIL.Image.fromarray(RGBA[..., :3])))
    np.testing.assert_array_equal(rgb[..., :3], RGBA[..., :3])
    assert (rgb[..., 3] == 255).all()
    grey = decode_image(png(PIL.Image.fromarray(RGBA[..., 0])))
    np.testing.assert_array_equal(grey[..., :3], np.repeat(RGBA[..., :1], 3, -1))
    grey_alpha = decode_image(png(_la(RGBA[..., 2:])))
    np.testing.assert_array_equal(grey_alpha[..., 3], RGBA[..., 3])


def _la(values: np.ndarray) -> PIL.Image.Image:
    return PIL.Image.merge("LA", [PIL.Image.fromarray(values[..., i].copy()) for i in range(2)])


def test_palette_with_a_transparent_entry():
    image = PIL.Image.new("P", (3, 1))
    image.putpalette([10, 20, 30, 40, 50, 60])
    image.putdata([0, 1, 0])
    rgba = decode_image(png(image, transparency=1))
    np.testing.assert_array_equal(rgba[0], [[10, 20, 30, 255], [40, 50, 60, 0], [10, 20, 30, 255]])


def test_sixteen_bits_are_rounded():
    values = np.array([[0, 128, 129, 257, 65535, 40000]], np.uint16)
    rgba = decode_image(png(PIL.Image.fromarray(values)))
    np.testing.assert_array_equal(rgba[0, :, 0], np.rint(values[0] / 257))


@pytest.mark.parametrize("mode", ["1", "CMYK", "YCbCr", "HSV", "LAB"])
def test_other_modes_convert(mode: str):
    rgba = rgba_from_pillow(PIL.Image.new(mode, (2, 3)))
    assert rgba.shape == (3, 2, 4) and rgba.dtype == np.uint8 and rgba.flags.writeable


def test_float_images_are_refused():
    with pytest.raises(SceneError, match="height.tif.*floating-point"):
        rgba_from_pillow(PIL.Image.new("F", (2, 2)), name="height.tif")


@pytest.mark.parametrize("content", [None, b"", b"not an image", png(PIL.Image.fromarray(RGBA))[:50]])
@pytest.mark.parametrize("read", [read_image, read_radiance])
def test_bad_files_are_named(read, content: bytes | None, tmp_path: Path):
    path = tmp_path / "broken.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SceneError, match="broken.png"):
        read(path)


@pytest.mark.parametrize("coding", [reference.flat, reference.old_style, reference.new_style])
def test_hdr_codings(coding, rng: np.random.Generator, tmp_path: Path):
    rgbe = runs(rng, 7, 300)
    path = tmp_path / "map.hdr"
    path.write_bytes(reference.header(300, 7) + coding(rgbe))
    radiance = read_radiance(path)
    assert radiance.dtype == np.float32
    np.testing.assert_array_equal(radiance, reference.values(rgbe))


def test_hdr_long_old_style_run():
    rgbe = np.broadcast_to(np.array([9, 8, 7, 130], np.uint8), (4, 500, 4))
    coded = reference.old_style(rgbe)
    assert len(coded) < 20
    np.testing.assert_array_equal(decode_hdr(reference.header(500, 4) + coded), reference.values(rgbe))


def test_hdr_axes_and_exposure(rng: np.random.Generator):
    rgbe = runs(rng, 3, 5)
    data = reference.header(5, 3, y="+", x="-", extra="EXPOSURE=2\nEXPOSURE= 4.0\n") + reference.flat(rgbe)
    np.testing.assert_array_equal(decode_hdr(data), reference.values(rgbe)[::-1, ::-1] / 8)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n1234", "rgbe"),
        (b"#?RADIANCE\n\n+X 1 -Y 1\n1234", "resolution"),
        (b"#?RADIANCE\n\n-Y 0 +X 1\n1234", "at least one pixel"),
        (b"#?RADIANCE\n-Y 1 +X 1\n1234", "empty line"),
        (reference.header(1, 1, extra="EXPOSURE=-1\n") + b"1234", "EXPOSURE"),
        (reference.header(1, 1) + b"\1\1\1\5", "first pixel repeats"),
        (reference.header(8, 1) + b"\2\2\0\x08" + b"\x89a", "past the end"),
        (reference.header(8, 1) + b"\2\2\0\x08" + b"\0a", "length 0"),
        (reference.header(8, 1) + b"\2\2\0\x09", "start of a scan line"),
    ],
)
def test_broken_hdr_says_what_is_wrong(data: bytes, message: str):
    with pytest.raises(SceneError, match=f"sky.hdr.*{message}"):
        decode_hdr(data, name="sky.hdr")


@given(st.data(), st.sampled_from([reference.flat, reference.old_style, reference.new_style]))
def test_damaged_hdr_is_an_error_or_an_image(data: st.DataObject, coding):
    """Whatever happens to the bytes: no other exception, and a truncated file never passes."""
    whole = reference.header(9, 4) + coding(runs(np.random.default_rng(1), 4, 9))
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(SceneError):
        decode_hdr(whole[:cut])
    damaged = bytearray(whole)
    damaged[cut] = data.draw(st.integers(0, 255))
    try:
        decode_hdr(bytes(damaged))
    except SceneError:
        pass


def write_exr(path: Path, channels: dict[str, np.ndarray], **header) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_colour_and_grey(dtype, rng: np.random.Generator, tmp_path: Path):
    rgb = rng.random((3, 5, 3)).astype(dtype)
    write_exr(tmp_path / "rgb.exr", {**{c: rgb[..., i].copy() for i, c in enumerate("RGB")}, "Z": rgb[..., 0].copy()})
    radiance = read_radiance(tmp_path / "rgb.exr")
    assert radiance.dtype == np.float32
    np.testing.assert_array_equal(radiance, rgb.astype(np.float32))
    write_exr(tmp_path / "grey.exr", {"Y": rgb[..., 0].copy()})
    np.testing.assert_array_equal(
        read_radiance(tmp_path / "grey.exr"), np.repeat(rgb[..., :1], 3, -1).astype(np.float32)
    )


def test_exr_errors(tmp_path: Path):
    path = tmp_path / "sky.exr"
    one = np.ones((2, 2), np.float32)
    write_exr(path, {"diffuse.R": one, "Z": one})
    with pytest.raises(SceneError, match="sky.exr.*channels R, G and B.*Z, diffuse.R"):
        read_radiance(path)
    window = (np.array([0, 0], np.int32), np.array([9, 9], np.int32))
    write_exr(path, {c: one for c in "RGB"}, displayWindow=window)
    with pytest.raises(SceneError, match="sky.exr.*data window"):
        read_radiance(path)


@pytest.mark.parametrize(("value", "message"), [(np.inf, "not finite"), (np.nan, "not finite"), (-1.0, "negative")])
def test_radiance_that_is_none_is_counted(value: float, message: str, tmp_path: Path):
    rgb = {c: np.ones((2, 2), np.float32) for c in "RGB"}
    rgb["G"][1, 0] = value
    write_exr(tmp_path / "sky.exr", rgb)
    with pytest.raises(SceneError, match=f"sky.exr.*1 pixels that are {message}"):
        read_radiance(tmp_path / "sky.exr")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["studio_small_03_1k.hdr", "venice_sunset_1k.hdr"])
def test_maps_that_people_have(name: str):
    if "JAXREFL_SCENES" not in os.environ:
        pytest.skip("JAXREFL_SCENES does not name a folder of scenes")
    radiance = read_radiance(Path(os.environ["JAXREFL_SCENES"], "hdri", name))
    assert radiance.shape == (512, 1024, 3)
    assert 0.1 < radiance.mean() < 10 and radiance.max() > 1000
