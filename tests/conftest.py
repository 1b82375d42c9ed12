"""Test configuration: strict promotion, runtime shape checks, warnings as errors, fixed seeds.

The import hook must be installed before `jaxrefl` is imported, so it stands at the top of this file.
"""

import os
import pathlib
from collections.abc import Iterator

# What one process has compiled the others need not compile again: pytest's workers, and the commands that tests run.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(pathlib.Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")

from jaxtyping import install_import_hook  # noqa: E402

install_import_hook(["jaxrefl", "scenes"], "typechecker.check")

import jax  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Each compiled function takes some of the memory maps that Linux grants a process; when they run out, XLA crashes.
MOST_MAPS = int(pathlib.Path("/proc/sys/vm/max_map_count").read_text()) // 3 if os.path.exists("/proc/self/maps") else 0

settings.register_profile(
    "default",
    max_examples=25,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("thorough", parent=settings.get_profile("default"), max_examples=500)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


@pytest.fixture(scope="module", autouse=True)
def forget_compiled_functions() -> Iterator[None]:
    """Before a module that might need more memory maps than are left, drop what earlier ones have compiled."""
    if MOST_MAPS and len(pathlib.Path("/proc/self/maps").read_bytes().splitlines()) > MOST_MAPS:
        jax.clear_caches()
    yield


@pytest.fixture
def key() -> jax.Array:
    """The random key every test starts from."""
    return jax.random.key(0)


@pytest.fixture
def rng() -> np.random.Generator:
    """The NumPy generator every test starts from."""
    return np.random.default_rng(0)
