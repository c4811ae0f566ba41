"""The shape of the house: which module may import what, and what none may do."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "hybrid"

# Top to bottom; modules of one line may import each other, and everything below.
FLOORS = (
    {"__main__", "cli"},
    {"views"},
    {"report"},
    {"fleets"},
    {"diagnosis"},
    {"calibration"},
    {"exports"},
    {"online"},
    {"identification"},
    {"regression"},
    {"excitation"},
    {"model"},
    {"compensator"},
    {"servo"},
    {"plant"},
    {"inspect"},
    {"dynamics"},
    {"effects"},
    {"signals"},
    {"recording"},
    {"robot"},
    {
        "arguments",
        "arrays",
        "examples",
        "extras",
        "files",
        "names",
        "parameters",
        "progress",
        "shown",
        "statistics",
        "templates",
        "errors",
        "threads",
    },
)
LEVEL = {name: -depth for depth, names in enumerate(FLOORS) for name in names}

# Library -> the only places that may import it, and what others do instead.
HOMES = {
    "mujoco": (
        ("robot", "plant", "servo"),
        "ask Robot for the model, or import it under TYPE_CHECKING",
    ),
    "pinocchio": (("robot",), "use hybrid.dynamics"),
    "torch": (
        ("exports",),
        "compute with NumPy",
    ),
    "matplotlib": (("report",), "return numbers, and draw them in hybrid.report"),
    "plotly": (("report",), "return numbers, and draw them in hybrid.report"),
}
HEAVY = ("torch", "mujoco", "pinocchio", "sklearn", "matplotlib", "scipy", "clarabel")
# Writes functions of operations and numbers; no text of a file gets into them.
CODE_FROM_LAWS = "dynamics.law"
CODE_FROM_DATA = {"pickle", "joblib", "dill", "cloudpickle", "shelve", "marshal"}


@dataclass(frozen=True)
class Import:
    """One imported module: its dotted name and where and how it is imported."""

    module: str
    line: int
    typing: bool
    lazy: bool


@dataclass(frozen=True)
class Source:
    """One parsed module; ``name`` is dotted, without the leading ``hybrid.``."""

    name: str
    tree: ast.Module

    @property
    def floor(self) -> str:
        return self.name.partition(".")[0]

    def at(self, line: int) -> str:
        return f"hybrid.{self.name}:{line}"


@cache
def sources() -> tuple[Source, ...]:
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        name = name.removesuffix(".__init__")
        if name != "__init__":  # the public API stands above the floors
            found.append(Source(name, ast.parse(path.read_text("utf-8"), str(path))))
    return tuple(found)


def imports(
    node: ast.AST, typing: bool = False, lazy: bool = False
) -> Iterator[Import]:
    """Imports below a node; ``typing`` and ``lazy`` say where the node stands."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for alias in child.names:
                yield Import(alias.name, child.lineno, typing, lazy)
        elif isinstance(child, ast.ImportFrom):
            module = "." * child.level + (child.module or "")
            for alias in child.names:
                yield Import(f"{module}.{alias.name}", child.lineno, typing, lazy)
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for inner in child.body:
                yield from imports(ast.Module([inner], []), True, lazy)
            for inner in child.orelse:
                yield from imports(ast.Module([inner], []), typing, lazy)
        else:
            deep = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))
            yield from imports(child, typing, lazy or deep)


@cache
def imports_of(source: Source) -> tuple[Import, ...]:
    return tuple(imports(source.tree))


def within(name: str, place: str) -> bool:
    return name == place or name.startswith(place + ".")


def check(violations: list[str], advice: str) -> None:
    assert not violations, "\n".join([advice, *violations])


def test_every_module_stands_on_a_floor():
    strange = sorted({s.floor for s in sources()} - set(LEVEL))
    check(strange, "Add these to FLOORS in this test, where they belong:")


def test_imports_point_down_only():
    wrong = []
    for source in sources():
        for i in imports_of(source):
            top, _, rest = i.module.partition(".")
            target = rest.partition(".")[0]
            if i.module.startswith("."):
                wrong.append(f"{source.at(i.line)} is relative; write it from hybrid")
            elif top == "hybrid" and target != "__version__":
                if target not in LEVEL:
                    wrong.append(
                        f"{source.at(i.line)} imports {target or 'hybrid'} from the "
                        "public API; import it from the module it lives in"
                    )
                elif target != source.floor and LEVEL[target] > LEVEL[source.floor]:
                    wrong.append(f"{source.at(i.line)} imports {i.module}")
    check(wrong, "Imports point down; move the shared part to the lower floor:")


def test_imports_run_in_no_circle_lazily_closed_or_not():
    named = {source.name for source in sources()}
    below = {}
    for source in sources():
        names = [
            i.module.removeprefix("hybrid.")
            for i in imports_of(source)
            if i.module.startswith("hybrid.") and not i.typing
        ]
        names = [n if n in named else n.rpartition(".")[0] for n in names]
        below[source.name] = {n for n in names if n in named and n != source.name}
    try:
        list(TopologicalSorter(below).static_order())
    except CycleError as error:
        check(error.args[1], "Move what both need to a module below:")


