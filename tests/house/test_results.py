"""Results pages: their commands exist, their text is plain, and an old page survives a stop."""

import json
import os
import re
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import typer
from rich.console import Console, Group
from rich.table import Table

from companion.core.base.errors import LeewayError
from sim_bridge.research.reference.programs import PROGRAMS, root_command
from sim_bridge.research.result_pages import tables, write
from sim_bridge.research.result_pages.markdown import (
    MarkdownConsole,
    sheet_markdown,
    without_title,
)
from sim_bridge.research.result_pages.page import DATA, OUT, CommandOutput, Page, PageCommand
from sim_bridge.research.result_pages.registry import PAGES

COMMANDS = [(page.name, command) for page in PAGES for command in page.commands]
ROOT = Path(__file__).parents[2]
PRINTS = "print('# A sheet\\n\\n| a | b |\\n| --- | --- |\\n| 1 | 2 |\\n\\nA note.')"
DRAWS = "import pathlib, sys; pathlib.Path(sys.argv[1], 'p.png').write_bytes(b'PNG')"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def fake(*codes: str, pictures: tuple[tuple[str, str], ...] = ()) -> Page:
    commands = tuple(PageCommand((sys.executable, "-c", code, OUT), "nothing") for code in codes)
    return Page("fake", "A fake", "What it shows.", commands, 0.1, pictures=pictures)


program = cache(root_command)


def parsed(words: list[str]) -> None:
    """Let the program's own parser take the command, without running it."""
    command = program(words[0])
    context = typer.Context(command, info_name=words[0])
    left = words[1:]
    while hasattr(command, "get_command"):
        name, *left = left
        part = command.get_command(context, name)
        assert part is not None, f"{' '.join(words)}: no command {name}"
        command = part
    command.make_context(words[-1], left)


def taken_by_a_script(argv: tuple[str, ...]) -> None:
    """Let a script of the checkout say what it would do with these words."""
    words = [sys.executable, str(ROOT / argv[0]), *argv[1:], "--list"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_the_program_takes_each_command_of_the_registry(page: str, command: PageCommand) -> None:
    assert command.draws, f"{page}: says nothing of its seed"
    if command.argv[0].startswith("deploy/"):
        taken_by_a_script(command.argv)
        return
    assert command.argv[0] in PROGRAMS
    parsed([word.replace(OUT, "out").replace(DATA, "data") for word in command.argv])


def test_a_command_that_is_spelt_wrong_is_noticed() -> None:
    with pytest.raises(AssertionError, match="no command flie"):
        parsed(["sim-bridge", "flie"])
    with pytest.raises(Exception, match=r"(?i)no such option.*--sead"):
        parsed(["sim-bridge", "fly", "--sead", "1"])
    with pytest.raises(AssertionError, match="unrecognized arguments: --jason"):
        taken_by_a_script(("deploy/measure-sizes", "--jason", "out.json"))


def test_pages_have_names_of_their_own_and_say_what_they_need() -> None:
    assert len({page.name for page in PAGES}) == len(PAGES)
    pictures = [name for page in PAGES for _, name in page.pictures]
    assert len(set(pictures)) == len(pictures)
    for page in PAGES:
        asked = any(DATA in word for command in page.commands for word in command.argv)
        assert asked == bool(page.needs), page.name


def test_a_page_says_command_seed_commit_machine_and_date(tmp_path: Path) -> None:
    page = fake(PRINTS, DRAWS, pictures=(("p.png", "fake.png"),))
    folder = tmp_path / "docs" / "results"
    text = write.make_page(page, folder, None, Console(quiet=True)).read_text()
    assert text.count("\n# ") == 1
    assert "## A sheet\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nA note." in text
    assert re.search(r"on \d{4}-\d\d-\d\d from commit \w+", text)
    assert re.search(r"\d+ cores, Python 3\.\d+", text)
    assert "| nothing |" in text
    assert "![A fake](../img/fake.png)" in text
    assert (tmp_path / "docs" / "img" / "fake.png").read_bytes() == b"PNG"
    assert not list(folder.glob("*.new"))
    assert not re.search("[\u2500-\u257f\x1b]", text)


def test_words_below_the_mark_are_kept(tmp_path: Path) -> None:
    file = write.make_page(fake(PRINTS), tmp_path, None, Console(quiet=True))
    file.write_text(f"{file.read_text()}\nWhat it means.\n")
    again = write.make_page(fake(PRINTS), tmp_path, None, Console(quiet=True))
    assert again.read_text().endswith(f"{write.END}\n\nWhat it means.\n")


def test_a_page_that_was_written_by_hand_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "fake.md").write_text("# Mine\n")
    with pytest.raises(LeewayError, match=r"fake\.md: written by hand"):
        write.make_page(fake(PRINTS), tmp_path, None, Console(quiet=True))
    assert (tmp_path / "fake.md").read_text() == "# Mine\n"


def test_a_command_that_fails_says_so_and_keeps_the_old_page(tmp_path: Path) -> None:
    file = write.make_page(fake(PRINTS), tmp_path, None, Console(quiet=True))
    old = file.read_text()
    broken = fake(PRINTS, "import sys; print('no wind', file=sys.stderr); sys.exit(3)")
    with pytest.raises(LeewayError, match=r"exit code 3\nno wind"):
        write.make_page(broken, tmp_path, None, Console(quiet=True))
    assert file.read_text() == old


