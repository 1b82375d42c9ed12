"""What the README and the first page promise works as it stands there."""

import re
from pathlib import Path

import pytest

import jaxrefl as jr
import scenes

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "docs" / "pages" / "index.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_the_example_runs_as_it_is_printed(page: Path):
    """Only the scene file and the image size are replaced, by a small built-in scene and a small image."""
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.S)
    code = code.replace('jr.load("ToyCar.gltf")', "SCENE").replace("(960, 540)", "(32, 18)")
    assert "SCENE" in code and "(32, 18)" in code
    found = {"SCENE": jr.assemble(scenes.build("cornell", triangles=1000))}
    exec(code, found)
    if "figures" in found:
        assert found["figures"]["mae255"] > 0
    else:
        assert found["image"].shape == (18, 32, 3)


@pytest.mark.parametrize("page", [*PAGES, *sorted((ROOT / "docs" / "pages").glob("*.md"))], ids=lambda p: p.name)
def test_linked_files_exist(page: Path):
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target
