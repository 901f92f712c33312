"""What the whole package keeps to: imports flow one way, files stay short, nothing is read unsafely."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "kickbench"
FILES = sorted(PACKAGE.rglob("*.py"))

# Left to right, as data flows (architecture.md). A module imports from its own room and from those before it.
ROOMS = (
    ("errors",),
    ("config",),
    ("symmetry",),
    ("sim",),
    ("envs",),
    ("nets",),
    ("trials",),
    ("results",),
    ("evaluation",),
    ("training",),
    ("bench",),
    ("audit",),
    ("robots",),
    ("view",),
    ("deploy",),
    ("report",),
    ("launch",),
    ("cli",),
    ("__main__",),
)
RANK = {name: rank for rank, room in enumerate(ROOMS) for name in room}
WITHOUT_LIBRARIES = {"", "errors", "config", "symmetry"}
ENGINES = {"engine", "cpu", "frames", "silence", "warp", "warp_contacts"}
HEAVY = {"torch", "tensordict", "rsl_rl", "mujoco", "mujoco_warp", "warp"}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    """`kickbench.config.base` -> `spec`; `kickbench` -> ``."""
    return (*module.split("."), "")[1]


def imports(path: Path, *, everywhere: bool = True) -> Iterator[tuple[str, str]]:
    """Place and full name of what a file imports; `everywhere`: in functions too."""
    for node in ast.walk(tree_of(path)) if everywhere else tree_of(path).body:
        where = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import):
            yield from ((where, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{where}: a relative import"
            # `from kickbench.config import load` may import the module kickbench.config.load.
            yield from ((where, f"{node.module}.{alias.name}") for alias in node.names)


def own_imports(path: Path) -> Iterator[tuple[str, str]]:
    """Place and room of what a file imports from the package."""
    rooms = ((where, room_of(name)) for where, name in imports(path) if name.startswith("kickbench."))
    return ((where, room) for where, room in rooms if room in RANK)


def test_every_module_has_a_place_in_the_order():
    rooms = {room_of(module_of(path)) for path in FILES}
    assert rooms - {""} == set(RANK), "a new room needs a rank in ROOMS and a line in architecture.md"


def test_a_file_name_means_one_thing():
    """A robot is a robot in every room that has it: its spec, and the verbs about it. So is an experiment."""
    names = Counter(path.stem for path in FILES)
    assert {name for name, count in names.items() if count > 1} == {"__init__", "experiment", "robot"}


def test_imports_flow_one_way():
    assert not [
        f"{where}: {room_of(module_of(path))} imports {room}"
        for path in FILES
        for where, room in own_imports(path)
        if RANK[room] > RANK.get(room_of(module_of(path)), -1) and path != PACKAGE / "__init__.py"
    ]


def test_the_public_api_imports_its_rooms_lazily():
    """Those in the package's own file are for type checkers: none is at its top level."""
    assert not [name for _, name in imports(PACKAGE / "__init__.py", everywhere=False) if "kickbench" in name]


def test_no_modules_import_each_other_in_a_circle():
    graph = {module_of(path): {name for _, name in imports(path, everywhere=False)} for path in FILES}
    finished: set[str] = set()

    def visit(module: str, chain: tuple[str, ...]) -> None:
        assert module not in chain, " -> ".join((*chain, module))
        if module in finished:
            return
        for name in sorted(graph[module]):
            target = name if name in graph else name.rpartition(".")[0]
            if target in graph and target != module:
                visit(target, (*chain, module))
        finished.add(module)

    for module in graph:
        visit(module, ())


def allowed_libraries(path: Path) -> set[str]:
    """Which of the heavy libraries a file may import."""
    module, room = module_of(path), room_of(module_of(path))
    if module == "kickbench.symmetry.torch_ops":
        return {"torch"}
    if room in WITHOUT_LIBRARIES:
        return set()
    if room in ("sim", "bench"):
        return HEAVY - {"rsl_rl"}
    if room in ("robots", "view"):
        return {"torch", "mujoco"}
    if room == "envs":
        return {"torch", "tensordict", "rsl_rl"}
    return HEAVY - {"mujoco", "mujoco_warp", "warp"}


def test_heavy_libraries_are_imported_only_where_they_belong():
    assert not [
        f"{where}: {name}"
        for path in FILES
        for where, name in imports(path)
        if name.split(".")[0] in HEAVY - allowed_libraries(path)
    ]


def test_engines_know_nothing_of_specs_and_scenes():
    files = [path for path in FILES if room_of(module_of(path)) == "sim" and path.stem in ENGINES]
    assert len(files) == len(ENGINES)
    own = {name for path in files for _, name in imports(path) if name.startswith("kickbench.")}
    assert not [name for name in own if name.split(".")[1] not in ("errors", "sim")]
    assert not [name for name in own if name.split(".")[1] == "sim" and name.split(".")[2] not in ENGINES]


def test_a_file_is_short_enough_to_read():
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in FILES}
    assert not {name: length for name, length in lengths.items() if length > 400}


def unsafe_call(node: ast.Call) -> bool:
    """`eval`, `exec`, pickled objects, and YAML that constructs objects."""
    name = ast.unparse(node.func)
    weights_only = [ast.unparse(keyword.value) for keyword in node.keywords if keyword.arg == "weights_only"]
    forbidden = {"eval", "exec", "yaml.load", "yaml.load_all", "yaml.unsafe_load", "yaml.full_load"}
    pickled = name.startswith("pickle.load") or (name == "torch.load" and not weights_only)
    return name in forbidden or pickled or weights_only not in ([], ["True"])


def test_nothing_is_read_unsafely():
    assert not [
        f"{path.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}"
        for path in FILES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call) and unsafe_call(node)
    ]


def test_every_module_says_what_it_is():
    assert not [str(path.relative_to(ROOT)) for path in FILES if not ast.get_docstring(tree_of(path))]
