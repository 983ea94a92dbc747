"""The import graph of the package: ``python tests/layers.py [SOURCE]`` prints it, for this or any other checkout.

Rooms are the folders and root files of the package, arrows their imports. A room's floor is one above the highest room
that it imports.
"""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "bayeq"


def modules(source: Path = SOURCE) -> list[Path]:
    """Files of the package, but the one that names its public objects."""
    return sorted(path for path in source.rglob("*.py") if path != source / "__init__.py")


def room(path: Path, source: Path = SOURCE) -> str:
    """The folder, or file at the root, that a file belongs to."""
    return path.relative_to(source).parts[0].removesuffix(".py")


@cache
def imported(path: Path, source: Path = SOURCE) -> tuple[Path, ...]:
    """Files of the package that a file imports, at its top, in a function or for the type checker."""
    out = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            if name.split(".")[0] == source.name:
                found = _file(source, tuple(name.split(".")[1:]))
                if found is not None and found != path:
                    out.append(found)
    return tuple(out)


@cache
def _file(source: Path, parts: tuple[str, ...]) -> Path | None:
    """The file that a dotted name is in: a module, a package, or a name in one of them."""
    for length in range(len(parts), 0, -1):
        base = source.joinpath(*parts[:length])
        for candidate in (base.with_suffix(".py"), base / "__init__.py"):
            if candidate.is_file():
                return candidate
    return None


def rooms(source: Path = SOURCE) -> dict[str, set[str]]:
    """Each room with the other rooms that it imports."""
    out: dict[str, set[str]] = {}
    for path in modules(source):
        here = room(path, source)
        others = {room(other, source) for other in imported(path, source)}
        out.setdefault(here, set()).update(others - {here})
    return out


def files(source: Path = SOURCE) -> dict[str, set[str]]:
    """Each file with the files that it imports; the `__init__` of a folder stands for nothing of its own."""
    return {
        str(path.relative_to(source)): {
            str(other.relative_to(source)) for other in imported(path, source) if other.name != "__init__.py"
        }
        for path in modules(source)
        if path.name != "__init__.py"
    }


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Groups that import each other, directly or by others (strongly connected, more than one)."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        todo = list(graph[start])
        while todo:
            node = todo.pop()
            if node not in seen:
                seen.add(node)
                todo.extend(graph.get(node, ()))
        reach[start] = seen
    found: list[set[str]] = []
    for node in graph:
        group = {other for other in reach[node] if node in reach.get(other, ())}
        if len(group) > 1 and group not in found:
            found.append(group)
    return found


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """The floor of each room; rooms in a circle have none that is above all they import."""
    floor = dict.fromkeys(graph, 0)
    for _ in graph:
        for node, others in graph.items():
            floor[node] = max([1 + floor[o] for o in others if o in floor and o != node], default=0)
            floor[node] = min(floor[node], len(graph))
    return floor


def main() -> None:
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else SOURCE
    graph = rooms(source)
    found = circles(graph) + circles(files(source))
    height = floors(graph) if not circles(graph) else {}
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in source.rglob("*.py"))
    for level in sorted(set(height.values())):
        print(f"floor {level}: {', '.join(sorted(name for name in height if height[name] == level))}")
    print(f"{len(graph)} rooms, {len(set(height.values())) or 'no'} floors, {sum(map(len, graph.values()))} arrows,")
    print(f"{len(found)} circles{''.join(': ' + ' <-> '.join(sorted(group)) for group in found)}")
    print(f"{len(list(source.glob('*.py')))} files at the root, {len(modules(source)) + 1} files, {lines} lines")


if __name__ == "__main__":
    main()
