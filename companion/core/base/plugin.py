"""Plug-ins: planners, wind estimators, winds and airframes of other packages.

A plug-in is loaded only where a person names it. `companion run` loads none.
"""

import hashlib
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError

PLANNERS, WIND_ESTIMATORS = "leeway.planners", "leeway.wind_estimators"
WINDS, AIRFRAMES = "leeway.winds", "leeway.airframes"
"""Entry-point groups."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """A loaded plug-in. `version`: distribution and version, or file and digest of its content."""

    name: str
    target: Any
    version: str

    @property
    def label(self) -> str:
        """Name and version, for messages and results."""
        return f"{self.name} ({self.version})"


def load_plugin(group: str, name: str, own_names: tuple[str, ...] = ()) -> Plugin:
    """Load the entry point `name` of this group, or the object MODULE:NAME.

    MODULE may be in the current folder. Raises LeewayError, in one line, if there is none
    (`own_names`: names that are no plug-ins, for the message) or if loading fails.
    """
    kind = group.removeprefix("leeway.").removesuffix("s").replace("_", " ")
    entry_points = metadata.entry_points(group=group)
    matching = [one for one in entry_points if one.name == name]
    if len({one.value for one in matching}) > 1:
        names = ", ".join(sorted(_distribution_text(one.dist) for one in matching))
        raise LeewayError(f"{kind} {name!r}: defined by {names}; expected MODULE:NAME")
    if matching:
        entry_point = matching[0]
        version = _distribution_text(entry_point.dist)
        return Plugin(name, _load(kind, f"{name} ({version})", entry_point), version)
    if ":" not in name:
        known = ", ".join([*own_names, *sorted({one.name for one in entry_points})])
        raise LeewayError(f"{kind} {name!r}: expected {known + ' or ' if known else ''}MODULE:NAME")
    module_name, _, attribute_name = name.partition(":")
    if not all(part.isidentifier() for part in f"{module_name}.{attribute_name}".split(".")):
        raise LeewayError(f"{kind} {name!r}: expected MODULE:NAME")
    target = _load(kind, name, metadata.EntryPoint(name, name, group))
    return Plugin(name, target, _version_of_module(module_name))


def entry_point_names(group: str) -> frozenset[str]:
    """Return the names of the entry points of a group."""
    return frozenset(metadata.entry_points(group=group).names)


def load_plugin_file(group: str, name: str, own_names: tuple[str, ...] = ()) -> Path:
    """Load a plug-in that is the path of a file; raise LeewayError if it is none."""
    plugin = load_plugin(group, name, own_names)
    if not isinstance(plugin.target, str | Path) or not Path(plugin.target).is_file():
        raise LeewayError(f"{plugin.label}: {plugin.target}: expected the path of an existing file")
    return Path(plugin.target)


def _load(kind: str, label: str, entry_point: metadata.EntryPoint) -> Any:
    # Last, so that no file here takes the place of an installed module.
    folder = str(Path.cwd())
    is_added = folder not in sys.path
    if is_added:
        sys.path.append(folder)
    try:
        return entry_point.load()
    except Exception as error:  # the code of others may raise anything
        raise LeewayError(f"{kind} {label}: not loaded: {_one_line(error)}") from error
    finally:
        if is_added:
            sys.path.remove(folder)


def _one_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _version_of_module(module_name: str) -> str:
    top_level = module_name.partition(".")[0]
    for distribution in metadata.packages_distributions().get(top_level, []):
        return _distribution_text(metadata.distribution(distribution))
    file = getattr(import_module(module_name), "__file__", None)
    if file is None:
        return "no file"
    return f"{Path(file).name} {hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12]}"


def _distribution_text(distribution: metadata.Distribution | None) -> str:
    return f"{distribution.name} {distribution.version}" if distribution else "no distribution"


@dataclass(frozen=True, slots=True)
class PluginGuard:
    """Calls the code of a plug-in; whatever it raises becomes a LeewayError that names it.

    `subject`: kind and label, such as "planner mine:Nearest (mine 1.0)".
    """

    subject: str

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call `function`; `name` is its name in the message."""
        try:
            return function(*arguments)
        except Exception as error:  # the code of others may raise anything
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = "" if place.filename == __file__ else f" ({place.filename}:{place.lineno})"
            raise self.error(f"{name} raised {_one_line(error)}{where}") from error

    def error(self, text: str) -> LeewayError:
        """Return the error with this text."""
        return LeewayError(f"{self.subject}: {text}")
