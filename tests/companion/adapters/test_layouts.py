"""The shipped Foxglove and PlotJuggler layouts show all topics of decisions.mcap and no other."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from companion.adapters.files.params import params_dir
from companion.adapters.logs.decision_log import SCHEMAS
from companion.adapters.logs.foxglove_rows import FOXGLOVE

FIELDS = {f"/{topic}": set(fields) for topic, fields in SCHEMAS.items()} | {
    f"/{topic}": set(fields) for topic, (_, fields) in FOXGLOVE.items()
}
FOLDER = params_dir() / "layouts"


def values(document: Any) -> list[str]:
    """Return each topic, or topic and field, that a Foxglove layout shows."""
    if isinstance(document, list):
        return [value for part in document for value in values(part)]
    if not isinstance(document, dict):
        return []
    found = [
        value
        for key, value in document.items()
        if key in ("value", "topicToRender", "followTopic") and isinstance(value, str)
    ]
    return found + list(document.get("topicColors", {})) + values(list(document.values()))


def curves(path: Path) -> list[str]:
    """Return each series of a PlotJuggler layout."""
    return [curve.attrib["name"] for curve in ET.parse(path).iter("curve")]


def unknown(names: list[str], between: str) -> list[str]:
    wrong: list[str] = []
    for name in names:
        topic, _, field = name.lstrip("/").partition(between)
        fields = FIELDS.get(f"/{topic}")
        if fields is None or (field and field not in fields):
            wrong.append(name)
    return wrong


def test_foxgloves_layout_shows_what_is_in_the_log():
    document = json.loads((FOLDER / "foxglove.json").read_text())
    names = values(document)
    assert len(names) > 10
    assert unknown(names, ".") == []
    assert unknown(["/wind.n", "/nothing", "/wind.to_n_mps"], ".") == ["/wind.n", "/nothing"]


def panels(layout: Any) -> set[str]:
    if isinstance(layout, str):
        return {layout}
    return panels(layout["first"]) | panels(layout["second"])


def test_every_panel_of_foxgloves_layout_has_a_place_and_a_configuration():
    document = json.loads((FOLDER / "foxglove.json").read_text())
    assert panels(document["layout"]) == document["configById"].keys()


def test_plotjugglers_layout_shows_what_is_in_the_log():
    names = curves(FOLDER / "plotjuggler.xml")
    assert len(names) > 8
    assert unknown(names, "/") == []


@pytest.mark.parametrize("count", [plot.attrib for plot in ET.parse(
    FOLDER / "plotjuggler.xml").iter("DockSplitter")])  # fmt: skip
def test_plotjugglers_splitters_hold_as_many_plots_as_they_say(count):
    assert len(count["sizes"].split(";")) == int(count["count"])
