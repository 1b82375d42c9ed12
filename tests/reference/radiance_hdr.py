"""Radiance RGBE writers in all three codings, and the decoded values in float64; written from the description."""

import numpy as np


def header(width: int, height: int, *, extra: str = "", y: str = "-", x: str = "+") -> bytes:
    """File header with the given signs of the axes."""
    return f"#?RADIANCE\n# a comment\n{extra}FORMAT=32-bit_rle_rgbe\n\n{y}Y {height} {x}X {width}\n".encode()


def flat(rgbe: np.ndarray) -> bytes:
    """Pixels one after another."""
    return rgbe.tobytes()


def old_style(rgbe: np.ndarray) -> bytes:
    """Repeated pixels as (1, 1, 1, n), counts above 255 as several such marks, the lowest byte first."""
    pixels = [bytes(p) for p in rgbe.reshape(-1, 4)]
    out, at = b"", 0
    while at < len(pixels):
        run = at
        while run < len(pixels) and pixels[run] == pixels[at]:
            run += 1
        out += pixels[at]
        repeats = run - at - 1
        while repeats:
            out += bytes([1, 1, 1, repeats & 255])
            repeats >>= 8
        at = run
    return out


def new_style(rgbe: np.ndarray) -> bytes:
    """Scan lines of four planes, each of runs (128 + n, value) and literals (n, values)."""
    height, width, _ = rgbe.shape
    out = bytearray()
    for row in rgbe:
        out += bytes([2, 2, width >> 8, width & 255])
        for plane in row.T:
            values, at = bytes(plane), 0
            while at < width:
                run = 1
                while at + run < width and values[at + run] == values[at] and run < 127:
                    run += 1
                if run > 2:
                    out += bytes([128 + run, values[at]])
                else:
                    out += bytes([run]) + values[at : at + run]
                at += run
    return bytes(out)


def values(rgbe: np.ndarray) -> np.ndarray:
    """Radiance of RGBE pixels."""
    mantissa, exponent = rgbe[..., :3].astype(np.float64), rgbe[..., 3:].astype(np.float64)
    return np.where(exponent > 0, mantissa / 256 * 2 ** (exponent - 128), 0)
