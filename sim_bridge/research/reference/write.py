"""The generated part of docs/reference: commands of the programs, and schemas of the files."""

import json
from pathlib import Path

from sim_bridge.research.reference.command_page import command_page
from sim_bridge.research.reference.formats import WITHOUT_SCHEMA, formats
from sim_bridge.research.reference.json_schema import json_schema
from sim_bridge.research.reference.programs import PROGRAMS, root_command
from sim_bridge.research.reference.schema_page import schema_page

ROOT = Path(__file__).resolve().parents[3]
REFERENCE = ROOT / "docs" / "reference"
COMMAND = "make docs-reference"
MARK = f"<!-- Generated from the code by `{COMMAND}`: edit the code, not this page. -->\n"


def pages() -> dict[Path, str]:
    """Path below docs/reference to the whole text of each generated file."""
    return _command_pages() | _schema_pages()


def write(folder: Path = REFERENCE) -> list[Path]:
    """Write what has changed, remove what is generated no more; the paths touched."""
    wanted = pages()
    touched: list[Path] = []
    for path, text in wanted.items():
        file = folder / path
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
            touched.append(file)
    for file in left_over(folder, set(wanted)):
        file.unlink()
        touched.append(file)
    return touched


def left_over(folder: Path, wanted: set[Path]) -> list[Path]:
    """Files in the generated folders that nothing generates."""
    kept = [file for part in ("cli", "schemas") for file in sorted((folder / part).glob("*"))]
    return [file for file in kept if file.relative_to(folder) not in wanted]


def _command_pages() -> dict[Path, str]:
    found: dict[Path, str] = {}
    lines = [MARK, "# Commands", "", "| program | what it is |", "| --- | --- |"]
    for program in PROGRAMS:
        root = root_command(program)
        page = command_page(program, root)
        found[Path("cli") / f"{program}.md"] = f"{MARK}\n{page}"
        words = " ".join((root.help or "").split())
        lines.append(f"| [`{program}`](cli/{program}.md) | {words} |")
    lines += ["", "Each command says the same with `--help`."]
    found[Path("cli.md")] = "\n".join(lines) + "\n"
    return found


def _schema_pages() -> dict[Path, str]:
    found: dict[Path, str] = {}
    lines = [
        MARK,
        "# Files and messages",
        "",
        "Every file that people write, and every message of the fleet, is checked against a strict"
        " schema: an unknown key, a missing one or a number out of range is refused, and the error"
        " names file and key. The end of a key is its unit.",
        "",
        "| format | what it is | JSON Schema |",
        "| --- | --- | --- |",
    ]
    for one in formats():
        schema = json_schema(one)
        file = f"{one.stem}.json"
        found[Path("schemas") / file] = json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
        found[Path("schemas") / f"{one.stem}.md"] = f"{MARK}\n{schema_page(schema, file)}"
        words = " ".join(schema["description"].split("\n\n")[0].split())
        lines.append(
            f"| [{one.name}](schemas/{one.stem}.md) | {words} | [{file}](schemas/{file}) |"
        )
    lines += [
        "",
        "An editor checks a TOML file while it is written (VS Code with Even Better TOML, or any"
        " that knows Taplo) where its first line names the schema, as those in `params/` do:",
        "```",
        "#:schema ../../docs/reference/schemas/flight-1.json",
        "```",
        "Two kinds of file in `params/` have no schema, since people do not write them:",
        "",
        *(f"- {words}." for words in WITHOUT_SCHEMA.values()),
    ]
    found[Path("schemas.md")] = "\n".join(lines) + "\n"
    return found
