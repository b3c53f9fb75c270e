"""A patch that disables a guard replaces what exists: else its canary fails for another reason."""

import ast
from typing import Any

import pytest

from tests.sitl import fault_guards, test_trials

PATCHES = {name: guard.patch for name, guard in fault_guards.GUARDS.items()} | test_trials.GUARDS


def unknown_names(patch: str) -> list[str]:
    """Return attributes of imported modules that a patch uses and that do not exist."""
    names: dict[str, Any] = {}
    unknown: list[str] = []
    for statement in ast.parse(patch).body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            exec(ast.unparse(statement), names)
            continue
        for node in ast.walk(statement):
            root, *path = ast.unparse(node).split(".")
            if isinstance(node, ast.Attribute) and root in names and "(" not in "".join(path):
                found = names[root]
                for name in path:
                    found = getattr(found, name, None)
                unknown += [] if found is not None else [ast.unparse(node)]
    return unknown


@pytest.mark.parametrize("name", PATCHES)
def test_a_patch_replaces_what_exists(name):
    assert unknown_names(PATCHES[name]) == []


def test_a_stale_name_is_found():
    patch = "import companion.adapters.clock as c; c.AutopilotClock.t_s = c.AutopilotClock.now_s"
    assert unknown_names(patch) == ["c.AutopilotClock.now_s"]
