"""What the repository cites is in the repository, or is a publication: everybody can look it up."""

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOPS = (
    "companion",
    "ground_station",
    "sim_bridge",
    "tests",
    "examples",
    "params",
    "docs",
    "deploy",
)
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
"""What nobody who clones the repository can look up, and what to cite in its place."""

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
"""Names that look like citations and are none."""

PATH = re.compile(
    r"(?<![\w/.{}-])((?:docs|params|tests|deploy|examples|companion|ground_station|sim_bridge)"
    r"/[\w./-]*\w)"
)
MARKDOWN = re.compile(r"(?<![\w/.{}*:-])([\w-][\w./-]*\.md)\b")
PLACEHOLDER = re.compile(r"\b[A-Z]{3,}\.(?!md)")
"""As in params/airframes/NAME.toml."""
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
RULE = re.compile(r"\bsafety rules? (\d+)\b")


@cache
def texts() -> tuple[tuple[Path, str], ...]:
    """Every text of the repository but this one, which has to name what it forbids."""
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


def lines_with(pattern: str, text: str) -> list[tuple[int, str]]:
    found = re.compile(pattern)
    return [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), start=1)
        if found.search(line)
    ]


def prose(text: str) -> str:
    """Docstrings and comments of a module."""
    parts = [
        node.value.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return "\n".join([*parts, *(t.string for t in tokens if t.type == tokenize.COMMENT)])


def unknown_paths(path: Path, text: str) -> list[str]:
    """Paths that a text names and that are not there: of the repository, or beside the text.

    A name such as `page.md` is a citation in prose only: elsewhere it may be a file to write.
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
        and not any((base / name).exists() for base in bases)
    )


def dead_links(folder: Path, text: str) -> list[str]:
    """Relative links of a Markdown page that lead nowhere."""
    targets = {match[1] for match in LINK.finditer(text)}
    relative = {one for one in targets if "://" not in one and not one.startswith("mailto:")}
    return sorted(one for one in relative if not (folder / one).exists())


@pytest.mark.parametrize("pattern", ELSEWHERE)
def test_nothing_is_cited_that_only_some_can_read(pattern: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line}"
        for path, text in texts()
        for number, line in lines_with(pattern, text)
    ]
    assert not found, "\n".join([ELSEWHERE[pattern], *found])


def test_other_peoples_data_is_named_by_tests_only() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line}"
        for path, text in texts()
        if path.relative_to(ROOT).parts[0] != "tests"
        for number, line in lines_with(r"\bshared/|['\"]shared['\"]", text)
    ]
    assert not found, "\n".join(found)


def test_a_path_that_is_named_is_there() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, text in texts()
        for name in unknown_paths(path, text)
    ]
    assert not found, "\n".join(found)


def test_a_link_of_a_page_leads_somewhere() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {target}"
        for path, text in texts()
        if path.suffix == ".md"
        for target in dead_links(path.parent, text)
    ]
    assert not found, "\n".join(found)


def test_a_safety_rule_that_is_named_is_numbered_in_the_documents() -> None:
    page = ROOT / "docs" / "explanation" / "safety-rules.md"
    numbers = set(re.findall(r"^#+ Rule (\d+):", page.read_text(), flags=re.MULTILINE))
    found = [
        f"{path.relative_to(ROOT)}: safety rule {number}"
        for path, text in texts()
        for number in RULE.findall(text)
        if number not in numbers
    ]
    assert not found, "\n".join(found)


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
    assert lines_with(pattern, f"first\n{line}") == [(2, line)]


def test_a_path_that_is_not_there_is_seen() -> None:
    words = "see docs/nowhere.md, params/flights/default.toml and nothing.md; README.md is there"
    assert unknown_paths(ROOT / "x.md", words) == ["docs/nowhere.md", "nothing.md"]
    code = "# see nothing.md\nopen('made.md')\nhelp = 'docs/nowhere.md'\n"
    assert unknown_paths(ROOT / "x.py", code) == ["docs/nowhere.md", "nothing.md"]
    assert dead_links(ROOT, "[a](README.md#x) [b](docs/none.md) [c](https://x.org/y.md)") == [
        "docs/none.md"
    ]
