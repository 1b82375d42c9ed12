"""What rays bring back, by the technique's options: how many per pixel, and with how much light at their ends."""

import dataclasses

from jaxrefl.radiance import DirectOptions, IncomingOptions, LightOptions
from jaxrefl.techniques._tracing.options import TraceOptions


def following(options: TraceOptions) -> IncomingOptions:
    """How a ray of a glossy or refractive lobe is followed.

    Args:
        options: The technique's options.
    Returns:
        Options of `radiance.incoming`.
    """
    light = LightOptions(
        model=options.light,
        area_samples=options.area_samples,
        environment_samples=options.environment_samples,
        path_samples=1,
        bounces=options.path_bounces,
    )
    return IncomingOptions(bounces=options.bounces, interfaces=options.interfaces, light=light)


def following_mirrors(options: TraceOptions) -> IncomingOptions:
    """How the one ray of a mirror is followed: what it saves in rays goes into light where it ends.

    Args:
        options: The technique's options.
    Returns:
        Options of `radiance.incoming`.
    """
    follow = following(options)
    area, environment = (
        min(count * options.samples, DirectOptions.MOST)
        for count in (options.area_samples, options.environment_samples)
    )
    light = dataclasses.replace(
        follow.light, area_samples=area, environment_samples=environment, path_samples=options.samples
    )
    return dataclasses.replace(follow, light=light)
