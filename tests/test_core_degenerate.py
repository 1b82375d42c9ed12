"""Every public function of `jaxrefl.core` keeps its values and gradients finite on degenerate input.

The test walks the package, so a new function without an entry in `CASES` fails it.
"""

import importlib
import inspect
import itertools
import pkgutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from jaxrefl import core
from jaxrefl.core import look_at

HOST = {"cameras.look_at", "cameras.perspective"}
"""Made from Python numbers outside of jit; what they refuse is tested in `test_core_cameras.py`."""

BELOW_ONE, ABOVE_ONE = float(np.nextafter(np.float32(1), 0)), float(np.nextafter(np.float32(1), 2))
COSINES = (0.0, 1.0, BELOW_ONE, ABOVE_ONE, 0.5, 1e-16, 1e-12, 1e-6, 1e-3, -1e-6, -0.5, -1.0)
ALPHAS = (0.0, 1e-30, 1e-12, 1e-6, 1e-3, 0.3, 1.0)
ETAS = (1.0, BELOW_ONE, ABOVE_ONE, 1.5, 1 / 1.5, 10.0, 0.1)
SHARES = (0.0, 1.0, 0.5, BELOW_ONE, 1e-30, 0.25)
NUMBERS = (0.0, -0.0, 1.0, -1.0, 1e-38, -1e-30, 1e-20, 1e-12, 1e12, -1e12)
VECTORS = (
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    (1.0, 0.0, -0.0),
    (0.0, -1.0, 0.0),
    (1e-30, 0.0, -1e-30),
    (1e-12, 1e-12, 0.0),
    (1e12, -1e12, 1.0),
)
UNITS = ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 1.0, -0.0), (0.6, 0.0, 0.8), (0.8, 0.6, 1e-6))
SQUARE = tuple(itertools.product((0.0, 0.5, BELOW_ONE), repeat=2))


def every(*values: tuple) -> tuple[Array, ...]:
    """All combinations of the values of each argument, as one batch per argument."""
    columns = zip(*itertools.product(*values), strict=True)
    return tuple(jnp.asarray(column, jnp.float32) for column in columns)


WORDS = jnp.asarray([0, 1, 2**16, 2**31, 2**32 - 1], jnp.uint32)

CASES = {
    "sequences.hash_words": (WORDS, WORDS),
    "sequences.owen_sobol": (WORDS, WORDS, WORDS),
    "sequences.pixel_sequences": (jnp.uint32(0), jnp.asarray([0, 1, 2**31 - 1], jnp.int32)),
    "sequences.reverse_bits": (WORDS,),
    "sequences.seed_of": (jax.random.key(0),),
    "sequences.uniform": (WORDS, WORDS, WORDS),
    "safe.divide": every(NUMBERS, NUMBERS),
    "safe.sqrt": every(NUMBERS),
    "safe.arccos": every((*COSINES, 2.0)),
    "safe.norm": every(VECTORS),
    "safe.normalise": every(VECTORS),
    "vectors.dot": every(VECTORS, VECTORS),
    "vectors.cross": every(VECTORS, VECTORS),
    "vectors.largest": every(VECTORS),
    "vectors.lerp": every(VECTORS, VECTORS, SHARES),
    "frames.frame_from_normal": every((*VECTORS, *UNITS)),
    "frames.to_world": every(VECTORS, UNITS),
    "frames.to_local": every(VECTORS, UNITS),
    "shapes.intersect_sphere": every(VECTORS[:5], UNITS, VECTORS[:5], (0.0, 1.0, 1e-12)),
    "shapes.intersect_plane": every(VECTORS[:5], UNITS, VECTORS[:5], UNITS),
    "shapes.distance_to_triangle": every(VECTORS, VECTORS[:4], VECTORS[:4], VECTORS[:4]),
    "shapes.mirror_point": every(VECTORS, VECTORS, UNITS),
    "reflect.reflect": every(UNITS, UNITS),
    "reflect.refract": every(UNITS, UNITS, ETAS),
    "fresnel.fresnel_dielectric": every(COSINES, ETAS),
    "fresnel.fresnel_conductor": every(COSINES, ETAS, (0.0, 1e-12, 1.0, 10.0)),
    "fresnel.fresnel_schlick": every(COSINES, SHARES),
    "fresnel.f0_from_eta": every(ETAS),
    "ggx.ggx_distribution": every(COSINES, ALPHAS),
    "ggx.smith_g1": every(COSINES, ALPHAS),
    "ggx.smith_g2": every(COSINES, COSINES, ALPHAS),
    "ggx.reflection_weight": every(COSINES, COSINES, ALPHAS),
    "ggx.sample_visible_normal": every(UNITS, ALPHAS, SQUARE),
    "ggx.visible_normal_pdf": every(UNITS, UNITS, ALPHAS),
    "ggx.reflection_pdf": every(UNITS, UNITS, ALPHAS),
    "apart.apart": (jnp.ones(3, bool), core.safe.sqrt, *every(SHARES)),
    "apart.together": every(SHARES, SHARES),
    "albedo.ggx_albedo": every(COSINES, ALPHAS),
    "albedo.lobe_fresnel_cosine": every(COSINES, ALPHAS),
    "sampling.stratified": (jax.random.key(0), 1),
    "sampling.disk": every(SQUARE),
    "sampling.cosine_hemisphere": every(SQUARE, UNITS),
    "sampling.triangle": every(SQUARE),
    "sampling.cone": every(SQUARE, UNITS, (1.0, BELOW_ONE, 0.0, -1.0)),
    "sampling.sample_cdf": (jnp.zeros(3), *every(SHARES)),
    "directions.latlong_from_direction": every((*VECTORS, *UNITS)),
    "directions.direction_from_latlong": every(SQUARE),
    "colour.srgb_from_linear": every((*SHARES, -1.0, 1e12)),
    "colour.linear_from_srgb": every((*SHARES, -1.0, 1e12)),
    "colour.luminance": every(VECTORS),
    "cameras.project": (look_at((0, 0, 0), (0, 0, -1), size=(4, 2)), *every((*VECTORS, *UNITS))),
    "cameras.resize": (look_at((0, 0, 0), (0, 0, -1), size=(4, 2)), (1, 1)),
}


