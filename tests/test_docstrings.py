"""Every public name says what it is, with shapes, units, errors and source where these apply."""

import ast
import functools
import inspect
import re
import textwrap
from pathlib import Path

import pytest

import eladapt as ea

SHAPE = re.compile(r"\((\.\.\.|(\d|n|nv|nq|n_\w+|l|m|k|s|j|i|p|N)\b)[^()]*,[^()]*\)|[Aa] number|scalar")
UNIT = re.compile(r"\[[^\]]*\b(s|rad|m|mm|kg|N|N m|J|Hz|-)\b[^\]]*\]|SE3|in seconds|units of")
DOCS = Path(__file__).parents[1] / "docs"
# What has a unit, by the name of an argument, in this library.
TIMES = {"dt", "duration", "delay", "velocity_lag", "every", "after_fault", "patience"}


def members():
    """Public names, and the public methods and properties that their classes define themselves."""
    for name in ea.__all__:
        value = getattr(ea, name)
        yield name, value
        if inspect.isclass(value):
            for own, member in vars(value).items():
                function = getattr(member, "fget", None) or getattr(member, "func", None) or member
                function = getattr(function, "__func__", function)
                if not own.startswith("_") and inspect.isfunction(function):
                    yield f"{name}.{own}", function


NAMED = dict(members())
FUNCTIONS = {name: value for name, value in NAMED.items() if inspect.isfunction(value)}


def documented(name: str) -> str:
    """What the documentation says of a name: its own text, and that of its class."""
    said = inspect.getdoc(NAMED[name]) or ""
    return said if "." not in name else f"{said}\n{inspect.getdoc(NAMED[name.split('.')[0]])}"


@functools.cache
def raised(function) -> frozenset[str]:
    """The errors of this library that the function's own body raises by name."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    calls = [
        node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)
    ]
    names = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
    return frozenset(name for name in names if name.endswith("Error") and name[0].isupper())


@pytest.mark.parametrize("name", [name for name in NAMED if name != "FAULTS"])
def test_a_public_name_has_a_docstring(name):
    said = inspect.getdoc(NAMED[name])
    assert said, f"{name} has no docstring"


@pytest.mark.parametrize("name", [n for n, f in FUNCTIONS.items() if "ndarray" in str(inspect.signature(f))])
def test_arrays_have_shapes(name):
    """Whoever takes or returns an array says of what shape: (nv,), (N, nq), or a number."""
    assert SHAPE.search(documented(name)), f"{name} does not say the shape of its arrays"


@pytest.mark.parametrize(
    "name", [n for n, f in FUNCTIONS.items() if TIMES & set(inspect.signature(f).parameters)]
)
def test_times_have_units(name):
    assert UNIT.search(documented(name)), f"{name} does not say its units"


@pytest.mark.parametrize("name", [n for n, f in FUNCTIONS.items() if raised(f)])
def test_errors_are_named(name):
    """What a function raises itself stands in its text, by name or as any error of the library."""
    missing = [error for error in raised(FUNCTIONS[name]) if error not in documented(name)]
    assert not missing or "Raises" in documented(name), f"{name} raises {missing} and does not say so"


def equations():
    """(label, what computes it) of every row of the tables of docs/theory.md."""
    rows = re.findall(r"^\| \(([\w]+)\) \| [^|]+ \| (.+) \|$", (DOCS / "theory.md").read_text("utf-8"), re.M)
    return [(label, path) for label, cell in rows for path in re.findall(r"`(eladapt[\w.]+)`", cell)]


def found(path: str):
    """The object of a dotted path, and the module that it is in."""
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            module = importlib_import(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        value = module
        for part in parts[cut:]:
            value = getattr(value, part)
        return value, module
    raise AssertionError(path)


def importlib_import(name: str):
    import importlib

    return importlib.import_module(name)


@pytest.mark.parametrize(("label", "path"), equations())
def test_what_computes_an_equation_names_it(label, path):
    """The source is the paper's equation: a docstring, or that of its class or module, has the label."""
    value, module = found(path)
    owner = getattr(module, path.split(".")[-2], None) if inspect.isfunction(value) else None
    said = " ".join(inspect.getdoc(o) or "" for o in (value, owner, module) if o is not None)
    assert f"({label})" in said, f"{path} does not name ({label})"
