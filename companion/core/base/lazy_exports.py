"""Exports of a package, loaded at first use: importing the package stays fast."""

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_exports(
    package_name: str, module_by_exported_name: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return a package's `__getattr__`, which imports each name from its module, and `__dir__`.

    Modules are named in full, or after a dot within the package.
    """

    def import_exported_name(name: str) -> object:
        if name not in module_by_exported_name:
            raise AttributeError(f"module {package_name!r} has no attribute {name!r}")
        return getattr(import_module(module_by_exported_name[name], package_name), name)

    def list_names() -> list[str]:
        return sorted({*vars(import_module(package_name)), *module_by_exported_name})

    return import_exported_name, list_names
