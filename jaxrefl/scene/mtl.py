r"""Material libraries of OBJ files (`.mtl`) -> `Material`s, by documented formulas.

MTL describes a Phong model; this is how it is read:

- exponent `Ns`: $\alpha = \sqrt{2 / (N_s + 2)}$, see `alpha_from_exponent`;
- `illum` 3 or 5 with `Ks` > 0: a perfect mirror of the colour `Ks`;
- `illum` 4, 6, 7 or 9: glass of the index `Ni` (1.5 if absent or <= 1); `Tf` is what passes through two surfaces;
- `Ks` absent or 0, or `illum` 0 or 1: matte, without any reflection (index 1);
- `Ks` > 0 that is coloured (its components differ by more than 10 %) or more than ten times `Kd`: partly metal,
  `base = min(Kd + Ks, 1)` and `metallic = max(Ks) / (max(Kd) + max(Ks))`, so that `Kd` scatters and `Ks` reflects;
- any other `Ks` > 0: a glossy dielectric of the index `Ni` (1.5 if absent or <= 1), because exporters write the same
  grey `Ks` for every plastic and its size carries no meaning;
- `d` < 1 or `Tr` > 0 in the last two: a thin pane that lets through 1 - d;
- `Pr` and `Pm`, if present, replace roughness and metalness; `Ke` is emission.

Source: "MTL material format (Lightwave, OBJ)", Paul Bourke; Walter et al. 2007, "Microfacet models for refraction
through rough surfaces", for the equivalence of exponent and width.
"""

import math
from pathlib import Path

import numpy as np

from jaxrefl.scene.description import Image, Material, glass, matte, mirror
from jaxrefl.scene.errors import SceneError
from jaxrefl.scene.images import read_image

_COLOURS = {"kd", "ks", "ke", "tf"}
_NUMBERS = {"ns", "ni", "illum", "d", "tr", "pr", "pm"}
_MAPS = {"map_kd", "map_ke", "map_bump", "bump", "norm"}
_OPTION_LENGTHS = {
    "-s": 3,
    "-o": 3,
    "-t": 3,
    "-mm": 2,
    "-bm": 1,
    "-clamp": 1,
    "-blendu": 1,
    "-blendv": 1,
    "-imfchan": 1,
}
_OPTION_LENGTHS |= {"-boost": 1, "-texres": 1, "-type": 1, "-colorspace": 1, "-cc": 1}


def read_mtl(path: Path, notes: list[str]) -> dict[str, Material]:
    """The materials of a library.

    Args:
        path: An `.mtl` file.
        notes: Receives one sentence per kind of statement that is ignored, and per texture that is missing.
    Returns:
        Materials by name, in file order.
    Raises:
        SceneError: If a number cannot be read; names the line.
    Edge cases: a name that is defined twice keeps its last definition, with a note.
    """
    entries: dict[str, dict[str, str]] = {}
    current: dict[str, str] | None = None
    ignored: dict[str, int] = {}
    for line in path.read_bytes().decode("utf-8", errors="replace").splitlines():
        keyword, _, rest = line.split("#", 1)[0].replace("\t", " ").strip().partition(" ")
        key, rest = keyword.lower(), rest.strip()
        if key == "newmtl":
            if rest in entries:
                notes.append(f"material {rest!r} is defined twice in {path.name}; the last one counts")
            current = entries[rest] = {}
        elif key in _COLOURS | _NUMBERS | _MAPS and current is not None:
            current[key] = rest
        elif key:
            ignored[keyword] = ignored.get(keyword, 0) + 1
    for keyword, count in ignored.items():
        notes.append(f"{path.name}: {keyword} is ignored ({count} material{'s' if count > 1 else ''})")
    images: dict[tuple[str, bool], Image | None] = {}
    return {name: _material(path, name, entry, images, notes) for name, entry in entries.items()}


def alpha_from_exponent(exponent: float) -> float:
    r"""Width of the microfacet lobe that stands for a Phong exponent.

    $$ \alpha = \sqrt{\frac{2}{N_s + 2}} $$

    With it Beckmann's $\exp(-\tan^2\theta / \alpha^2)$ falls off around its peak like $\cos^{N_s + 2}\theta$; GGX takes
    over the width, as is usual.

    Args:
        exponent: Phong exponent, >= 0.
    Returns:
        alpha in [0, 1]; 1 at the exponent 0.
    Source: Walter et al. 2007, "Microfacet models for refraction through rough surfaces", after Eq. 37.
    """
    return math.sqrt(2.0 / (max(exponent, 0.0) + 2.0))


def _material(
    path: Path, name: str, entry: dict[str, str], images: dict[tuple[str, bool], Image | None], notes: list[str]
) -> Material:
    number = {key: _numbers(path, name, key, entry[key])[0] for key in sorted(_NUMBERS & entry.keys())}
    colour = {key: _colour(path, name, key, entry[key]) for key in sorted(_COLOURS & entry.keys())}
    kd = _clamped(name, "Kd", colour.get("kd", np.full(3, 0.8)), notes)
    ks = _clamped(name, "Ks", colour.get("ks", np.zeros(3)), notes)
    maps = {key: _map(path, name, key, entry[key], images, notes) for key in sorted(_MAPS & entry.keys())}
    picture = maps.get("map_kd")
    if picture is not None and kd.max() == 0:
        notes.append(f"material {name!r}: Kd is black although there is a map_Kd; white is used")
        kd = np.ones(3)
    material = _surface(name, kd, ks, colour, number, notes)
    if "pr" in number:
        material = material.replace(alpha=min(max(number["pr"], 0.0), 1.0) ** 2, eta=max(material.eta, 1.5))
    if "pm" in number:
        material = material.replace(metallic=min(max(number["pm"], 0.0), 1.0))
    emission = np.maximum(colour.get("ke", np.full(3, 1.0 if maps.get("map_ke") else 0.0)), 0.0)
    bump = next((maps[key] for key in ("norm", "map_bump", "bump") if maps.get(key)), None)
    return material.replace(
        emission=_triple(emission),
        emission_texture=maps.get("map_ke") if emission.max() > 0 else None,
        base_colour_texture=picture,
        normal_texture=bump,
    )


