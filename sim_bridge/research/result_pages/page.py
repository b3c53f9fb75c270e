"""What a page of results is: its commands, the data that they need, and what it shows."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

OUT, DATA = "{out}", "{data}"
"""In a command: the folder of its own files, and the folder of other people's data."""


@dataclass(frozen=True, slots=True)
class CommandOutput:
    """A command that has run: what it printed, and where its files and its data lie."""

    out: Path
    data: Path | None
    printed: str
    wall_s: float
    cpu_s: float

    def json(self, name: str) -> Any:
        """A JSON file that it wrote."""
        return json.loads((self.out / name).read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True)
class PageCommand:
    """A command of a page, from the program's name on.

    `seed` says which draws it makes where `argv` has no `--seed` or `--seeds`. `show` makes
    Markdown of what it left; absent: what it prints is Markdown already.
    """

    argv: tuple[str, ...]
    seed: str = ""
    show: Callable[[CommandOutput], str] | None = None
    title: str = ""

    @property
    def draws(self) -> str:
        """Its seed, or what it says about it."""
        for word, value in zip(self.argv, self.argv[1:], strict=False):
            if word in ("--seed", "--seeds"):
                return value
        return self.seed

    def shown(self, out: str) -> str:
        """As a person types it."""
        words = (word.replace(OUT, out).replace(DATA, "DIR") for word in self.argv)
        return " ".join(f'"{word}"' if " " in word else word for word in words)


@dataclass(frozen=True, slots=True)
class Page:
    """One page of docs/results: `shows` is one sentence, `minutes` of CPU are a rough guess.

    `needs` are paths in the folder of data without which it cannot be made, `modules` what has to
    be importable beside the simulator and the desk. `pictures` are patterns in the folder of its
    files, with the name that each is kept under; of several that fit, the newest is taken.
    """

    name: str
    title: str
    shows: str
    commands: tuple[PageCommand, ...]
    minutes: float
    needs: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()
    pictures: tuple[tuple[str, str], ...] = ()

    @property
    def is_quick(self) -> bool:
        """It takes no more than about two minutes."""
        return self.minutes <= 2.0
