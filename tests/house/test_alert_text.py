"""No shipped code compares or parses the text of an alert: `parse_alert_text` alone maps it to the
identifier."""

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from string import Formatter

import pytest

from companion.core.mission.alerts import Alert

ROOT = Path(__file__).parents[2]
ALERTS = "companion/core/mission/alerts.py"
METHODS = {
    *("startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition", "split"),
    *("rsplit", "find", "rfind", "index", "count", "replace", "match", "search", "fullmatch"),
    *("compile", "sub", "findall", "finditer"),
}
LEAST = 7
"""Shorter fragments occur in other texts, too."""

LITERALS = [literal for one in Alert for literal, *_ in Formatter().parse(one.text_template)]
WHOLE = [text for one in LITERALS if len(text := one.strip(" :,()?")) >= LEAST and " " in text]
REGEX_SIGNS = re.compile(r"[\\^$.*+?()\[\]{}|]+")


@cache
def is_of_an_alert(text: str) -> bool:
    """Return whether a text holds a literal part of an alert's text, or a fragment of one.

    A single word without a colon is none: it is the name of a decision or a phase.
    """
    pieces = [piece.strip(" ,") for piece in REGEX_SIGNS.split(text)]
    pieces = [one for one in pieces if len(one) >= LEAST and (" " in one or one.endswith(":"))]
    return any(one in text for one in WHOLE) or any(
        piece in one for piece in pieces for one in LITERALS
    )


def alert_texts(node: ast.AST, known: dict[str, list[str]]) -> Iterator[str]:
    """Yield the texts of alerts in an expression; `known`: those that names hold."""
    for one in ast.walk(node):
        match one:
            case ast.Constant(value=str(text)) if is_of_an_alert(text):
                yield text
            case ast.Attribute(attr="text_template"):
                yield ast.unparse(one)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                yield from known.get(name, [])


@cache
def named_texts(source: str) -> dict[str, list[str]]:
    """Return the texts of alerts that a module assigns to names."""
    found: dict[str, list[str]] = {}
    for node in ast.walk(ast.parse(source)):
        match node:
            case (
                ast.Assign(targets=[ast.Name(id=name)], value=value)
                | ast.AnnAssign(target=ast.Name(id=name), value=value)
            ) if not isinstance(value, ast.Dict | ast.IfExp | None):
                found[name] = [*found.get(name, []), *alert_texts(value, {})]
    return found


def compared(nodes: Iterable[ast.AST]) -> Iterator[ast.expr]:
    """Yield the expressions that are compared, used for parsing, or keys of a table."""
    for node in nodes:
        match node:
            case ast.Compare(left=left, comparators=others):
                yield from (left, *others)
            case ast.Call(func=ast.Attribute(attr=name)) if name in METHODS:
                yield from node.args
            case ast.Dict(keys=keys):
                yield from filter(None, keys)
            case ast.MatchValue(value=value):
                yield value


def of_an_alert(source: str) -> list[str]:
    """Return the texts of alerts that are compared; imported names hold texts, too."""
    nodes, known = list(ast.walk(ast.parse(source))), dict(named_texts(source))
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and any(one.name.isupper() for one in node.names):
            path = ROOT / f"{(node.module or '').replace('.', '/')}.py"
            other = named_texts(path.read_text()) if path.is_file() else {}
            known |= {one.asname or one.name: other.get(one.name, []) for one in node.names}
    return [
        f"{one.lineno}: {text!r}" for one in compared(nodes) for text in alert_texts(one, known)
    ]


@pytest.mark.parametrize("package", ["companion", "ground_station", "sim_bridge"])
def test_no_shipped_code_compares_with_the_text_of_an_alert(package: str):
    found = [
        f"{path.relative_to(ROOT)}:{words}"
        for path in sorted((ROOT / package).rglob("*.py"))
        if str(path.relative_to(ROOT)) != ALERTS
        for words in of_an_alert(path.read_text())
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "code",
    [
        'text.startswith("companion released control")',
        '"turning back" in text',
        'text == "mission restored"',
        'home = text.removeprefix("landing site is now ")',
        'any(text in ("x", "position lost: x") for text in said)',
        'text.startswith("delivered: ")',
        '"by another station" in text',
        'text.endswith("disarm manually")',
        'RETURN = "turning back"\nRETURN in text',
        'TEXTS = ("turning back", "x")\ntext.startswith(TEXTS)',
        "from companion.core.pilot.estimators.shared_wind import SOURCE_TEXT as a\ntext == a",
        'text == f"landing site is now {site}"',
        'text == "landing site is now " + site',
        "text.startswith(Alert.GATE_CLOSED.text_template)",
        're.compile(r"^landing site (.+)$")',
        're.match("(position|link) lost|turning back", text)',
        'text.replace("turning back: ", "")',
        'match text:\n    case "mission restored" | "home restored": pass',
        '{"mission restored": 1}.get(text)',
    ],
)
def test_a_comparison_with_the_text_of_an_alert_is_found(code: str):
    assert of_an_alert(code)


def test_other_comparisons_are_none():
    assert not of_an_alert('phase == "outbound" or kind.startswith("mode ") or "RTL" in name')
    assert not of_an_alert('report("turning back: wind")\nRETURN = "turning back"\ntext == "x"')
