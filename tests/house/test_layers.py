"""Each contract of import-linter (pyproject.toml) fails for an import that it forbids."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINTER = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
CONTRACTS = LINTER.pop("contracts")
ROOT_PACKAGE = re.compile(rf'"({"|".join(LINTER["root_packages"])})(?=[."])')


def modules_and_forbidden_imports(contract: dict) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the modules that a contract names, and imports that it forbids."""
    match contract:
        case {"type": "layers", "layers": layers}:
            names = " | ".join(layers).split(" | ")
            homes = contract.get("containers", [""])
            modules = [f"{home}.{name}".strip(".") for home in homes for name in names]
            return modules, [(modules[-1], modules[0])]
        case {"type": "forbidden", "source_modules": sources, "forbidden_modules": others}:
            return sources + others, [(sources[0], others[0])]
        case {"type": "protected", "protected_modules": modules, "allowed_importers": allowed}:
            return modules + allowed, [(f"{modules[0].rpartition('.')[0]}.stranger", modules[0])]
        case {"type": "acyclic_siblings", "ancestors": ancestors}:
            one, other = (f"{ancestors[0]}.{name}" for name in "ab")
            return ancestors, [(one, other), (other, one)]
    raise AssertionError(contract)


def test_each_contract_fails_for_an_import_that_it_forbids(tmp_path: Path):
    tables: list[dict] = []
    for number, contract in enumerate(CONTRACTS):
        packages_of_its_own = ROOT_PACKAGE.sub(rf'"of_{number}_\1', json.dumps(contract))
        tables.append(json.loads(packages_of_its_own) | {"name": f"contract {number}"})
        modules, imports = modules_and_forbidden_imports(tables[-1])
        for name, line in {**dict.fromkeys(modules, ""), **dict(imports)}.items():
            if name.startswith("of_"):
                folder = tmp_path.joinpath(*name.split("."))
                folder.mkdir(parents=True, exist_ok=True)
                (folder / "__init__.py").write_text(line and f"import {line}\n")
    for folder in (path for path in tmp_path.rglob("*") if path.is_dir()):
        (folder / "__init__.py").touch()
    roots = {"root_packages": [path.name for path in tmp_path.iterdir()]}
    text = "[tool.importlinter]\n"
    for table in (LINTER | roots, *tables):
        text += "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        text += "[[tool.importlinter.contracts]]\n"
    (tmp_path / "pyproject.toml").write_text(text.rpartition("[[")[0])
    words = ["-c", "from importlinter.cli import lint_imports_command as run; run()", "--no-cache"]
    done = subprocess.run(
        [sys.executable, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    broken = re.findall(r"^contract (\d+) BROKEN$", done.stdout, re.MULTILINE)
    assert broken == [str(number) for number in range(len(CONTRACTS))], done.stdout + done.stderr
    assert done.returncode == 1