def public_functions() -> dict[str, object]:
    """Every public function that a module of `jaxrefl.core` defines; jitted ones are no `inspect.isfunction`."""
    found = {}
    for module in pkgutil.iter_modules(core.__path__):
        members = vars(importlib.import_module(f"jaxrefl.core.{module.name}"))
        for name, value in members.items():
            if callable(value) and not name.startswith("_") and not inspect.isclass(value):
                if getattr(value, "__module__", None) == f"jaxrefl.core.{module.name}":
                    found[f"{module.name}.{name}"] = value
    return found


FUNCTIONS = public_functions()


def is_float(leaf: object) -> bool:
    return isinstance(leaf, Array) and jnp.issubdtype(leaf.dtype, jnp.floating)


def test_every_public_function_has_an_entry():
    assert set(FUNCTIONS) == set(CASES) | HOST


def test_every_public_function_is_re_exported():
    for name, function in FUNCTIONS.items():
        module, name = name.split(".")
        assert getattr(core.safe if module == "safe" else core, name) is function


@pytest.mark.parametrize("name", CASES)
def test_values_and_gradients_are_finite(name: str):
    leaves, structure = jax.tree.flatten(CASES[name])
    varied = [i for i, leaf in enumerate(leaves) if is_float(leaf)]

    def outputs(values: list[Array]) -> list[Array]:
        filled = list(leaves)
        for i, value in zip(varied, values, strict=True):
            filled[i] = value
        results = jax.tree.leaves(FUNCTIONS[name](*jax.tree.unflatten(structure, filled)))
        return [part for x in results for part in ((x.real, x.imag) if jnp.iscomplexobj(x) else (x,))]

    values = [leaves[i] for i in varied]
    results = jax.jit(outputs)(values)
    for result in results:
        assert np.isfinite(np.asarray(result)).all()
    # One output at a time: an infinity in one gradient must not cancel that in another.
    for k, result in enumerate(results):
        if is_float(result) and values:
            gradients = jax.jit(jax.grad(lambda v, k=k: outputs(v)[k].sum()))(values)
            for gradient, value in zip(gradients, values, strict=True):
                bad = ~np.isfinite(np.asarray(gradient))
                assert not bad.any(), f"{name}, output {k}: gradient not finite at {np.asarray(value)[bad][:5]}"
