"""`python -m tests.mutants`: share of seeded faults in the code that the tests detect.

Draws mutants of the shipped code (a changed comparison, operator, constant, condition or return
value), runs the tests that import the mutated module, and counts those that fail. The results are
kept in a journal, so that an interrupted run can be resumed. Compare the share before and after
tests are removed.
"""

import argparse
import ast
import json
import os
import random
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

from tests.mutants.draw import Mutant, draw

ROOT = Path(__file__).resolve().parents[2]
MOST_FILES = 8
"""Maximum number of test files per mutant: those that import its module, most specific first."""

LIMIT_S = 900.0
"""Timeout for the tests of one mutant: a mutant that hangs counts as detected."""


def main() -> None:
    """Run the drawn mutants and print the share that is detected."""
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--journal", type=Path, default=ROOT / "logs" / "mutants.jsonl")
    options = parser.parse_args()
    importers = _importers()
    drawn = draw(ROOT, importers, options.count, random.Random(options.seed))
    if not drawn:
        print("no mutant is drawn")
        return
    done = _read(options.journal)
    options.journal.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="mutants-") as made:
        tree = Path(made) / "tree"
        _git("worktree", "add", "--quiet", "--detach", str(tree), "HEAD")
        try:
            for mutant in drawn:
                if mutant.key not in done:
                    detected = _is_detected(tree, mutant, importers[mutant.module])
                    done[mutant.key] = detected
                    row = {"mutant": mutant.key, "detected": detected}
                    with options.journal.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                print(f"{'detected' if done[mutant.key] else 'MISSED':9}{mutant.key}", flush=True)
        finally:
            _git("worktree", "remove", "--force", str(tree))
    found = [done[mutant.key] for mutant in drawn]
    print(f"{sum(found)} of {len(found)} detected: {100.0 * sum(found) / len(found):.1f} %")


def _git(*words: str) -> None:
    subprocess.run(["git", *words], cwd=ROOT, check=True)


def _read(journal: Path) -> dict[str, bool]:
    if not journal.exists():
        return {}
    rows = [json.loads(line) for line in journal.read_text().splitlines()]
    return {row["mutant"]: row["detected"] for row in rows}


def _importers() -> dict[str, list[str]]:
    """Return the test files that import each module, those with the fewest imports first."""
    found: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        nodes = ast.walk(ast.parse(path.read_text()))
        modules = {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module}
        for module in modules:
            found[module].append((len(modules), str(path.relative_to(ROOT))))
    return {m: [name for _, name in sorted(files)][:MOST_FILES] for m, files in found.items()}


def _is_detected(tree: Path, mutant: Mutant, tests: list[str]) -> bool:
    """Run the tests in a tree with the mutant; restore the tree."""
    path = tree / mutant.file
    before = path.read_text()
    path.write_text(mutant.apply(before))
    words = ["-m", "pytest", "-x", "-q", "-m", "not night", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, *words],
            cwd=tree,
            env=environment,
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )
        return done.returncode != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_text(before)


if __name__ == "__main__":
    main()
