"""Every source cited in the repository is in the repository or is a publication."""

import ast
import io
import re
import tokenize
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from sim_bridge.research.reference import write

ROOT = Path(__file__).parents[2]
PACKAGES = ("companion", "ground_station", "sim_bridge")
TOPS = (*PACKAGES, "tests", "examples", "params", "docs", "deploy")
KINDS = {".py", ".md", ".toml", ".service", ".json5", ".yml", ".yaml", ".cff"}
ME = Path(__file__).name

ELSEWHERE = {
    r"\bevaluation\.md\b": "the definitions are in docs/reference",
    r"\bfaults\.md\b": "not in the repository",
    r"\bbrief\.md\b": "the safety rules are in docs/explanation/safety-rules.md",
    r"\bhouse_(plan|style)\.md\b": "not in the repository",
    r"\b(autopilot|dependency)_facts\b": "docs/reference/autopilots.md",
    r"\bpaper\.tex\b": "arXiv 2604.13441",
    r"\bthe measured facts\b(?! about)": "docs/reference/autopilots.md",
    r"\bRows? \d+\b": "a row of a list that is not in the repository",
    r"(?<!PX4 )(?<!ArduPilot )\b[Ii]ssues? #?\d+\b": "a list that is not in the repository",
    r"/work/": "a path of one machine",
}
"""Sources that are not accessible outside the project, and the replacement to cite."""

NOT_CITED = {
    "params/wind/site.toml": "an example of a file that somebody writes",
    "companion/_params": "params, as the installed package carries it",
    **{
        f"sim_bridge/_reference/{name}": "tests/reference, as the installed package carries it"
        for name in ("ardupilot.json", "px4.json", "differences.toml")
    },
    "ground_station/adapters/web/assets": "fetched by `make map-assets`",
    "companion/crowd": "made up by test_structure.py",
}
"""Names that look like citations but are not."""

PATH = re.compile(
    r"(?<![\w/.{}-])((?:docs|params|tests|deploy|examples|companion|ground_station|sim_bridge)"
    r"/[\w./-]*\w)"
)
MARKDOWN = re.compile(r"(?<![\w/.{}*:-])([\w-][\w./-]*\.md)\b")
PLACEHOLDER = re.compile(r"\b[A-Z]{3,}\.(?!md)")
"""A placeholder, as in params/airframes/NAME.toml."""
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
RULE = re.compile(r"\bsafety rules? (\d+)\b")


@cache
def texts() -> tuple[tuple[Path, str], ...]:
    """Return every text of the repository except this file, which names the forbidden patterns."""
    paths = [path for top in TOPS for path in sorted((ROOT / top).rglob("*"))]
    paths += [path for path in sorted(ROOT.iterdir()) if path.is_file()]
    return tuple(
        (path, path.read_text(encoding="utf-8"))
        for path in paths
        if (path.suffix in KINDS or path.name == "Makefile")
        and path.is_file()
        and path.name != ME
        and "__pycache__" not in path.parts
    )


def lines_with(pattern: str, text: str) -> list[str]:
    lines = enumerate(text.splitlines(), start=1)
    return [f"{number}: {line.strip()}" for number, line in lines if re.search(pattern, line)]


def prose(text: str) -> str:
    """Return docstrings and comments of a module."""
    parts = [
        node.value.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return "\n".join([*parts, *(t.string for t in tokens if t.type == tokenize.COMMENT)])


@cache
def generated() -> frozenset[Path]:
    """Return the pages that `make docs` writes, whether present or not."""
    return frozenset(write.REFERENCE / path for path in write.generate_pages())


def is_there(path: Path) -> bool:
    """Return True if a file exists or is generated."""
    return path.exists() or path.resolve() in generated()


def unknown_paths(path: Path, text: str) -> list[str]:
    """Return paths cited by a text that exist neither in the repository nor next to the text.

    A name such as `page.md` is a citation in prose only: elsewhere it may be an output file.
    """
    named = {match[1] for match in PATH.finditer(text)}
    if MARKDOWN.search(text):
        words = prose(text) if path.suffix == ".py" else text
        named |= {match[1] for match in MARKDOWN.finditer(words)}
    bases = (ROOT, path.parent, ROOT / "docs", ROOT / "docs" / "reference")
    return sorted(
        name
        for name in named
        if name not in NOT_CITED
        and not PLACEHOLDER.search(name)
        and not ("tests" in path.parts and name.startswith("shared/"))
        and not any(is_there(base / name) for base in bases)
    )


def dead_links(path: Path, text: str) -> list[str]:
    """Return the relative links of a Markdown page whose target is missing."""
    targets = {match[1] for match in LINK.finditer(text) if path.suffix == ".md"}
    relative = {one for one in targets if "://" not in one and not one.startswith("mailto:")}
    return sorted(one for one in relative if not is_there(path.parent / one))


def unknown_rules(path: Path, text: str) -> list[str]:
    """Return the numbers of safety rules that the documents do not have."""
    named = set(RULE.findall(text))
    page = (ROOT / "docs" / "explanation" / "safety-rules.md").read_text() if named else ""
    numbers = re.findall(r"^#+ Rule (\d+):", page, flags=re.MULTILINE)
    return [f"safety rule {number}" for number in sorted(named.difference(numbers))]


def foreign_data(path: Path, text: str) -> list[str]:
    """Return the lines outside the tests that name data of other people."""
    is_test = path.relative_to(ROOT).parts[0] == "tests"
    return [] if is_test else lines_with(r"\bshared/|['\"]shared['\"]", text)


def assert_in_no_text(find: Callable[[Path, str], list[str]]) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{words}" for path, text in texts() for words in find(path, text)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("pattern", ELSEWHERE)
def test_nothing_is_cited_that_only_some_can_read(pattern: str) -> None:
    reason = ELSEWHERE[pattern]
    assert_in_no_text(lambda _, text: [f"{line}: {reason}" for line in lines_with(pattern, text)])


@pytest.mark.parametrize(
    "find",
    [
        foreign_data,
        dead_links,
        unknown_rules,
        pytest.param(unknown_paths, marks=pytest.mark.sample),
    ],
)
def test_what_is_cited_is_there(find: Callable[[Path, str], list[str]]) -> None:
    assert_in_no_text(find)


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        (r"\bevaluation\.md\b", "probabilities as in evaluation.md, section 8"),
        (r"\bRows? \d+\b", '"""Row 21. The operator chooses"""'),
        (r"(?<!PX4 )(?<!ArduPilot )\b[Ii]ssues? #?\d+\b", "see issue 17"),
        (r"/work/", "PYTHONPATH=/work/x"),
    ],
)
def test_each_forbidden_citation_is_seen(pattern: str, line: str) -> None:
    assert pattern in ELSEWHERE
    assert lines_with(pattern, f"first\n{line}") == [f"2: {line}"]


def test_a_path_that_is_not_there_is_seen() -> None:
    words = "see docs/nowhere.md, params/flights/default.toml and nothing.md; README.md is there"
    assert unknown_paths(ROOT / "x.md", words) == ["docs/nowhere.md", "nothing.md"]
    code = "# see nothing.md\nopen('made.md')\nhelp = 'docs/nowhere.md'\n"
    assert unknown_paths(ROOT / "x.py", code) == ["docs/nowhere.md", "nothing.md"]
    assert dead_links(
        ROOT / "x.md", "[a](README.md#x) [b](docs/none.md) [c](https://x.org/y.md)"
    ) == ["docs/none.md"]
