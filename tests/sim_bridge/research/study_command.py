"""One run of a study's command on one process, with its tables and its JSON in a folder."""

import json
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from sim_bridge.main import app


def run_study(folder: Path, *words: str) -> tuple[dict[str, Any], str]:
    """Return the JSON document and the printed text of `research` with these words."""
    outs = ["--jobs", "1", "--out", str(folder / "out"), "--json", str(folder / "out.json")]
    done = CliRunner().invoke(app, ["research", *words, *outs], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert not list((folder / "out").glob("*.partial"))
    return json.loads((folder / "out.json").read_text()), done.output
