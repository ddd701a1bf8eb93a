"""The rules of the structure that a parser can check: layers, owners, sizes."""

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "tirefit"
FILES = sorted(PACKAGE.rglob("*.py"))

# A module or package imports from lower layers and from itself. A new one needs a line.
LAYERS = {
    "results": 0,
    "files": 0,
    "padding": 0,
    "compiled": 1,
    "display": 1,
    "door": 1,
    "names": 0,
    "arrays": 0,
    "params": 1,
    "precision": 1,
    "settings": 1,
    "slip": 1,
    "models": 2,
    "data": 2,
    "fitting": 3,
    "online": 3,
    "diagnosis": 4,
    "sim": 4,
    "vehicle": 5,
    "report": 6,
    "targets": 6,
    "cli": 7,
}

# The same within a package; parts that are not named have no order. All parts may use effects,
# which read constants of rows.
WITHIN = {
    "diagnosis": {"engine": 1, "effects": 2, "rows": 2, "extended": 3, "summary": 4, "diagnose": 5},
    "fitting": {"problem": 1, "solve": 2, "uncertainty": 3, "verdict": 3, "mf": 4},
}

# Files in a folder, at most.
DRAWER = 20

# Third party -> where it may be imported, at the top or inside a function.
OWNERS = {
    "optimistix": "fitting/solve/least_squares.py",
    "jaxopt": "fitting/solve/least_squares.py",
    "emcee": "fitting/uncertainty/posterior.py",
    "matplotlib": "report/",
    "corner": "report/",
    "jinja2": "report/",
    "plotly": "report/",
    "diffrax": "sim/",
    "typer": "cli/",
}

MAX_BODY = 60
MAX_FILE = 400
# "file.py" or "file.py:function" -> why it may be longer.
LONG: dict[str, str] = {}


def place(path):
    return path.relative_to(PACKAGE).as_posix()


def module_of(file):
    return file.split("/")[0].removesuffix(".py")


