"""Loaded by dask workers in tests: makes the fake techniques known there."""

from fake_techniques import FAKES

from jaxrefl.techniques import TECHNIQUES

TECHNIQUES.update(FAKES)
