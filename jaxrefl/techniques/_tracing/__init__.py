"""Tracing some pixels of a frame, for every technique that traces: options, masks -> radiance and what was hit."""

from .light import following as following
from .light import following_mirrors as following_mirrors
from .mirrors import blurred as blurred
from .mirrors import counts_of as counts_of
from .mirrors import distance_of as distance_of
from .mirrors import trace_mirrors as trace_mirrors
from .options import TraceOptions as TraceOptions
from .pixels import Traced as Traced
from .pixels import nothing_traced as nothing_traced
from .pixels import trace_reflected as trace_reflected
from .pixels import trace_refracted as trace_refracted
from .samples import Reached as Reached