def _surface(
    name: str,
    kd: np.ndarray,
    ks: np.ndarray,
    colour: dict[str, np.ndarray],
    number: dict[str, float],
    notes: list[str],
) -> Material:
    """The material without emission and textures, by the rules at the top of this file."""
    illum = int(number.get("illum", 2))
    eta = number.get("ni", 1.5)
    eta = eta if eta > 1 else 1.5
    if illum in (3, 5) and ks.max() > 0:
        return mirror(name, colour=_triple(ks))
    if illum in (4, 6, 7, 9):
        if ks.max() > 0:
            notes.append(f"material {name!r}: Ks is ignored; glass reflects by its index Ni = {eta:g}")
        passes = _clamped(name, "Tf", colour.get("tf", np.ones(3)), notes)
        return glass(name, colour=_triple(np.sqrt(passes)), eta=eta)
    opacity = min(max(number.get("d", 1.0 - number.get("tr", 0.0)), 0.0), 1.0)
    if illum in (0, 1) or ks.max() == 0:
        if opacity < 1:
            notes.append(f"material {name!r}: d = {opacity:g} is ignored; the surface is matte and opaque")
        return matte(name, _triple(kd))
    alpha = alpha_from_exponent(number.get("ns", 0.0))
    thin = {"transmission": 1.0 - opacity, "thin": opacity < 1}
    if ks.max() - ks.min() > 0.1 * ks.max() or ks.max() > 10 * kd.max():
        base = _triple(np.minimum(kd + ks, 1.0))
        return Material(name, base, metallic=float(ks.max() / (kd.max() + ks.max())), alpha=alpha, eta=eta, **thin)
    return Material(name, _triple(kd), alpha=alpha, eta=eta, **thin)


def _map(
    path: Path, name: str, key: str, rest: str, images: dict[tuple[str, bool], Image | None], notes: list[str]
) -> Image | None:
    """The image of a `map_...` statement; None, with a note, where it is missing or is a height map."""
    repeat, tokens = True, rest.split()
    while tokens and tokens[0].startswith("-") and tokens[0] in _OPTION_LENGTHS:
        flag = tokens.pop(0)
        values = [tokens.pop(0)] if tokens else []
        while len(values) < _OPTION_LENGTHS[flag] and len(tokens) > 1 and _is_number(tokens[0]):
            values.append(tokens.pop(0))
        if flag == "-clamp":
            repeat = values != ["on"]
        else:
            notes.append(f"material {name!r}: option {flag} of {key} is ignored")
    file_name = " ".join(tokens).replace("\\", "/")
    image_key = (file_name, repeat)
    if image_key not in images:
        file = path.parent / file_name
        file = file if file.is_file() else path.parent / Path(file_name).name
        try:
            images[image_key] = Image(file_name, read_image(file), repeat=(repeat, repeat))
        except ValueError as error:
            notes.append(f"texture {file_name!r} left out: {error}")
            images[image_key] = None
    image = images[image_key]
    if image is not None and key in ("map_bump", "bump") and not _is_normal_map(image.rgba):
        notes.append(f"material {name!r}: {key} is ignored: {file_name!r} holds heights, not normals")
        return None
    return image


def _is_normal_map(rgba: np.ndarray) -> bool:
    """Normal maps are bluish: the mean normal points along +Z. Height maps are grey."""
    red, green, blue = rgba[..., :3].reshape(-1, 3).mean(0)
    return bool(blue > 150 and blue - max(red, green) > 30)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(path: Path, name: str, key: str, rest: str) -> list[float]:
    try:
        values = [float(token) for token in rest.replace("-halo", "").split()]
        if values and all(math.isfinite(v) for v in values):
            return values
    except ValueError:
        pass
    raise SceneError(f"{path}: material {name!r}: {key}: expected finite numbers, got {rest!r}")


def _colour(path: Path, name: str, key: str, rest: str) -> np.ndarray:
    values = _numbers(path, name, key, rest)
    if len(values) not in (1, 3):
        raise SceneError(f"{path}: material {name!r}: {key}: expected 1 or 3 numbers, got {rest!r}")
    return np.array(values * 3 if len(values) == 1 else values, np.float64)


def _clamped(name: str, key: str, colour: np.ndarray, notes: list[str]) -> np.ndarray:
    clamped = np.clip(colour, 0, 1)
    if (clamped != colour).any():
        notes.append(f"material {name!r}: {key}: expected 0 to 1, got {colour.tolist()}; clamped")
    return clamped


def _triple(colour: np.ndarray) -> tuple[float, float, float]:
    r, g, b = (float(c) for c in colour)
    return r, g, b