def test_ctrl_c_keeps_the_old_page_and_ends_the_command(tmp_path: Path) -> None:
    file = write.make_page(fake(PRINTS), tmp_path, None, Console(quiet=True))
    old = file.read_text()
    waits = (
        "import os, pathlib, sys, time; pathlib.Path('began.new').write_text(str(os.getpid()));"
        " os.rename('began.new', 'began'); time.sleep(60)"
    )
    code = (
        "import pathlib, sys; from rich.console import Console;"
        "from sim_bridge.research.result_pages import write;"
        "from sim_bridge.research.result_pages.page import PageCommand, Page;"
        f"command = PageCommand((sys.executable, '-c', {waits!r}));"
        "page = Page('fake', 'A fake', '', (command,), 0.1);"
        f"write.make_page(page, pathlib.Path({str(tmp_path)!r}), None, Console(quiet=True))"
    )
    maker = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL, cwd=tmp_path)
    try:
        began = tmp_path / "began"
        while not began.exists():
            assert maker.poll() is None
        maker.send_signal(signal.SIGINT)
        maker.wait(30)
    finally:
        maker.kill()
    assert file.read_text() == old
    with pytest.raises(ProcessLookupError):
        os.kill(int(began.read_text()), 0)


def test_what_another_state_of_the_program_left_is_not_used(tmp_path: Path) -> None:
    from sim_bridge.research.result_pages.machine import Commit
    from sim_bridge.research.result_pages.run import FINISHED, folder_of

    page, clean = fake(PRINTS), Commit("abc", is_changed=False)
    folder, goes_on = folder_of(page, clean, tmp_path)
    assert not goes_on
    (folder / "half").touch()
    assert folder_of(page, clean, tmp_path) == (folder, True)
    assert folder_of(page, Commit("abd", is_changed=False), tmp_path)[1] is False
    (folder / FINISHED).touch()
    assert folder_of(page, clean, tmp_path) == (folder, False)
    (folder / "half").touch()
    assert folder_of(page, Commit("abc", is_changed=True), tmp_path) == (folder, False)
    assert not (folder / "half").exists()


def test_a_page_whose_data_is_not_there_is_told_apart(tmp_path: Path) -> None:
    page = Page("fake", "A fake", "", (), 0.1, needs=("wind/site.csv",))
    assert "--data" in write.missing(page, None)
    assert "has no wind/site.csv" in write.missing(page, tmp_path)
    (tmp_path / "wind").mkdir()
    (tmp_path / "wind" / "site.csv").touch()
    assert write.missing(page, tmp_path) == ""
    assert "no_such_module" in write.missing(
        Page("fake", "A fake", "", (), 0.1, modules=("no_such_module",)), None
    )


def test_a_table_of_a_terminal_becomes_a_markdown_table() -> None:
    table = Table(title="flights", caption="all of them")
    table.add_column("used\nWh", justify="right")
    table.add_column("clair-\nvoyant")
    table.add_row("[red]5.0[/red]", "a | b")
    console = MarkdownConsole()
    console.print(Group(table, "", "1 decided: land"))
    assert console.markdown == (
        "**flights**\n\n| used Wh | clairvoyant |\n| ---: | --- |\n| 5.0 | a \\| b |\n\nall of them"
        "\n\n1 decided: land"
    )


def test_what_commands_write_as_json_becomes_markdown(tmp_path: Path) -> None:
    done = CommandOutput(tmp_path, None, "", 1.0, 1.0)
    flight = {"outcome": "SUC"}
    near = {"who": ["d1", "d2"], "separations": 1.5, "horizontal_m": 9.0, "vertical_m": 0.5}
    row = {"seed": 3, "kept": True, "nearest": near | {"t_s": 50.0}, "flights": [flight, flight]}
    size = {"install": "pip install .", "held_gb": 0.456, "map_assets_mb": 1.71}
    wheels = {"install": "pip install .", "python": "3.11", "wheels": 30, "why": "No matching x"}
    speed = {"what": "px4", "values": [28.9], "unit": "x", "goal": ">= 20"}
    for name, content in (
        ("cross.json", {"crossings": [row, row | {"kept": False}]}),
        ("bench.json", {"rows": [speed]}),
        ("sizes.json", {"python": "Python 3.11", "sizes": [size, size | {"map_assets_mb": 0.0}]}),
        ("wheels.json", {"rows": [wheels, wheels | {"python": "3.12", "wheels": None}]}),
    ):
        (tmp_path / name).write_text(json.dumps(content))
    assert "separation broken, seeds 3" in tables.crossings(done)
    assert "- seed 3: BROKEN, 1.50 separations: d1 and d2" in tables.crossings(done)
    assert "| px4 | 28.9 x | >= 20 |" in tables.speeds(done)
    assert "| `pip install .` | 0.46 | 1.7 |" in tables.sizes(done)
    assert "| `pip install .` | 0.46 | not fetched |" in tables.sizes(done)
    assert "| `pip install .` | 30 wheels | No matching x |" in tables.arm_wheels(done)


def test_a_sheet_goes_one_level_down() -> None:
    assert sheet_markdown("# A\n\n\n\ntext\n") == "## A\n\ntext"


def test_a_sheet_says_no_title_that_its_page_says() -> None:
    assert without_title("## Paths\n\n| a |", {"Paths", ""}) == "| a |"
    assert without_title("## Paths in wind\n\n| a |", {"Paths"}) == "## Paths in wind\n\n| a |"
    assert without_title("Paths\n\n| a |", {"Paths"}) == "Paths\n\n| a |"
