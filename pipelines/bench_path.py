r"""How the path tracer's error falls with its samples, on every built-in scene, for both kinds of random numbers.

The replicates of a progressive image are independent runs, so one image of 8 n samples holds eight runs of n. Each is
compared with a long run of another seed. $\text{RMSE} \propto n^{s}$: s is -1/2 for independent numbers, and lower
where low-discrepancy numbers help. Rare bright paths (caustics of small lights) make an image's RMSE jump from run to
run, so the median over the runs is shown, and beside it the typical pixel, which they do not touch.
"""

import jax.numpy as jnp
import numpy as np

import scenes
from jaxrefl.radiance.path_types import PathOptions
from jaxrefl.radiance.progressive import (
    REPLICATES,
    Goal,
    ProgressiveOptions,
    ProgressiveState,
    estimate,
    render_progressively,
)
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble

SAMPLERS = ("sobol", "independent")
BOUNCES = {"direct": 1, "all": PathOptions().bounces}
"""Direct light has no caustics: there low-discrepancy numbers can show what they are worth."""
_ROUNDING = 1e-5


def bench_path(
    size: tuple[int, int], spp: tuple[int, ...], reference_spp: int, *, names: tuple[str, ...] | None = None
) -> list[dict]:
    """Error against samples.

    Args:
        size: (width, height).
        spp: Samples per pixel of the runs, ascending.
        reference_spp: Samples per pixel of what they are compared with.
        names: Built-in scenes; None: all.
    Returns:
        One row per scene, length of paths and sampler: slopes of the image's RMSE (median over eight runs) and of the
            typical pixel's (median over pixels of the root mean square over runs), and the RMSE at the first and the
            last of `spp`.
    """
    rows = []
    for name in scenes.BUILT_IN if names is None else names:
        scene = assemble(scenes.build(name))
        tracer, camera = EmbreeTracer(scene.mesh), scenes.BUILT_IN[name].path(1, size=size)[0]

        def render(seed, samples, path, state=None, scene=scene, tracer=tracer, camera=camera):
            options = ProgressiveOptions(path, pixel="centre")
            goal, key = Goal(spp=samples), jnp.uint32(seed)
            return render_progressively(scene, tracer, camera, key, goal=goal, options=options, state=state)

        for light, bounces in BOUNCES.items():
            truth = np.asarray(estimate(render(1, reference_spp, PathOptions(bounces=bounces))).radiance)
            for sampler in SAMPLERS:
                state, errors = None, []
                for n in spp:
                    path = PathOptions(bounces=bounces, sampler=sampler)
                    state = render(0, REPLICATES * n, path, state)
                    errors.append(_errors(state, truth))
                rows.append({"scene": name, "light": light, "sampler": sampler, **slopes(errors, spp)})
    return rows


def _errors(state: ProgressiveState, truth: np.ndarray) -> np.ndarray:
    """Squared errors [r h w] of the replicates' means, averaged over the channels."""
    counts = np.asarray(state.counts, np.float32)[:, None, None, None]
    return np.square(np.asarray(state.radiance) / counts - truth).mean(-1)


def slopes(errors: list[np.ndarray], spp: tuple[int, ...]) -> dict:
    """Slopes of log RMSE against log samples, by least squares.

    Args:
        errors: Squared errors [runs h w] for each number of samples.
        spp: Those numbers.
    Returns:
        `slope` and `slope, typical pixel`; None where errors are those of rounding. `RMSE at n samples` for the first
            and the last n.
    """
    image = [float(np.median(np.sqrt(e.mean((1, 2))))) for e in errors]
    pixel = [float(np.median(np.sqrt(e.mean(0)))) for e in errors]
    ends = {f"RMSE at {n} samples": value for n, value in ((spp[0], image[0]), (spp[-1], image[-1]))}
    return {"slope": _slope(image, spp), "slope, typical pixel": _slope(pixel, spp), **ends}


def _slope(values: list[float], spp: tuple[int, ...]) -> float | None:
    # float32 sums of a few hundred samples near 1 are off by less than this; what falls below it no longer falls.
    if min(values) < _ROUNDING:
        return None
    return float(np.polyfit(np.log(spp), np.log(values), 1)[0])
