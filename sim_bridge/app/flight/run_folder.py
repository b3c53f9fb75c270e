"""Output folder of a run, unique for each run, and the digest of a run's inputs."""

import contextlib
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError

SOURCE_ROOT = Path(__file__).parents[3]


def create_unique_run_dir(root: Path, stem: str) -> Path:
    """Create `root/stem`, or `root/stem-N` if it exists. Raise LeewayError if no name is free."""
    for attempt in range(1, 10_000):
        run_dir = root / (stem if attempt == 1 else f"{stem}-{attempt}")
        with contextlib.suppress(FileExistsError):
            run_dir.mkdir(parents=True)
            return run_dir
    raise LeewayError(f"{root}: no free name like {stem}-N")


@contextlib.contextmanager
def mark_if_interrupted(run_dir: Path) -> Iterator[None]:
    """Write a file INTERRUPTED into the folder if a signal ends the run."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        (run_dir / "INTERRUPTED").write_text("stopped by a signal before the flight's end\n")
        raise


def compute_inputs_digest(options: Mapping[str, object], files: Iterable[Path]) -> str:
    """Return a digest of all inputs of a run: options, files, parameters and the program itself."""
    texts = {name: str(value) for name, value in options.items()}
    digest = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    packages = (SOURCE_ROOT / name for name in ("companion", "ground_station", "sim_bridge"))
    program = (path for package in packages for path in package.rglob("*.py"))
    for path in sorted(p for p in (*files, *params_dir().rglob("*"), *program) if p.is_file()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
