"""A program's commands as a page: every command, option, default and help, from the program."""

import inspect
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

NO_DEFAULT = (None, (), [], "")


def command_page(program: str, root: Any) -> str:
    """The page of a program in Markdown; `root` is its click command."""
    lines = [f"# {program}", "", *_prose(root.help), ""]
    commands = list(commands_of(program, root))
    if options := _options_of(root):
        lines += [*_option_table(options, root), ""]
    lines += ["| command | does |", "| --- | --- |"]
    for name, command in commands:
        words = next(iter(_prose(command.help)), "")
        lines.append(f"| [`{name}`](#{_anchor(name)}) | {_cell(words)} |")
    for name, command in commands:
        lines += ["", f"## {name}", "", *_command(name, command)]
    return "\n".join(lines).rstrip() + "\n"


def commands_of(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """(name, command) of every command that does something, groups opened; hidden ones left out."""
    context = typer.Context(command, info_name=name)
    for part_name in command.list_commands(context):
        part = command.get_command(context, part_name)
        if part is None or part.hidden:
            continue
        full = f"{name} {part_name}"
        if hasattr(part, "list_commands"):
            yield from commands_of(full, part)
        else:
            yield full, part


def _command(name: str, command: Any) -> list[str]:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = _options_of(command)
    usage = " ".join([name, *(["[OPTIONS]"] if options else []), *map(_usage, arguments)])
    lines = ["```", usage, "```", "", *_prose(command.help)]
    if arguments:
        lines += ["", "| argument | default | meaning |", "| --- | --- | --- |"]
        for one in arguments:
            lines.append(f"| `{_usage(one)}` | {_default(one)} | {_cell(one.help)} |")
    if options:
        lines += ["", *_option_table(options, command)]
    if command.epilog:
        lines += ["", *_prose(command.epilog)]
    return lines


def _options_of(command: Any) -> list[Any]:
    options = [p for p in command.params if p.param_type_name == "option"]
    return [p for p in options if p.name != "help" and not p.hidden]


def _option_table(options: list[Any], command: Any) -> list[str]:
    declared = get_type_hints(inspect.unwrap(command.callback), include_extras=True)
    lines = ["| option | value | default | meaning |", "| --- | --- | --- | --- |"]
    for one in options:
        spelled = ", ".join(f"`{word}`" for word in [*one.opts, *one.secondary_opts])
        cells = (spelled, _value(one, declared[one.name]), _default(one), _cell(one.help))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _usage(argument: Any) -> str:
    word = (argument.metavar or str(argument.name)).strip("[]")
    word = word if argument.metavar else word.upper()
    word = word if argument.required else f"[{word}]"
    return f"{word}..." if argument.nargs == -1 and not word.endswith("...") else word


def _value(option: Any, declared: Any) -> str:
    """What an option takes, from the annotation of the function behind the command."""
    if option.is_flag:
        return ""
    kind, *notes = get_args(declared) if get_origin(declared) is Annotated else (declared,)
    info = next((note for note in notes if isinstance(note, OptionInfo)), OptionInfo())
    words = _words_of(_bare(kind))
    if info.min is not None and info.max is not None:
        words += f", {info.min:g} to {info.max:g}"
    elif info.min is not None:
        words += f", at least {info.min:g}"
    elif info.max is not None:
        words += f", at most {info.max:g}"
    return f"{words}; may be repeated" if option.multiple else words


def _bare(kind: Any) -> Any:
    """The type of one value: without None, and what a list is of."""
    if get_origin(kind) in (Union, UnionType):
        kind = next(one for one in get_args(kind) if one is not type(None))
    return _bare(get_args(kind)[0]) if get_origin(kind) is list else kind


def _words_of(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return " and ".join(map(_words_of, get_args(kind)))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return ", ".join(f"`{one.value}`" for one in kind)
    return {Path: "path", int: "integer", float: "number", str: "text"}[kind]


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    value = parameter.default
    if callable(value):
        value = value()
    if value in NO_DEFAULT:
        return ""
    if getattr(parameter, "is_flag", False):
        return ("on" if value else "off") if parameter.secondary_opts else ""
    if isinstance(value, list | tuple):
        return ", ".join(f"`{_plain(one)}`" for one in value)
    return f"`{_plain(value)}`"


def _plain(value: Any) -> str:
    return str(value.value if isinstance(value, Enum) else value)


def _prose(words: str | None) -> list[str]:
    """Paragraphs, each on one line, with an empty line between."""
    text = inspect.cleandoc((words or "").replace("\b", "").replace("\f", ""))
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n", text)]
    lines = "\n\n".join(paragraph for paragraph in paragraphs if paragraph).split("\n")
    return [_outside_code(line) for line in lines]


def _cell(words: str | None) -> str:
    return _outside_code(" ".join((words or "").split())).replace("|", "\\|")


def _outside_code(line: str) -> str:
    """Angle brackets and stars as letters, but for what stands between backticks."""
    parts = line.split("`")
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([<>*])", r"\\\1", parts[k])
    return "`".join(parts)


def _anchor(heading: str) -> str:
    return re.sub(r"[^a-z0-9 -]", "", heading.lower()).replace(" ", "-")
