"""The documents: a front page of two screens, and every page reachable by links."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_BYTES, MOST_CHARACTERS = 8 * 1024, 120
LINK = re.compile(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)")
NAV_PAGE = re.compile(r"[:\-]\s*['\"]?([\w./-]+\.md)['\"]?\s*$", re.MULTILINE)


def too_long(text: str) -> list[str]:
    found = [] if len(text.encode()) <= MOST_BYTES else [f"{len(text.encode())} bytes"]
    lines = enumerate(text.splitlines(), start=1)
    return found + [f"line {n}: {len(line)}" for n, line in lines if len(line) > MOST_CHARACTERS]


def reached_from(starts: list[Path]) -> set[Path]:
    """Return the pages that are reachable by links."""
    seen: set[Path] = set()
    ahead = [path.resolve() for path in starts]
    while ahead:
        page = ahead.pop()
        if page in seen or not page.exists():
            continue
        seen.add(page)
        ahead += [(page.parent / target).resolve() for target in LINK.findall(page.read_text())]
    return seen


def test_the_readme_is_two_screens() -> None:
    assert not too_long((ROOT / "README.md").read_text())
    assert too_long("a" * 121) == ["line 1: 121"]
    assert too_long("a\n" * 5000) == ["10000 bytes"]


def test_every_page_of_the_documents_is_found_from_the_readme_or_the_sites_menu() -> None:
    docs = ROOT / "docs"
    starts = [ROOT / "README.md", docs / "index.md"]
    for menu in (ROOT / "mkdocs.yml", ROOT / "zensical.toml"):
        if menu.exists():
            starts += [docs / name for name in NAV_PAGE.findall(menu.read_text())]
    lost = sorted(set(docs.rglob("*.md")) - reached_from(starts))
    assert not lost, "\n".join(str(path.relative_to(ROOT)) for path in lost)


def test_a_page_that_no_link_leads_to_is_seen(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("[b](b.md#part)")
    (tmp_path / "b.md").write_text("[a](./a.md)")
    (tmp_path / "c.md").write_text("alone")
    assert {path.name for path in reached_from([tmp_path / "a.md"])} == {"a.md", "b.md"}
