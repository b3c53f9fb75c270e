"""Exports of a package, loaded at first use: importing the package stays fast."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_exports(
    package_name: str, module_by_exported_name: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return a package's `__getattr__`, that imports each name from its module, and `__dir__`."""

    def import_exported_name(name: str) -> Any:
        if name not in module_by_exported_name:
            raise AttributeError(f"module {package_name!r} has no attribute {name!r}")
        return getattr(import_module(f"{package_name}.{module_by_exported_name[name]}"), name)

    def list_names() -> list[str]:
        return sorted({*vars(import_module(package_name)), *module_by_exported_name})

    return import_exported_name, list_names
