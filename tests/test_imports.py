"""Laws of the tree: imports run one way, without circles, through the `__init__` of a folder, and folders stay small."""

from __future__ import annotations

from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from import_arrows import PICTURE, STAGES, TOP, Graph, Sources, draw, read_sources, stage_of, without_implied_arrows

MAX_FILES = 12
"""In a folder, its `__init__` apart: more of them want folders by subject."""


@pytest.fixture(scope="module")
def sources() -> Sources:
    return read_sources()


def test_a_stage_imports_from_the_stages_before_it_only(sources: Sources) -> None:
    order = [*STAGES, TOP]
    wrong = [
        str(each)
        for each in sources.imports
        if order.index(stage_of(each.imported)) > order.index(stage_of(each.importer))
    ]
    assert wrong == []


@pytest.mark.parametrize("nodes", ["file_graph", "folder_graph"])
def test_there_is_no_circle_of_imports(sources: Sources, nodes: str) -> None:
    try:
        TopologicalSorter(getattr(sources, nodes)()).prepare()
    except CycleError as error:
        circle = error.args[1]
        pytest.fail(f"imports go in a circle: {' <- '.join(circle)}")


def test_another_folder_of_a_stage_is_imported_through_its_init(sources: Sources) -> None:
    """A file that lies in a stage itself, or in a folder around the importer, is imported directly."""

    def reaches_past_an_init(importer: str, imported: str) -> bool:
        folder = sources.folder(imported)
        around = f"{sources.folder(importer)}.".startswith(f"{folder}.")
        in_a_folder_of_a_stage = stage_of(folder) != TOP and folder.count(".") > 1
        return in_a_folder_of_a_stage and not around and not sources.is_package(imported)

    wrong = [
        str(each)
        for each in sources.imports
        if stage_of(each.importer) != TOP and reaches_past_an_init(each.importer, each.imported)
    ]
    assert wrong == []


def test_no_folder_holds_more_files_than_one_can_survey(sources: Sources) -> None:
    files = Counter(sources.folder(module) for module in sources.files if not sources.is_package(module))
    assert {folder: count for folder, count in files.items() if count > MAX_FILES} == {}


def test_the_picture_shows_the_imports_as_they_are(sources: Sources) -> None:
    drawn = PICTURE.read_text(encoding="utf-8")
    assert drawn == draw(sources), "run: python docs/_build_steps/import_arrows.py"


def test_an_arrow_that_others_imply_is_not_drawn() -> None:
    graph: Graph = {"a": {"b", "c", "d"}, "b": {"c"}, "c": {"d"}, "d": set()}
    assert without_implied_arrows(graph) == {"a": {"b"}, "b": {"c"}, "c": {"d"}, "d": set()}


def tree(folder: Path, texts: dict[str, str]) -> Path:
    """A small package, laid out like this one."""
    (folder / "pyproject.toml").write_text(
        '[tool.setuptools.package-dir]\ndiethrow = "src/diethrow"\n"diethrow.model" = "model"\n'
        '"diethrow.tracking" = "tracking"\n'
    )
    for name, text in {
        "src/diethrow/__init__.py": "",
        "model/__init__.py": "",
        "tracking/__init__.py": "",
        **texts,
    }.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_imports_are_found_wherever_they_stand(tmp_path: Path) -> None:
    found = read_sources(
        tree(
            tmp_path,
            {
                "model/die/__init__.py": "from .solid import edge as edge\n",
                "model/die/solid.py": "edge = 1\n",
                "tracking/pose.py": (
                    "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from ..model.die import edge\n"
                    "def f():\n    from ..model.die import solid\n"
                ),
            },
        )
    ).imports
    assert {(each.importer, each.imported, each.line) for each in found} == {
        ("diethrow.model.die", "diethrow.model.die.solid", 1),
        ("diethrow.tracking.pose", "diethrow.model.die", 3),
        ("diethrow.tracking.pose", "diethrow.model.die.solid", 5),
    }


@pytest.mark.parametrize(
    "text", ["from diethrow.model import x\n", "import diethrow.model\n", "from .nowhere import x\n"]
)
def test_an_import_by_absolute_name_or_of_a_missing_module_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"pose\.py, line 1"):
        read_sources(tree(tmp_path, {"tracking/pose.py": text}))
