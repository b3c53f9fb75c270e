"""Layout and naming of the code: small folders, unique names, no access to private names.

Import rules are contracts of import-linter (pyproject.toml); this file checks the rest.
"""

import ast
import re
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("companion", "ground_station", "sim_bridge")
MOST_MODULES = 20

CROWDED: dict[str, str] = {}
"""Folders that may hold more files, with the reason."""

PUBLIC_BY_DOCUMENT = {"os._exit"}
"""Names with an underscore that their library documents."""

OF_LIBRARIES = {"_timestamp"}
"""The only access to the time at which pymavlink received a message."""

NAMED_TUPLE = {"_asdict", "_replace", "_fields", "_make"}


def modules(*tops: str) -> Iterator[Path]:
    for top in tops:
        yield from sorted((ROOT / top).rglob("*.py"))


def crowded(paths: Iterable[Path]) -> list[str]:
    counts = Counter(path.parent for path in paths if path.name != "__init__.py")
    found = {str(folder.relative_to(ROOT)): count for folder, count in counts.items()}
    return [
        f"{folder}: {count} modules, at most {MOST_MODULES}"
        for folder, count in sorted(found.items())
        if count > MOST_MODULES and folder not in CROWDED
    ]


def classes_named_twice(sources: dict[str, str]) -> list[str]:
    """Return public top-level classes of different modules with the same name."""
    homes: defaultdict[str, list[str]] = defaultdict(list)
    for name, source in sources.items():
        for node in ast.parse(source).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(name)
    return [f"{name}: {', '.join(where)}" for name, where in sorted(homes.items()) if where[1:]]


def privates_touched(name: str, source: str) -> list[str]:
    """Return attributes and imports with an underscore that belong to another module."""
    nodes = list(ast.walk(ast.parse(source)))
    own = {
        node.attr
        for node in nodes
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id in ("self", "cls")
    }
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            own.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            own.add(node.id)
    found: list[str] = []
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            found += [
                f"{name}:{node.lineno}: import {one.name} from {node.module}"
                for one in node.names
                if _is_private(one.name)
            ]
        if not (isinstance(node, ast.Attribute) and _is_private(node.attr)):
            continue
        if isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"):
            continue
        if (
            node.attr not in own | NAMED_TUPLE | OF_LIBRARIES
            and ast.unparse(node) not in PUBLIC_BY_DOCUMENT
        ):
            found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
    return found


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def stand_ins(name: str, source: str) -> list[str]:
    """Return the uses of minus a billion seconds in place of None."""
    return [
        f"{name}:{node.lineno}: {ast.unparse(node)}"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.UnaryOp)
        and isinstance(node.op, ast.USub)
        and isinstance(node.operand, ast.Constant)
        and isinstance(node.operand.value, float)
        and node.operand.value in (1e8, 1e9, 1e10, 1e12)
    ]


def other_names_of_the_distribution(name: str, text: str) -> list[str]:
    """Return uses of `leeway`, a foreign package on the index; the distribution is leeway-uas."""
    wrong = re.compile(r"\bleeway\[|pip3? install (-\S+ )*['\"]?leeway(?!-uas)\b")
    return [
        f"{name}:{number}: {line.strip()}"
        for number, line in enumerate(text.splitlines(), start=1)
        if wrong.search(line)
    ]


@cache
def sources(*tops: str) -> dict[str, str]:
    return {str(path.relative_to(ROOT)): path.read_text() for path in modules(*tops)}


def test_no_folder_holds_more_modules_than_one_can_oversee() -> None:
    found = crowded(modules(*PACKAGES))
    assert not found, "\n".join(found)
    many = [ROOT / "companion" / "crowd" / f"m{k}.py" for k in range(MOST_MODULES + 1)]
    assert crowded(many) == ["companion/crowd: 21 modules, at most 20"]
    assert not crowded([*many[1:], many[0].with_name("__init__.py")])


@pytest.mark.sample
@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_class_has_a_name_of_its_own_within_its_program(package: str) -> None:
    found = classes_named_twice(sources(package))
    assert not found, "\n".join(found)


def test_a_second_class_of_a_name_is_seen() -> None:
    both = {"a.py": "class Verdict: ...\nclass _Own: ...", "b.py": "class Verdict: ...\n_Own = 1"}
    assert classes_named_twice(both) == ["Verdict: a.py, b.py"]


def test_nobody_touches_the_private_parts_of_another_module() -> None:
    named = sources(*PACKAGES, "tests", "examples")
    found = [line for name, text in named.items() for line in privates_touched(name, text)]
    assert not found, "\n".join(found)


def test_a_private_part_that_is_touched_is_seen() -> None:
    assert privates_touched("a.py", "from b import _c\nprint(pilot._leg)") == [
        "a.py:1: import _c from b",
        "a.py:2: pilot._leg",
    ]
    mine = "class A:\n    def __init__(self): self._x = 1\n    def same(self, o): return o._x"
    assert not privates_touched("a.py", mine)
    assert not privates_touched("a.py", "import os\nos._exit(0)\nrow._replace(a=1)")


def test_unknown_times_are_none() -> None:
    named = sources(*PACKAGES)
    found = [line for name, text in named.items() for line in stand_ins(name, text)]
    assert not found, "\n".join(found)
    assert stand_ins("a.py", "last_s: float = -1e9") == ["a.py:1: -1000000000.0"]


def test_the_distribution_is_called_leeway_uas_everywhere() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert table["project"]["name"] == "leeway-uas"
    texts = [*modules(*PACKAGES, "examples"), *ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    texts += [ROOT / "pyproject.toml", ROOT / "Makefile", *(ROOT / "deploy").rglob("*.service")]
    found = [
        line
        for path in texts
        for line in other_names_of_the_distribution(str(path.relative_to(ROOT)), path.read_text())
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("line", "is_wrong"),
    [
        ("pip install leeway", True),
        ("pip install -U 'leeway[sim]'", True),
        ("needs leeway[ground]", True),
        ("pip install leeway-uas", False),
        ("pip install 'leeway-uas[sim]'", False),
        ("git clone leeway", False),
    ],
)
def test_the_old_name_of_the_distribution_is_seen(line: str, is_wrong: bool) -> None:
    assert bool(other_names_of_the_distribution("a", line)) == is_wrong
