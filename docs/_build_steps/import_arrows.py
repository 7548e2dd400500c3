"""Reads from the sources which file imports which, and draws the folders and their imports as `docs/imports.svg`.

Run `python docs/_build_steps/import_arrows.py` after an import between two folders has come or gone. `tests/test_imports.py`
reads the same arrows, compares the picture with them, and fails on a wrong one.

An arrow points from the folder that imports to the folder that it imports from. An arrow that follows from others is left out
(the transitive reduction of the graph), so the picture shows every order between folders with the fewest arrows.
"""

from __future__ import annotations

import ast
import textwrap
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "imports.svg"
PACKAGE = "diethrow"
STAGES = ("model", "tracking", "fitting", "replay")
"""Each imports from those before it only; the files of the package itself may import from all."""
TOP = "src/diethrow"
"""Name of the last column: the folders of the package itself."""

ENTRY_POINTS = (PACKAGE, f"{PACKAGE}.__main__")
"""What users and the shell begin with. They name what lies above them and import it on demand, so they set no order."""

Graph = dict[str, set[str]]
"""What each node imports from."""


@dataclass(frozen=True)
class Import:
    """One name that one module imports from another module of the package."""

    importer: str
    imported: str
    name: str
    line: int

    def __str__(self) -> str:
        return f"{self.importer} (line {self.line}) imports {self.name} from {self.imported}"


@dataclass(frozen=True)
class Sources:
    """The modules of the package by their dotted names, and what they import from each other."""

    files: dict[str, Path]
    imports: tuple[Import, ...]

    def is_package(self, module: str) -> bool:
        """Whether a module is the `__init__` of a folder."""
        return self.files[module].name == "__init__.py"

    def folder(self, module: str) -> str:
        """The folder that a module lies in, as a dotted name."""
        return module if self.is_package(module) else module.rpartition(".")[0]

    def file_graph(self) -> Graph:
        """Which modules each module imports from."""
        return _graph(self.files, ((each.importer, each.imported) for each in self._ordering()))

    def folder_graph(self) -> Graph:
        """Which folders each folder imports from. That an `__init__` imports from its own folder does not count."""
        pairs = []
        for each in self._ordering():
            importer, imported = self.folder(each.importer), self.folder(each.imported)
            own = self.is_package(each.importer) and f"{imported}.".startswith(f"{importer}.")
            if importer != imported and not own:
                pairs.append((importer, imported))
        return _graph(map(self.folder, self.files), pairs)

    def _ordering(self) -> Iterable[Import]:
        return (each for each in self.imports if each.importer not in ENTRY_POINTS)


def read_sources(root: Path = ROOT) -> Sources:
    """Every module below the packages of pyproject.toml, and every import between them, those for type checking included.

    Raises ValueError for an import of the package by its absolute name, and for one of a module that does not exist.
    """
    top_folders = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"]
    files: dict[str, Path] = {}
    for package, folder in top_folders.items():
        for path in sorted((root / folder).rglob("*.py")):
            parts = path.relative_to(root / folder).with_suffix("").parts
            files[".".join((package, *(part for part in parts if part != "__init__")))] = path
    return Sources(files, tuple(found for module in files for found in _imports(module, files)))


def stage_of(module: str) -> str:
    """The stage of a module or folder: one of STAGES, or TOP."""
    second = module.split(".")[1:2]
    return second[0] if second and second[0] in STAGES else TOP


def without_implied_arrows(graph: Graph) -> Graph:
    """The transitive reduction of a graph without circles: the fewest arrows that say who imports whom, directly or not."""
    reached: Graph = {}
    for node in TopologicalSorter(graph).static_order():
        reached[node] = graph[node].union(*(reached[other] for other in graph[node]))
    return {
        node: {other for other in others if not any(other in reached[third] for third in others)}
        for node, others in graph.items()
    }


