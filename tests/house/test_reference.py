"""The reference says what the code does: it is generated, and shipped files keep its schemas."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.reference import write
from sim_bridge.research.reference.formats import FOLDERS, WITHOUT_SCHEMA, formats, shipped
from sim_bridge.research.reference.json_schema import json_schema

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"
SHIPPED = [path for folder in FOLDERS for path in shipped(folder)]


def test_the_committed_reference_is_what_the_code_generates() -> None:
    wanted = write.pages()
    wrong = [
        str(path)
        for path, text in wanted.items()
        if not (REFERENCE / path).exists() or (REFERENCE / path).read_text() != text
    ]
    wrong += [str(path) for path in write.left_over(REFERENCE, set(wanted))]
    assert not wrong, f"run make docs-reference: {', '.join(wrong)}"


def test_every_folder_of_params_has_a_schema_or_a_reason_why_not() -> None:
    with_toml = {path.parent.name for path in (ROOT / "params").rglob("*.toml")}
    assert with_toml == set(FOLDERS) | set(WITHOUT_SCHEMA)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_shipped_file_keeps_the_schema_that_its_first_line_names(path: Path) -> None:
    first, _, _ = path.read_text().partition("\n")
    directive, _, target = first.partition(" ")
    assert directive == "#:schema"
    schema = json.loads((path.parent / target).read_text())
    table = tomllib.loads(path.read_text())
    assert schema["title"] == table["format"]
    jsonschema.Draft7Validator.check_schema(schema)
    jsonschema.Draft7Validator(schema).validate(table)


@pytest.mark.parametrize("format_", formats(), ids=lambda format_: format_.name)
def test_a_schema_is_draft_7_and_refuses_unknown_keys_everywhere(format_: Any) -> None:
    schema = json_schema(format_)
    jsonschema.Draft7Validator.check_schema(schema)
    tables = [schema, *schema["definitions"].values()]
    assert all(one["additionalProperties"] is False for one in tables if "properties" in one)


@pytest.mark.parametrize(
    ("path", "wrong"),
    [
        ("flights/default.toml", {"mission": {"max_loss": 0.6}}),
        ("flights/default.toml", {"mission": {"cruise_height_m": 4.0}}),
        ("flights/default.toml", {"mission": {"speed": "slow"}}),
        ("flights/default.toml", {"vehicle": {"airframe": "m100", "charge_frac": 1.5}}),
        ("flights/default.toml", {"vehicle": {"airframe": "m100", "colour": "red"}}),
        ("flights/default.toml", {"site": {}}),
        ("flights/default.toml", {"format": "flight/2"}),
        ("airframes/m100.toml", {"mass": {"empty_kg": 0.01, "max_payload_kg": 1.0}}),
        ("wind/coast.toml", {"memory_s": [0.5, 72.0, 1000.0]}),
        ("days/town.toml", {"truck": {"speed_mps": 41.0}}),
    ],
)
def test_what_the_schema_refuses_the_reader_refuses_too(path: str, wrong: dict[str, Any]) -> None:
    file = ROOT / "params" / path
    table = tomllib.loads(file.read_text())
    format_ = next(one for one in formats() if one.name == table["format"])
    validator = jsonschema.Draft7Validator(json_schema(format_))
    assert validator.is_valid(table)
    assert not validator.is_valid(table | wrong)
    msgspec.convert(table, format_.kind)
    with pytest.raises((msgspec.ValidationError, LeewayError)):
        msgspec.convert(table | wrong, format_.kind)
