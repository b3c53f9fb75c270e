"""Draws mutants: one changed expression of the shipped code each."""

import ast
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("companion", "ground_station", "sim_bridge/truth", "sim_bridge/autopilot")
COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """A change of one expression: file, position (line, column from, column to), new text."""

    file: str
    line: int
    columns: tuple[int, int]
    text: str

    @property
    def module(self) -> str:
        """Return the name of the module."""
        return self.file.removesuffix(".py").replace("/", ".")

    @property
    def key(self) -> str:
        """Return the name of the mutant."""
        return f"{self.file}:{self.line}:{self.columns[0]} {self.text}"

    def apply(self, source: str) -> str:
        """Return the source with the change."""
        lines = source.split("\n")
        line = lines[self.line - 1]
        first, last = self.columns
        lines[self.line - 1] = line[:first] + self.text + line[last:]
        return "\n".join(lines)


def draw(
    root: Path, importers: Mapping[str, list[str]], count: int, rng: random.Random
) -> list[Mutant]:
    """Draw `count` mutants of modules that tests import, each line at most once."""
    possible: list[Mutant] = []
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name = str(path.relative_to(root))
            if name.removesuffix(".py").replace("/", ".") in importers:
                possible += _mutants(name, path.read_text())
    rng.shuffle(possible)
    found: dict[tuple[str, int], Mutant] = {}
    for mutant in possible:
        if len(found) == count:
            break
        found.setdefault((mutant.file, mutant.line), mutant)
    return list(found.values())


def _mutants(name: str, source: str) -> Iterator[Mutant]:
    """Yield the changes of expressions on one line of ASCII within functions."""
    lines = source.split("\n")
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            line = getattr(node, "lineno", 0)
            if not line or line != getattr(node, "end_lineno", 0) or not lines[line - 1].isascii():
                continue
            changed = _changed(node)
            if changed is not None:
                yield Mutant(name, line, (node.col_offset, node.end_col_offset), changed)


def _changed(node: ast.AST) -> str | None:
    """Return the new text of an expression, or None where it is not changed."""
    match node:
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
            return f"({ast.unparse(left)} {COMPARISONS[type(op)]} {ast.unparse(right)})"
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            return f"({ast.unparse(left)} {OPERATORS[type(op)]} {ast.unparse(right)})"
        case ast.BoolOp(op=op, values=values):
            word = " or " if isinstance(op, ast.And) else " and "
            return "(" + word.join(ast.unparse(value) for value in values) + ")"
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return f"({ast.unparse(operand)})"
        case ast.IfExp(test=test, body=body, orelse=orelse):
            texts = (ast.unparse(one) for one in (orelse, test, body))
            return "({} if {} else {})".format(*texts)
        case ast.Constant(value=bool() as value):
            return repr(not value)
        case ast.Constant(value=int() | float() as value):
            return repr(value + 1)
        case _:
            return None