def test_effects_know_no_robot_plant_or_fit():
    wrong = [
        f"{source.at(i.line)} imports {i.module}"
        for source in sources()
        if source.floor == "effects"
        for i in imports_of(source)
        if any(
            within(i.module, f"hybrid.{x}")
            for x in ("robot", "plant", "identification")
        )
    ]
    check(wrong, "An effect sees a Motion and a Body only; pass what it needs:")


@pytest.mark.parametrize("library", HOMES)
def test_libraries_stay_at_home(library):
    homes, instead = HOMES[library]
    wrong = [
        f"{source.at(i.line)} imports {i.module}"
        for source in sources()
        for i in imports_of(source)
        if library in i.module.split(".") and not i.module.startswith("hybrid")
        if not i.typing and not any(within(source.name, home) for home in homes)
    ]
    check(wrong, f"{library} is imported in {', '.join(homes)} only; {instead}:")


def test_torch_loads_with_a_torch_module_and_not_before():
    wrong = []
    for source in sources():
        bases = [
            ast.unparse(base)
            for node in ast.walk(source.tree)
            if isinstance(node, ast.ClassDef)
            for base in node.bases
        ]
        if not any(base.endswith("Module") for base in bases):
            wrong += [
                source.at(i.line)
                for i in imports_of(source)
                if "torch" in i.module.split(".") and not (i.typing or i.lazy)
            ]
    check(wrong, "Import torch inside the function that needs it:")


def test_nobody_touches_the_global_state_of_pyplot():
    wrong = [
        source.at(i.line)
        for source in sources()
        for i in imports_of(source)
        if i.module.startswith("matplotlib.pyplot")
    ]
    check(wrong, "Draw on a matplotlib.figure.Figure of your own:")


def test_only_the_command_line_prints():
    wrong = [
        source.at(node.lineno)
        for source in sources()
        if source.floor != "cli"
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "print"
    ]
    check(wrong, "Return the text and let hybrid.cli print it:")


def test_no_code_comes_out_of_a_data_file():
    wrong = []
    for source in sources():
        wrong += [
            f"{source.at(i.line)} imports {i.module}"
            for i in imports_of(source)
            if i.module.partition(".")[0] in CODE_FROM_DATA
        ]
        for node in ast.walk(source.tree):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                unpickles = any(
                    k.arg == "allow_pickle" and ast.unparse(k.value) != "False"
                    for k in node.keywords
                )
                runs = name in ("eval", "exec") and source.name != CODE_FROM_LAWS
                if unpickles or runs or name in (
                    "torch.load", "yaml.load", "yaml.unsafe_load"
                ):  # fmt: skip
                    wrong.append(f"{source.at(node.lineno)} calls {name}")
    check(wrong, "Use JSON, yaml.safe_load or plain NPZ instead of:")


def test_everything_public_has_a_docstring():
    wrong = []
    for source in sources():
        if not ast.get_docstring(source.tree):
            wrong.append(source.at(1))
        wrong += [
            f"{source.at(node.lineno)} {node.name}"
            for node in source.tree.body
            if isinstance(node, (ast.FunctionDef, ast.ClassDef))
            and not node.name.startswith("_")
            and not ast.get_docstring(node)
        ]
    check(wrong, "Say what it is, with shapes and units:")


def test_data_are_frozen():
    """Private ones that a single function fills may not be."""
    wrong = [
        f"{source.at(node.lineno)} {node.name}"
        for source in sources()
        for node in ast.walk(source.tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        for mark in map(ast.unparse, node.decorator_list)
        if mark.startswith("dataclass") and "frozen=True" not in mark
    ]
    check(wrong, "Make these @dataclass(frozen=True):")


def run(code: str) -> str:
    """Standard output of a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_hybrid_is_light():
    loaded = run(f"import sys, hybrid; print(*(set(sys.modules) & set({HEAVY})))")
    check(loaded.split(), "`import hybrid` loads these; import them where used:")


def test_import_hybrid_takes_less_than_a_fifth_of_a_second():
    timed = (
        "import time; start = time.perf_counter(); import hybrid; "
        "print(time.perf_counter() - start)"
    )
    fastest = min(float(run(timed)) for _ in range(3))
    assert fastest < 0.2, f"`import hybrid` takes {fastest:.2f} s: import less"


@pytest.mark.parametrize("floor", ["identification", "cli"])
def test_torch_and_matplotlib_wait_until_they_are_needed(floor):
    loaded = run(
        f"import sys, hybrid.{floor}; "
        "print(*(set(sys.modules) & {'torch', 'matplotlib'}))"
    )
    check(loaded.split(), f"`import hybrid.{floor}` loads these; import where used:")


def test_no_folder_has_the_name_of_a_public_function():
    folders = {p.name for p in PACKAGE.iterdir()}
    run(f"import hybrid; assert not set(hybrid.__all__) & {folders!r}")


def test_every_public_name_is_there():
    missing = run(
        "import hybrid; print(*(n for n in hybrid.__all__ if not hasattr(hybrid, n)))"
    )
    check(missing.split(), "hybrid/__init__.py promises what no module has:")


def test_an_unknown_name_is_an_attribute_error():
    import hybrid

    with pytest.raises(AttributeError, match="no attribute 'robott'"):
        hybrid.robott  # noqa: B018
