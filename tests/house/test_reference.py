"""The reference is generated from the code, and shipped files conform to its schemas."""

import json
import subprocess
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from companion.core.base.errors import LeewayError
from sim_bridge.research.reference import write
from sim_bridge.research.reference.formats import (
    FOLDERS,
    WITHOUT_SCHEMA,
    list_file_formats,
    shipped_toml_files,
)
from sim_bridge.research.reference.json_schema import build_json_schema

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "docs" / "reference"
SHIPPED = [path for folder in FOLDERS for path in shipped_toml_files(folder)]


pages = cache(write.generate_pages)


def tracked(folder: Path) -> set[str]:
    """Return the files below docs/reference that git tracks in the repository in `folder`."""
    listed = subprocess.run(
        ["git", "ls-files", "docs/reference"],
        cwd=folder,
        capture_output=True,
        check=True,
        text=True,
    )
    return set(listed.stdout.split())


def generated() -> set[str]:
    return {f"docs/reference/{path}" for path in pages()}


def test_no_generated_page_is_committed() -> None:
    assert not tracked(ROOT) & generated()


def test_canary_a_committed_page_is_noticed(tmp_path: Path) -> None:
    write.update_reference_files(tmp_path / "docs" / "reference")
    for words in (["init", "-q"], ["add", "docs/reference/alerts.md"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    assert tracked(tmp_path) & generated() == {"docs/reference/alerts.md"}


def test_pages_are_written_once_and_those_of_before_removed(tmp_path: Path) -> None:
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "old-1.json").write_text("{}")
    touched = write.update_reference_files(tmp_path)
    assert len(touched) == len(pages()) + 1
    assert not write.update_reference_files(tmp_path)
    assert not (tmp_path / "schemas" / "old-1.json").exists()


def test_every_folder_of_params_has_a_schema_or_a_reason_why_not() -> None:
    with_toml = {path.parent.name for path in (ROOT / "params").rglob("*.toml")}
    assert with_toml == set(FOLDERS) | set(WITHOUT_SCHEMA)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_shipped_file_keeps_the_schema_that_its_first_line_names(path: Path) -> None:
    first, _, _ = path.read_text().partition("\n")
    directive, _, target = first.partition(" ")
    assert directive == "#:schema"
    schema = json.loads(pages()[(path.parent / target).resolve().relative_to(REFERENCE)])
    table = tomllib.loads(path.read_text())
    assert schema["title"] == table["format"]
    jsonschema.Draft7Validator.check_schema(schema)
    jsonschema.Draft7Validator(schema).validate(table)


@pytest.mark.parametrize("format_", list_file_formats(), ids=lambda format_: format_.name)
def test_a_schema_is_draft_7_and_refuses_unknown_keys_everywhere(format_: Any) -> None:
    schema = build_json_schema(format_)
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
    format_ = next(one for one in list_file_formats() if one.name == table["format"])
    validator = jsonschema.Draft7Validator(build_json_schema(format_))
    assert validator.is_valid(table)
    assert not validator.is_valid(table | wrong)
    msgspec.convert(table, format_.kind)
    with pytest.raises((msgspec.ValidationError, LeewayError)):
        msgspec.convert(table | wrong, format_.kind)