def _graph(nodes: Iterable[str], pairs: Iterable[tuple[str, str]]) -> Graph:
    graph: Graph = {node: set() for node in nodes}
    for importer, imported in pairs:
        graph[importer].add(imported)
    return graph


def _imports(module: str, files: dict[str, Path]) -> Iterable[Import]:
    path = files[module]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        if any(name.split(".")[0] == PACKAGE for name in names):
            raise ValueError(f"{path}, line {node.lineno}: {PACKAGE} imported by its absolute name; wanted from .")
        if isinstance(node, ast.ImportFrom) and node.level:
            parts = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
            base = ".".join([*parts[: len(parts) - node.level + 1], *([node.module] if node.module else [])])
            for alias in node.names:
                file = f"{base}.{alias.name}"
                is_module = file in files and (files[base] == path or alias.name not in _names_of(files[base]))
                imported = file if is_module else base
                if imported not in files:
                    raise ValueError(f"{path}, line {node.lineno}: there is no module {imported}")
                yield Import(module, imported, alias.name, node.lineno)


@cache
def _names_of(path: Path) -> frozenset[str]:
    """The names that an `__init__` imports for others; a file of the same name is then imported through it."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return frozenset(
        each.asname or each.name for node in nodes if isinstance(node, ast.ImportFrom) for each in node.names
    )


# --- the picture: a column for each stage, with its folders above those that they import from ---

COLUMN_PX, ROW_PX, BOX_WIDTH_PX, BOX_HEIGHT_PX = 178, 42, 124, 24
MARGIN_PX, HEAD_PX, GAP_PX = 12, 40, 16
HEAD_LENGTH_PX, HEAD_HALF_WIDTH_PX = 6, 3
BULGE_PX, MAX_BULGES = 9, 3
"""How far an arrow swings out for each box that it passes, and for how many of them at most."""
MAX_LETTERS, MAX_SMALL_LETTERS = 19, 28
"""In the line of a box: a longer label stands in lines of small letters."""
COLOURS = {"model": "#2f6f8f", "tracking": "#3f7d4f", "fitting": "#8a6a1f", "replay": "#8f4a5f", TOP: "#555b66"}
SUBJECTS = {
    "model": "a die in motion",
    "tracking": "footage to a throw",
    "fitting": "a throw to parameters",
    "replay": "records to pictures",
    TOP: "files and commands",
}


def draw(sources: Sources) -> str:
    """The picture as SVG."""
    graph = without_implied_arrows(sources.folder_graph())
    columns = {stage: [f for f in _bottom_up(graph, stage) if _label(f, sources)] for stage in (*STAGES, TOP)}
    rows = max(map(len, columns.values()))
    width = MARGIN_PX * 2 + COLUMN_PX * len(columns) - GAP_PX
    height = MARGIN_PX * 2 + HEAD_PX + ROW_PX * rows
    parts = []
    for k, (stage, folders) in enumerate(columns.items()):
        left, colour = MARGIN_PX + COLUMN_PX * k, COLOURS[stage]
        top = {folder: MARGIN_PX + HEAD_PX + ROW_PX * (rows - 1 - row) for row, folder in enumerate(folders)}
        parts += _column(stage, left, height - 2 * MARGIN_PX)
        if k:
            parts += _arrow(f"M{left + 8} {MARGIN_PX + 15}", left - GAP_PX - 6, MARGIN_PX + 15, "left", colour)
        for folder in folders:
            parts += _box(_label(folder, sources), left + 10, top[folder], colour)
            for other in sorted(graph[folder] & top.keys()):
                passed = folders.index(folder) - folders.index(other) - 1
                parts += _arrow_between(left + 10, top[folder], top[other], passed, colour)
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    )
    return "\n".join(
        [
            f'{opening} font-family="Helvetica, Arial, sans-serif">',
            "<title>Folders of diethrow, and which imports from which</title>",
            f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
            *parts,
            "</svg>\n",
        ]
    )


def _bottom_up(graph: Graph, stage: str) -> list[str]:
    """The folders of a stage, each after all that it imports from, and by name where the imports leave that open."""
    own = {folder for folder in graph if stage_of(folder) == stage}
    sorter, order = TopologicalSorter({folder: graph[folder] & own for folder in own}), []
    sorter.prepare()
    while sorter.is_active():
        ready = sorted(sorter.get_ready())
        order += ready
        sorter.done(*ready)
    return order


def _label(folder: str, sources: Sources) -> str:
    """The folder's path in its stage; for the stage itself the names of its files; empty where it has none."""
    own = f"{PACKAGE}." if stage_of(folder) == TOP else f"{PACKAGE}.{stage_of(folder)}."
    modules = [m for m in sources.files if sources.folder(m) == folder and not sources.is_package(m)]
    if f"{folder}." == own:
        return ", ".join(sorted(m.removeprefix(own) for m in modules if m not in ENTRY_POINTS))
    return f"{folder.removeprefix(own).replace('.', '/')}/" if modules else ""