@cache
def imported(tree):
    """(module, names) of every import statement, nested ones included."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, []) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            found.append((module, [alias.name for alias in node.names]))
    return found


def modules_used(tree):
    """Modules of tirefit that a file imports; a relative import is '.'."""
    for module, names in imported(tree):
        if module.startswith("."):
            yield "."
        elif module == "tirefit":
            yield from (name for name in names if name != "__version__")
        elif module.startswith("tirefit."):
            yield module.split(".")[1]


def layer_faults(file, tree):
    """Imports of a file that do not point downwards."""
    here = module_of(file)
    if here in ("__init__", "__main__"):  # above all layers: re-exports, starts the cli
        return []
    return [
        f"{file} imports {used}"
        for used in modules_used(tree)
        if used != here and LAYERS.get(used, 99) >= LAYERS[here]
    ]


def order_faults(file, tree):
    """Imports of a file from a higher part of its package."""
    package, here = f"{file}/".split("/")[:2]
    order, here = WITHIN.get(package, {}), here.removesuffix(".py")
    if here not in order:
        return []
    used = (f"{module}.".split(".") for module, _ in imported(tree))
    parts = {way[2] for way in used if way[:2] == ["tirefit", package]} - {"effects"}
    return [f"{file} imports {part}" for part in sorted(parts) if order.get(part, 0) > order[here]]


def owner_faults(file, tree):
    """Libraries imported outside the file or folder that owns them."""
    faults = []
    for module, _ in imported(tree):
        library = module.split(".")[0]
        owner = OWNERS.get(library, "")
        owned = file.startswith(owner) if owner.endswith("/") else file == owner
        if owner and not owned:
            faults.append(f"{file} imports {library}, which belongs to {owner}")
        if library in ("jax", "equinox") and file.startswith("data/"):
            faults.append(f"{file} imports {library}: data is plain NumPy")
        if module == "__future__":
            faults.append(f"{file} has a __future__ import: it switches off checks")
    return faults


def private_faults(file, tree):
    """Used names of other files that begin with an underscore, which are private."""
    return [
        f"{file} imports {name} from {module}, which is private"
        for module, names in imported(tree)
        for name in names
        if module.startswith("tirefit.") and name.startswith("_")
    ]


def docstring_lines(node):
    first = node.body[0] if node.body else None
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        if isinstance(first.value.value, str):
            return first.end_lineno - first.lineno + 1
    return 0


def size_faults(file, source, tree):
    """Functions and files longer than the limits, docstrings not counted."""
    sizes = {}
    documentation = docstring_lines(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            documentation += docstring_lines(node)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            text = docstring_lines(node)
            documentation += text
            body = node.end_lineno - node.body[0].lineno + 1 - text
            sizes[f"{file}:{node.name}"] = (body, MAX_BODY)
    sizes[file] = (len(source.splitlines()) - documentation, MAX_FILE)
    return [
        f"{name}: {size} lines, limit {limit}"
        for name, (size, limit) in sizes.items()
        if size > limit and name not in LONG
    ]


@pytest.mark.parametrize("path", FILES, ids=place)
def test_every_file_follows_the_rules(path):
    source = path.read_text()
    tree = ast.parse(source)
    file = place(path)
    assert module_of(file) in {*LAYERS, "__init__", "__main__"}, "a module without a layer"
    assert layer_faults(file, tree) == []
    assert order_faults(file, tree) == []
    assert owner_faults(file, tree) == []
    assert private_faults(file, tree) == []
    assert size_faults(file, source, tree) == []


def test_no_folder_is_a_drawer():
    folders = {path.parent for path in FILES}
    assert not {place(path) for path in folders if len([*path.glob("*.py")]) > DRAWER}


def test_every_exception_is_still_needed():
    for name, reason in LONG.items():
        file, _, function = name.partition(":")
        assert f"def {function}" in (PACKAGE / file).read_text() and len(reason) > 10
    assert len(FILES) > 10


@pytest.mark.parametrize(
    ("file", "source", "faults"),
    [
        ("models/x.py", "from tirefit.params import par", 0),
        ("models/x.py", "from tirefit.models.base import forces", 0),
        ("models/x.py", "from tirefit.data.table import Table", 1),
        ("data/x.py", "import tirefit.models", 1),
        ("fitting/x.py", "from tirefit import data, models, results", 0),
        ("fitting/x.py", "def f():\n    from tirefit.report import draw", 1),
        ("params.py", "from tirefit.slip import LOCKED", 1),
        ("results.py", "from tirefit.params import par", 1),
        ("fitting/x.py", "from . import least_squares", 1),
        ("fitting/x.py", "from tirefit.nowhere import x", 1),
        ("__init__.py", "from tirefit.cli import main", 0),
    ],
)
def test_the_layer_check_detects_violations(file, source, faults):
    assert len(layer_faults(file, ast.parse(source))) == faults


@pytest.mark.parametrize(
    ("file", "module", "faults"),
    [
        ("diagnosis/engine/x.py", "tirefit.diagnosis.effects", 0),
        ("diagnosis/engine/x.py", "tirefit.diagnosis.rows.subject", 1),
        ("diagnosis/rows/x.py", "tirefit.diagnosis.engine.fit", 0),
        ("diagnosis/extended.py", "tirefit.diagnosis.summary.result", 1),
        ("diagnosis/engine/x.py", "tirefit.models", 0),
        ("vehicle/x.py", "tirefit.diagnosis.diagnose", 0),
    ],
)
def test_the_order_within_a_package_is_checked(file, module, faults):
    assert len(order_faults(file, ast.parse(f"from {module} import x"))) == faults


@pytest.mark.parametrize(
    ("file", "source", "faults"),
    [
        ("fitting/solve/least_squares.py", "import optimistix as optx\nimport jaxopt", 0),
        ("fit/profile.py", "import optimistix as optx", 1),
        ("fit/profile.py", "def f():\n    from emcee.moves import StretchMove", 1),
        ("report/draw.py", "import matplotlib.pyplot as plt\nimport corner", 0),
        ("fitting/x.py", "import matplotlib.pyplot", 1),
        ("cli/", "import typer", 0),
        ("report/text.py", "import typer", 1),
        ("data/read.py", "import jax.numpy as jnp", 1),
        ("models/base.py", "import jax.numpy as jnp", 0),
        ("models/base.py", "from __future__ import annotations", 1),
    ],
)
def test_the_owner_check_detects_violations(file, source, faults):
    assert len(owner_faults(file, ast.parse(source))) == faults


def test_the_private_check_detects_violations():
    own = "from tirefit.files import PART, _mode\nfrom jax import _src"
    assert private_faults("cli/x.py", ast.parse(own)) == [
        "cli/x.py imports _mode from tirefit.files, which is private"
    ]


def test_the_size_check_detects_violations():
    def faults(source):
        return size_faults("x.py", source, ast.parse(source))

    body = "    y = 1\n" * 60
    documented = '    """Long.\n' + "\n" * 80 + '    """\n'
    assert faults("def f():\n" + documented + body) == []
    assert faults("def f():\n" + body + "    y = 2\n") == ["x.py:f: 61 lines, limit 60"]
    assert faults("y = 1\n" * 400) == []
    assert faults("y = 1\n" * 401) == ["x.py: 401 lines, limit 400"]
    in_class = "class A:\n    def f(self):\n" + "        y = 1\n" * 61
    assert faults(in_class) == ["x.py:f: 61 lines, limit 60"]


def imports_of(root):
    """Module -> modules of the same root that it imports at its top."""
    files = {}
    for path in root.rglob("*.py"):
        name = ".".join(path.relative_to(root.parent).with_suffix("").parts)
        files[name.removesuffix(".__init__")] = path
    found = {}
    for name, path in files.items():
        used = set()
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                each = [f"{node.module}.{alias.name}" for alias in node.names]
                used |= {one if one in files else node.module for one in each}
            elif isinstance(node, ast.Import):
                used |= {alias.name for alias in node.names}
        found[name] = used & set(files) - {name}
    return found


def circle(imports):
    """Modules that import each other in a circle; empty without one."""
    done = set()

    def walk(name, path):
        if name in path:
            return path[path.index(name) :]
        if name in done:
            return []
        done.add(name)
        for used in sorted(imports[name]):
            if found := walk(used, [*path, name]):
                return found
        return []

    for name in sorted(imports):
        if found := walk(name, []):
            return found
    return []


@pytest.mark.parametrize("root", [PACKAGE, PACKAGE.parent / "fits"], ids=lambda root: root.name)
def test_no_modules_import_each_other_in_a_circle(root):
    assert circle(imports_of(root)) == []


def test_a_circle_is_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c"]
