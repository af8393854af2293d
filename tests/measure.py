"""Print how the tree stands: `python tests/measure.py [ROOT]`.

Syntax trees only: nothing of the project is imported, so that any checkout can be measured.
"""

from __future__ import annotations

import ast
import statistics
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("jaxtube", "sets")
COMMANDS = "jaxtube.experiments"
LOOP = ("controller", "plant", "loop")
"""Names of arguments that are controllers or plants."""
MANY = 6
"""Arguments beyond which a signature is long."""


class Module:
    """One file: its name, lines and syntax tree."""

    def __init__(self, root: Path, path: Path):
        parts = path.relative_to(root).with_suffix("").parts
        self.is_package = parts[-1] == "__init__"
        self.name = ".".join(parts[:-1] if self.is_package else parts)
        text = path.read_text(encoding="utf-8")
        self.tree = ast.parse(text)
        self.lines = text.count("\n")
        self.code = find_code_lines(self.tree, text)

    @property
    def room(self) -> str:
        """Its package."""
        return self.name if self.is_package else self.name.rpartition(".")[0]

    def imports(self) -> Iterator[str]:
        """Yield the dotted names that the module imports, at any depth."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield from (f"{self._origin(node)}.{alias.name}" for alias in node.names)

    def _origin(self, node: ast.ImportFrom) -> str:
        if not node.level:
            return node.module or ""
        package = self.name.split(".") if self.is_package else self.name.split(".")[:-1]
        base = package[: len(package) - node.level + 1]
        return ".".join([*base, *([node.module] if node.module else [])])


def find_code_lines(tree: ast.AST, text: str) -> set[int]:
    """Return the numbers of the lines that are neither blank, comment nor docstring."""
    docstrings = set()
    for node in ast.walk(tree):
        if is_docstring(node):
            docstrings |= set(range(node.lineno, node.end_lineno + 1))
    return {
        number
        for number, line in enumerate(text.split("\n"), 1)
        if line.strip() and not line.strip().startswith("#") and number not in docstrings
    }


def is_docstring(node: ast.AST) -> bool:
    """Say whether a node is a text that stands by itself."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def read_modules(root: Path, folder: str) -> list[Module]:
    """Return the modules of a folder."""
    return [Module(root, path) for path in sorted((root / folder).rglob("*.py"))]


def nodes_a_line(module: Module) -> float:
    """Return syntax nodes a line of code; names of contexts and docstrings do not count."""
    ignored = (ast.Load, ast.Store, ast.Del, ast.Module)
    nodes = [node for node in ast.walk(module.tree) if not isinstance(node, ignored)]
    counted = [node for node in nodes if getattr(node, "lineno", None) in module.code]
    without_place = [node for node in nodes if not hasattr(node, "lineno")]
    return (len(counted) + len(without_place)) / max(len(module.code), 1)


def find_parallel_assignments(tree: ast.AST) -> list[ast.Assign]:
    """Return the assignments of a tuple, or of a generator, to a tuple; a swap is none."""
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple | ast.GeneratorExp | ast.ListComp)
        and not is_swap(node)
    ]


def is_swap(node: ast.Assign) -> bool:
    """Say whether an assignment permutes what it assigns to."""
    left = sorted(map(ast.unparse, getattr(node.targets[0], "elts", [])))
    return left == sorted(map(ast.unparse, getattr(node.value, "elts", [])))


def functions(module: Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a module, methods and nested ones too."""
    yield from (node for node in ast.walk(module.tree) if isinstance(node, ast.FunctionDef))


def arguments_of(function: ast.FunctionDef) -> list[ast.arg]:
    """Return the arguments of a function but `self` and `cls`."""
    listed = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return [argument for argument in listed if argument.arg not in ("self", "cls")]


def find_public_names(modules: list[Module]) -> dict[str, set[str]]:
    """Return public functions and classes of modules, and where each is defined."""
    homes = defaultdict(set)
    for module in modules:
        for node in module.tree.body:
            is_definition = isinstance(node, ast.FunctionDef | ast.ClassDef)
            if is_definition and not node.name.startswith("_"):
                homes[node.name].add(module.name)
    return homes


def find_deepest_chain(modules: list[Module]) -> int:
    """Return how many modules the longest chain of imports has."""
    names = {module.name for module in modules}
    edges = {module.name: set() for module in modules}
    for module in modules:
        for name in module.imports():
            parts = name.split(".")
            found = [".".join(parts[:end]) for end in range(len(parts), 0, -1)]
            target = next((candidate for candidate in found if candidate in names), None)
            if target and target != module.name and target not in PACKAGES:
                edges[module.name].add(target)
    depth: dict[str, int] = {}

    def measure(name: str, above: tuple[str, ...] = ()) -> int:
        if name not in depth:
            below = [measure(other, (*above, name)) for other in edges[name] if other not in above]
            depth[name] = 1 + max(below, default=0)
        return depth[name]

    return max(map(measure, names))


def count_untyped_loops(modules: list[Module]) -> int:
    """Return how many controllers and plants are arguments or fields without a type, or Any."""
    untyped = 0
    for module in modules:
        for function in functions(module):
            for argument in arguments_of(function):
                untyped += argument.arg in LOOP and is_untyped(argument.annotation)
        for node in ast.walk(module.tree):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                untyped += node.target.id in LOOP and is_untyped(node.annotation)
    return untyped


def is_untyped(annotation: ast.expr | None) -> bool:
    """Say whether an annotation says nothing."""
    return annotation is None or ast.unparse(annotation) == "Any"


def main(root: Path) -> None:
    """Print the measures of a checkout."""
    modules = [module for package in PACKAGES for module in read_modules(root, package)]
    tests = [
        module
        for module in read_modules(root, "tests")
        if module.name.split(".")[-1][:5] == "test_"
    ]
    lines = sum(module.lines for module in modules)
    rooms = Counter(module.room for module in modules)
    print(f"{'room':<36}{'files':>6}{'lines':>8}{'nodes a line':>14}")
    for room in sorted(rooms):
        mine = [module for module in modules if module.room == room]
        median = statistics.median(nodes_a_line(module) for module in mine)
        print(f"{room:<36}{len(mine):>6}{sum(module.lines for module in mine):>8}{median:>14.1f}")
    code = [module for module in modules if len(module.code) > 1]
    parallel = sum(len(find_parallel_assignments(module.tree)) for module in modules)
    long = [
        function
        for module in modules
        for function in functions(module)
        if len(arguments_of(function)) > MANY
    ]
    twice = [name for name, homes in find_public_names(modules).items() if len(homes) > 1]
    of_commands = [
        module.name
        for module in tests
        if any(name.startswith(COMMANDS) for name in module.imports())
    ]
    median = statistics.median(nodes_a_line(module) for module in code)
    print(f"\nfiles {len(modules)}, lines {lines}")
    print(f"syntax nodes a line, median over files   {median:.2f}")
    print(f"parallel assignments in 1,000 lines      {1000 * parallel / lines:.1f} ({parallel})")
    print(f"functions of more than {MANY} arguments        {len(long)}")
    print(f"deepest import chain                     {find_deepest_chain(modules)}")
    print(f"public names defined more than once      {len(twice)}")
    print(f"untyped controllers and plants           {count_untyped_loops(modules)}")
    print(f"test files that import the command line  {len(of_commands)} of {len(tests)}")
    if "--names" in sys.argv:
        print("\n".join(sorted(twice)))
        print("\n".join(of_commands))


if __name__ == "__main__":
    paths = [word for word in sys.argv[1:] if not word.startswith("-")]
    main(Path(paths[0]) if paths else Path(__file__).parents[1])