def _column(stage: str, left: int, height: int) -> list[str]:
    colour, width = COLOURS[stage], COLUMN_PX - GAP_PX
    return [
        f'<rect x="{left}" y="{MARGIN_PX}" width="{width}" height="{height}" rx="8" fill="{colour}" fill-opacity="0.08"/>',
        _text(stage, left + 10, MARGIN_PX + 19, f'font-size="14" font-weight="bold" fill="{colour}"'),
        _text(SUBJECTS[stage], left + 10, MARGIN_PX + 34, 'font-size="11" fill="#444444"'),
    ]


def _box(label: str, left: int, top: int, colour: str) -> list[str]:
    width, height = BOX_WIDTH_PX, BOX_HEIGHT_PX
    lines = [label] if len(label) <= MAX_LETTERS else textwrap.wrap(label, MAX_SMALL_LETTERS)
    size = 12 if len(label) <= MAX_LETTERS else 9
    middle = top + (16 if len(lines) == 1 else 10)
    style = f'font-size="{size}" text-anchor="middle" fill="#222222"'
    return [
        f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="5" fill="#ffffff" stroke="{colour}"/>',
        *(_text(line, left + width // 2, middle + 10 * k, style) for k, line in enumerate(lines)),
    ]


def _text(text: str, x: int, y: int, style: str) -> str:
    return f'<text x="{x}" y="{y}" {style}>{text}</text>'


def _arrow_between(left: int, top: int, top_of_other: int, passed: int, colour: str) -> list[str]:
    """From a box straight down to the next one, or on the right around the boxes in between."""
    if not passed:
        middle = left + BOX_WIDTH_PX // 2
        return _arrow(f"M{middle} {top + BOX_HEIGHT_PX}", middle, top_of_other, "down", colour)
    right, start, end = left + BOX_WIDTH_PX, top + BOX_HEIGHT_PX // 2, top_of_other + BOX_HEIGHT_PX // 2
    out = right + 8 + BULGE_PX * min(passed, MAX_BULGES)
    return _arrow(f"M{right} {start} C{out} {start} {out} {end}", right, end, "left", colour)


def _arrow(begin: str, x: int, y: int, direction: str, colour: str) -> list[str]:
    """A line to a point, with a head that points down or left."""
    length, half = HEAD_LENGTH_PX, HEAD_HALF_WIDTH_PX
    if direction == "down":
        end, head = f"{x} {y - length}", f"M{x} {y} l{-half} {-length} h{2 * half} Z"
    else:
        end, head = f"{x + length} {y}", f"M{x} {y} l{length} {-half} v{2 * half} Z"
    line = "L" if "C" not in begin else ""
    return [
        f'<path d="{begin} {line}{end}" fill="none" stroke="{colour}" stroke-width="1.2"/>',
        f'<path d="{head}" fill="{colour}"/>',
    ]


if __name__ == "__main__":
    PICTURE.write_text(draw(read_sources()), encoding="utf-8")
    print(PICTURE)
