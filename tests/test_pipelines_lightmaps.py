"""The light map of a job: baked when needed, kept, and used only while it fits."""

import dataclasses

import pytest
from shapes import floor

from jaxrefl.radiance import LightOptions
from jaxrefl.rays import EmbreeTracer
from jaxrefl.scene import assemble
from jaxrefl.scene.description import Description, constant_sky, matte
from pipelines.job import Job, Reference, SceneSource, with_paths
from pipelines.lightmaps import NAME, wants_lightmap, with_lightmap


def scene_of(colour=(0.5, 0.5, 0.5)):
    scene = assemble(Description("x", [floor("floor", matte("m", colour))], sky=constant_sky((1.0, 1.0, 1.0))))
    return scene, EmbreeTracer(scene.mesh)


def test_a_job_wants_a_map_if_one_of_its_tables_says_so():
    job = Job(SceneSource("cornell"))
    assert not wants_lightmap(job)
    assert wants_lightmap(dataclasses.replace(job, light={"model": "baked"}))
    assert wants_lightmap(dataclasses.replace(job, technique={"raytrace": {"light": "baked"}}))
    assert not wants_lightmap(dataclasses.replace(job, technique={"envmap": {"light": "baked"}}))  # not rendered
    assert wants_lightmap(dataclasses.replace(job, reference=Reference(knobs={"light": "baked"})))


def test_paths_of_maps_count_from_the_job():
    job = Job(SceneSource("cornell"), light={"lightmap": "map.npz"})
    assert with_paths(job, lambda p: f"/there/{p}").light["lightmap"] == "/there/map.npz"
    assert with_paths(Job(SceneSource("cornell")), lambda p: f"/there/{p}").light == {}


@pytest.mark.slow
def test_a_map_is_baked_once_and_again_when_something_has_changed(tmp_path):
    options = LightOptions(model="baked", texels=64, bake_samples=8)

    def run(scene_and_tracer, options=options) -> str:
        said = []
        scene = with_lightmap(*scene_and_tracer, options, tmp_path, said.append)
        assert scene.lightmap is not None and (tmp_path / NAME).exists()
        return " ".join(said)

    assert "baking" in run(scene_of())
    second = run(scene_of())
    assert "read from" in second and "baking" not in second
    assert "other knobs" in run(scene_of(), dataclasses.replace(options, bounces=2))
    assert "other geometry, materials or lights" in run(
        scene_of((0.2, 0.5, 0.5)), dataclasses.replace(options, bounces=2)
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == [NAME]

    own = tmp_path / "own.npz"
    run(scene_of(), dataclasses.replace(options, lightmap=str(own)))
    assert own.exists()
    own.write_text("something else")
    with pytest.raises(ValueError, match="expected a light map"):
        run(scene_of(), dataclasses.replace(options, lightmap=str(own)))
    assert own.read_text() == "something else"
