"""Every field of the shared state has one writer: the module that `state.py` names above it."""

import ast
import re
from pathlib import Path

import sim_bridge.autopilot.state

ROOM = Path(sim_bridge.autopilot.state.__file__).parent
SOURCE = (ROOM / "state.py").read_text()


def owners() -> dict[str, str]:
    """Return the writer of each field of `VehicleState`, by the comments between them."""
    owner, found = "", {}
    for line in SOURCE[SOURCE.index("class VehicleState") :].splitlines():
        if line.startswith("    # "):
            owner = line.removeprefix("    # written by ").removeprefix("    # ")
        elif match := re.match(r"    (\w+): ", line):
            found[match[1]] = owner
        elif line.startswith("    @property"):
            break
    return found


def writes(tree: ast.AST) -> set[str]:
    """Return the attributes that a module assigns on the shared state, under any of its names."""
    return {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and ast.unparse(node.value).rpartition(".")[2].lstrip("_") in ("state", "vehicle")
    }


def test_every_field_names_its_writer_and_the_writers_exist() -> None:
    written_by = owners()
    assert {"t_s", "mode", "params"} <= written_by.keys()
    assert set(written_by.values()) == {"fixed", "autopilot.py", "flight/commander.py"}


def test_nobody_but_its_owner_writes_a_field_of_the_shared_state() -> None:
    written_by = owners()
    strangers = [
        f"{path.relative_to(ROOM)}: {name} belongs to {written_by[name]}"
        for path in sorted(ROOM.rglob("*.py"))
        for name in writes(ast.parse(path.read_text())) & written_by.keys()
        if path.relative_to(ROOM).as_posix() != written_by[name]
    ]
    assert strangers == []
