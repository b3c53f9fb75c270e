"""Generated part of docs/reference: commands of the programs, schemas of the files."""

import json
from pathlib import Path

import typer
from typer.cli import get_docs_for_click

from companion.core.mission.alerts import Alert
from companion.core.mission.command_life_cycle import life_cycle_as_markdown
from companion.core.pilot.transitions import transitions_as_markdown, transitions_as_mermaid
from sim_bridge.app.fault_suite.catalogue import CATALOGUE
from sim_bridge.app.faults.fault import FaultCase
from sim_bridge.app.faults.verdict import AlertSent
from sim_bridge.research.reference.formats import WITHOUT_SCHEMA, list_file_formats
from sim_bridge.research.reference.json_schema import build_json_schema
from sim_bridge.research.reference.programs import CONSOLE_SCRIPTS, load_root_command
from sim_bridge.research.reference.schema_page import render_markdown_page

ROOT = Path(__file__).resolve().parents[3]
REFERENCE = ROOT / "docs" / "reference"
COMMAND = "make docs-reference"
MARK = f"<!-- Generated from the code by `{COMMAND}`: edit the code, not this page. -->\n"

ALERTS_HEAD = """# Alerts

Alerts of the companion: sent as STATUSTEXT to the ground station, and shown in its log, on the map
and at the desk. Text in braces is a parameter. A recording stores the identifier of each alert in
the field `alert` of the topic `said`.

| identifier | severity | text | recommended action |
| --- | --- | --- | --- |
"""

FAULTS_HEAD = """# Faults and what follows

Each row of [the fault suite](../how-to/fault-injection.md): the fault, the alert that the operator
receives (one of those listed; see [alerts](alerts.md)), and the checks of vehicle and companion by
number. Always checked: the fault took effect, no exception, no error exit code, no rise of the
energy estimate.
"""

FAULTS_COLUMNS = (
    "| row | fault | operator receives | checks |",
    "| --- | --- | --- | --- |",
)


COMMANDS_HEAD = """# Commands to the autopilot

States of a command, and for each kind of command: the evidence that ends it, who repeats it and how
long, and which newer decision of a person or another station ends it at once. A takeover ends all.

"""


def generate_pages() -> dict[Path, str]:
    """Return the text of each generated file by path below docs/reference."""
    return {
        **_command_pages(),
        **_schema_pages(),
        Path("alerts.md"): f"{MARK}\n{_alert_page()}",
        Path("fault-suite.md"): f"{MARK}\n{_fault_page()}",
        Path("mission-table.md"): f"{MARK}\n{_mission_table_page()}",
        Path("commands.md"): f"{MARK}\n{COMMANDS_HEAD}{life_cycle_as_markdown()}\n",
    }


def update_reference_files(folder: Path = REFERENCE) -> list[Path]:
    """Write changed files and remove obsolete ones; return the paths of both."""
    generated = generate_pages()
    touched: list[Path] = []
    for path, text in generated.items():
        file = folder / path
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
            touched.append(file)
    for file in obsolete_files(folder, set(generated)):
        file.unlink()
        touched.append(file)
    return touched


def _mission_table_page() -> str:
    head = (
        "# Mission table\n\nPhases of a flight and the transitions between them. Events that may"
        " occur in any phase (pilot override, lost link, reboot, abort) are in this table only."
    )
    return f"{head}\n\n```mermaid\n{transitions_as_mermaid()}\n```\n\n{transitions_as_markdown()}\n"


def obsolete_files(folder: Path, generated: set[Path]) -> list[Path]:
    """Return files in the generated folders that are no longer generated."""
    kept = [file for part in ("cli", "schemas") for file in sorted((folder / part).glob("*"))]
    return [file for file in kept if file.relative_to(folder) not in generated]


def _command_pages() -> dict[Path, str]:
    found: dict[Path, str] = {}
    lines = [MARK, "# Commands", "", "| program | what it is |", "| --- | --- |"]
    for program in CONSOLE_SCRIPTS:
        root = load_root_command(program)
        context = typer.Context(root, info_name=program)
        page = get_docs_for_click(obj=root, ctx=context, name=program)
        found[Path("cli") / f"{program}.md"] = f"{MARK}\n{page.rstrip()}\n"
        words = " ".join((root.help or "").split())
        lines.append(f"| [`{program}`](cli/{program}.md) | {words} |")
    lines += ["", "Each command prints the same text with `--help`."]
    found[Path("cli.md")] = "\n".join(lines) + "\n"
    return found


def _schema_pages() -> dict[Path, str]:
    found: dict[Path, str] = {}
    lines = [
        MARK,
        "# Files and messages",
        "",
        "Every configuration file and every message of the fleet is checked against a strict"
        " schema: an unknown key, a missing one or a number out of range is rejected, and the error"
        " contains file and key. The suffix of a key is its unit.",
        "",
        "| format | what it is | JSON Schema |",
        "| --- | --- | --- |",
    ]
    for one in list_file_formats():
        schema = build_json_schema(one)
        file = f"{one.stem}.json"
        found[Path("schemas") / file] = json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
        found[Path("schemas") / f"{one.stem}.md"] = f"{MARK}\n{render_markdown_page(schema, file)}"
        words = " ".join(schema["description"].split("\n\n")[0].split())
        lines.append(
            f"| [{one.name}](schemas/{one.stem}.md) | {words} | [{file}](schemas/{file}) |"
        )
    lines += [
        "",
        "An editor with Taplo support (such as VS Code with Even Better TOML) checks a TOML file"
        " during editing if its first line references the schema, as in `params/`:",
        "```",
        "#:schema ../../docs/reference/schemas/flight-1.json",
        "```",
        "Two kinds of file in `params/` have no schema, since they are not written by hand:",
        "",
        *(f"- {words}." for words in WITHOUT_SCHEMA.values()),
    ]
    found[Path("schemas.md")] = "\n".join(lines) + "\n"
    return found


def _alert_page() -> str:
    """Return the Markdown of the page, without the mark of generated pages."""
    rows = (
        f"| `{alert.identifier}` | {alert.severity.name.lower()} | {alert.text_template}"
        f" | {alert.recommended_action} |"
        for alert in Alert
    )
    return ALERTS_HEAD + "\n".join(rows) + "\n"


def _fault_page() -> str:
    """Return the Markdown of the page, without the mark of generated pages."""
    checks: dict[str, int] = {}
    rows = [_fault_row(case, checks) for case in CATALOGUE]
    legend = [f"{number}. {text}" for text, number in checks.items()]
    return "\n".join([FAULTS_HEAD, *legend, "", *FAULTS_COLUMNS, *rows]) + "\n"


def _fault_row(case: FaultCase, checks: dict[str, int]) -> str:
    """Return the row of a fault; new texts of checks are numbered in `checks`."""
    sent = [rule for rule in case.rules if isinstance(rule, AlertSent)]
    alerts = "; ".join(
        " or ".join(f"“{alert.text_template}”" for alert in rule.alerts) or "any alert"
        for rule in sent
    )
    texts = [
        " ".join((rule.__doc__ or "").partition("\n\n")[0].split())
        for rule in case.rules
        if rule not in sent
    ]
    numbers = ", ".join(str(checks.setdefault(text, len(checks) + 1)) for text in texts)
    return f"| {case.number} `{case.name}` | {case.description} | {alerts} | {numbers} |"
