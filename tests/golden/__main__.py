"""`python -m tests.golden --base COMMIT`: run base and working tree on this machine and compare.

The base is checked out into a worktree next to its outputs and runs with the same interpreter and
libraries. Exit code 1: a difference was found.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.golden.cases import Case, chosen, write_scenarios
from tests.golden.compare import TextTable, compare_files

ROOT = Path(__file__).resolve().parents[2]
TEXTS = Path(__file__).with_name("texts.toml")


def main() -> int:
    """Run the chosen set on both sides."""
    parser = argparse.ArgumentParser(prog="golden", description=__doc__)
    parser.add_argument("--base", required=True, help="commit that decided right")
    parser.add_argument("--set", default="six", choices=("two", "six", "full"), dest="size")
    parser.add_argument("--jobs", type=int, default=2, help="commands at a time")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="golden-") as made:
        folder = Path(made)
        base = folder / "tree"
        _git("worktree", "add", "--quiet", "--detach", str(base), asked.base)
        try:
            return _run(folder, base, chosen(asked.size), asked.jobs)
        finally:
            _git("worktree", "remove", "--force", str(base))


def _git(*words: str) -> None:
    subprocess.run(["git", *words], cwd=ROOT, check=True)


def _run(folder: Path, base: Path, cases: list[Case], jobs: int) -> int:
    for name in ("base", "now", "shared"):
        (folder / name).mkdir()
    write_scenarios(folder / "shared")
    table = tomllib.loads(TEXTS.read_text())["texts"]
    texts = TextTable([(pair["base"], pair["now"]) for pair in table])
    differing = 0
    first = [case for case in cases if not case.after]
    with ThreadPoolExecutor(jobs) as pool:
        for group in (first, [case for case in cases if case.after]):
            trees = (("base", base), ("now", ROOT))
            runs = [
                (case, [pool.submit(_command, folder, *side, case) for side in trees])
                for case in group
            ]
            for case, sides in runs:
                found = [words for side in sides if (words := side.result())]
                found = found or _compared(folder, case, texts)
                print(f"{case.name}: {'the same' if not found else found[0]}", flush=True)
                for words in found[1:8]:
                    print(f"  {words}")
                differing += bool(found)
    print(f"{len(cases) - differing} of {len(cases)} the same")
    return int(differing > 0)


def _command(folder: Path, side: str, tree: Path, case: Case) -> str:
    """Run one command in one tree; return a description of the failure."""
    places = {"out": folder / side, "base": folder / "base", "shared": folder / "shared"}
    words = [word.format(**places) for word in case.arguments]
    found = [str(next(iter(sorted(Path("/").glob(w[1:]))), w)) if "*" in w else w for w in words]
    program = [sys.executable, "-c", f"from {case.program} import main; main()", *found]
    environment = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        program, cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode in (0, 3):
        return ""
    last = (done.stderr or done.stdout).strip().splitlines()[-1:]
    return f"{side}: exit {done.returncode}: {' '.join(last)}"


def _compared(folder: Path, case: Case, texts: TextTable) -> list[str]:
    found: list[str] = []
    for pattern in case.files:
        base = sorted((folder / "base").glob(pattern))
        now = sorted((folder / "now").glob(pattern))
        if len(base) != 1 or len(now) != 1:
            return [f"{pattern}: {len(base)} files of the base, {len(now)} now, expected one each"]
        found += compare_files(base[0], now[0], texts)
    return found


if __name__ == "__main__":
    sys.exit(main())
