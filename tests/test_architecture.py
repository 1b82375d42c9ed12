"""The house keeps its order: imports point one way, embreex is in one file, package files only re-export."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LIBRARY = ROOT / "jaxrefl"
ORDER = ["core", "scene", "rays", "surface", "radiance", "filters", "techniques", "composite"]
"""Rooms in the order the data flows; each may import from those before it."""
MODULES = sorted(LIBRARY.rglob("*.py"))
LONGEST = 400
"""Lines above which a module is reported."""


def imports_of(path: Path) -> set[str]:
    """Dotted names of all modules a file imports, relative imports resolved, lazy ones included."""
    found = set()
    package = path.relative_to(ROOT).with_suffix("").parts
    package = package[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {module} | {f"{module}.{name.name}" for name in node.names}
    return found


def room_of(dotted: str) -> str | None:
    parts = dotted.split(".")
    return parts[1] if parts[0] == "jaxrefl" and len(parts) > 1 else None


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(LIBRARY)))
def test_imports_point_one_way(path: Path):
    room = path.relative_to(LIBRARY).parts[0]
    used = {r for name in imports_of(path) if (r := room_of(name)) in {*ORDER, "metrics"}}
    if room == "metrics":
        assert used <= {"core", "metrics"}
    elif room in ORDER:
        assert used <= set(ORDER[: ORDER.index(room) + 1])
    elif room != "__init__.py":
        assert room.startswith("_") and not used


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(LIBRARY)))
def test_the_library_imports_neither_pipelines_nor_scenes(path: Path):
    assert not {name.split(".")[0] for name in imports_of(path)} & {"pipelines", "scenes", "tests"}


def test_techniques_never_import_each_other():
    """What several of them need lies in folders whose names begin with an underscore, and imports no technique."""
    folders = [p for p in (LIBRARY / "techniques").iterdir() if p.is_dir() and (p / "__init__.py").exists()]
    names = {p.name for p in folders if not p.name.startswith("_")}
    assert {"raytrace", "envmap"} <= names
    for technique in folders:
        for path in technique.glob("*.py"):
            others = {
                parts[2]
                for name in imports_of(path)
                if (parts := name.split("."))[:2] == ["jaxrefl", "techniques"] and len(parts) > 2
            }
            assert not others & (names - {technique.name}), path


def test_embreex_is_imported_in_one_file():
    users = [
        p
        for p in ROOT.rglob("*.py")
        if ".venv" not in p.parts and "embreex" in {m.split(".")[0] for m in imports_of(p)}
    ]
    assert users == [LIBRARY / "rays" / "embree.py"]


@pytest.mark.parametrize("path", sorted(LIBRARY.rglob("__init__.py")), ids=lambda p: str(p.parent.relative_to(ROOT)))
def test_package_files_only_re_export(path: Path):
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        assert isinstance(node, ast.ImportFrom), f"{path}: line {node.lineno} is no re-export"
        for name in node.names:
            assert name.asname == name.name, f"{path}: line {node.lineno}: write `{name.name} as {name.name}`"


def test_pipelines_of_techniques_are_a_table_of_contents():
    for path in (LIBRARY / "techniques").glob("*/pipeline.py"):
        assert len(path.read_text().splitlines()) <= 120, path


def test_no_postponed_annotations_which_switch_shape_checks_off():
    for path in MODULES:
        assert "from __future__ import annotations" not in path.read_text(), path


def test_module_sizes_are_reported(record_property, capsys):
    sizes = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in MODULES}
    record_property("largest_module", max(sizes.values()))
    large = {name: size for name, size in sizes.items() if size > LONGEST}
    with capsys.disabled():
        for name, size in sorted(large.items(), key=lambda item: -item[1]):
            print(f"\n{name}: {size} lines; would two names say more than one?", end="")
    assert max(sizes.values()) <= 2 * LONGEST, sizes


def test_import_is_quick_and_leaves_jax_alone():
    """`import jaxrefl` takes under 2 s, touches no JAX setting and leaves the heavy libraries out."""
    code = """
import sys, time
import jax
before = dict(jax.config.values)
start = time.perf_counter()
import jaxrefl
seconds = time.perf_counter() - start
after = dict(jax.config.values)
assert before == after, {n for n in before if before[n] != after[n]}
heavy = {"matplotlib", "skimage", "trimesh", "embreex", "pipelines", "scenes"} & set(sys.modules)
assert not heavy, heavy
print(seconds)
"""
    began = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert began.returncode == 0, began.stderr
    assert float(began.stdout) < 2.0
