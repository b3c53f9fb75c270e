"""Options of a program or group: declared once, valid anywhere on the command line.

A group lists an option once; a command names those that it uses (`command_class_with_options`). Its
help lists them, and an option that the command does not use is an error.
"""

from collections.abc import Collection, Iterator, Mapping
from contextvars import ContextVar
from itertools import islice
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from companion.core.base.errors import LeewayError

SHARED_PANEL = "Options of several commands"
"""Panel of the help that lists them."""

_VALUES: ContextVar[Mapping[str, Any]] = ContextVar("options of the running command's groups")
_TYPED: ContextVar[frozenset[str]] = ContextVar("those given on the command line")


class GroupWithOptions(TyperGroup):
    """A group whose options may precede or follow the name of a command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Move the options of this group to the front."""
        own, rest = self.split_args(args)
        return super().parse_args(ctx, [*own, *rest])

    def split_args(self, args: list[str]) -> tuple[list[str], list[str]]:
        """Return the options of this group, with their values, and what is left.

        An option that the command declares itself is the command's.
        """
        expects_value = _expects_value_by_option_name(self)
        command: Any = self
        own: list[str] = []
        rest: list[str] = []
        remaining = iter(args)
        for arg in remaining:
            name, equals, _ = arg.partition("=")
            if arg == "--":
                rest += [arg, *remaining]
            elif name in expects_value and (
                command is self or name not in _expects_value_by_option_name(command)
            ):
                own += [
                    arg,
                    *([] if equals or not expects_value[name] else islice(remaining, 1)),
                ]
            else:
                command = getattr(command, "commands", {}).get(arg, command)
                rest.append(arg)
        return own, rest


def _expects_value_by_option_name(command: Any) -> dict[str, bool]:
    options = [one for one in command.params if isinstance(one, TyperOption)]
    return {name: not one.is_flag for one in options for name in (*one.opts, *one.secondary_opts)}


class CommandWithOptions(TyperCommand):
    """A command that uses some options of the groups above it."""

    used: ClassVar[tuple[str, ...]] = ()
    """Parameters of those groups, by name."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """List the options of the groups below the command's own."""
        own = self.params
        self.params = [
            *own,
            *(one for _, one in _options_of_parent_groups(ctx) if one.name in self.used),
        ]
        try:
            super().format_help(ctx, formatter)
        finally:
            self.params = own

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Reject an option of a group that this command does not use."""
        for group, one in _options_of_parent_groups(ctx):
            if one.name not in self.used and _is_option_typed(group, one):
                raise typer.BadParameter(f"`{ctx.command_path}` does not use it.", ctx, one)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command with the options of its groups at hand."""
        options = [
            (group, one) for group, one in _options_of_parent_groups(ctx) if one.name in self.used
        ]
        values = _VALUES.set({one.name: group.params[one.name] for group, one in options})
        typed = _TYPED.set(
            frozenset(one.name for group, one in options if _is_option_typed(group, one))
        )
        try:
            return super().invoke(ctx)
        finally:
            _VALUES.reset(values)
            _TYPED.reset(typed)


def command_class_with_options(*option_names: str) -> type[CommandWithOptions]:
    """Make the class of a command that uses these options of the groups above it."""
    return type("Command", (CommandWithOptions,), {"used": option_names})


def reject_group_options_by_default(app: typer.Typer) -> None:
    """Make commands that use no option of their groups reject all of them."""
    for command in app.registered_commands:
        if not issubclass(command.cls or TyperCommand, CommandWithOptions):
            command.cls = CommandWithOptions
    for group in app.registered_groups:
        if group.typer_instance is not None:
            reject_group_options_by_default(group.typer_instance)


def current_group_option_values() -> Mapping[str, Any]:
    """Return the options of its groups that the running command uses, by parameter name."""
    return _VALUES.get()


def names_of_typed_options() -> frozenset[str]:
    """Return the names of options given on the command line; they take precedence."""
    return _TYPED.get()


def require_options_not_given(
    context: typer.Context, option_names: Collection[str], reason: str
) -> None:
    """Raise LeewayError if the command line has one of these options, of the command or a group."""
    own = [(context, one) for one in context.command.params if isinstance(one, TyperOption)]
    given = [
        one.opts[0]
        for group, one in [*own, *_options_of_parent_groups(context)]
        if one.name in option_names and _is_option_typed(group, one)
    ]
    if given:
        raise LeewayError(f"{', '.join(given)}: {reason}")


def _is_option_typed(group: Any, one: TyperOption) -> bool:
    source = group.get_parameter_source(one.name)
    return source is not None and source.name == "COMMANDLINE"


def _options_of_parent_groups(ctx: Any) -> Iterator[tuple[Any, TyperOption]]:
    group = ctx.parent
    while group is not None:
        for one in group.command.params:
            if isinstance(one, TyperOption) and not one.is_eager:
                yield group, one
        group = group.parent
