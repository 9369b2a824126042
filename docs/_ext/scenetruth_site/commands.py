"""The commands of a typer app as Markdown: usage, arguments, options, defaults and help."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Any

import typer

__all__ = ["command_names", "commands_in_markdown"]


def commands_in_markdown(app: typer.Typer, name: str) -> str:
    """Return a section for every command of an app; commands of a group follow their group.

    Parameters
    ----------
    app
        The app.
    name
        Its name on the command line.

    Returns
    -------
    str
        Markdown with headings from the second level on. Command ``a b`` has the anchor ``command-a-b``, its option
        ``--option`` the anchor ``command-a-b--option``.
    """
    return "\n".join(line for words, command in _commands(app, name) for line in _section(words, command))


def command_names(app: typer.Typer, name: str) -> list[str]:
    """Return the commands and groups of an app, as typed on the command line."""
    return [" ".join(words) for words, _ in _commands(app, name)]


def _commands(app: typer.Typer, name: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    # typer bundles click and exports no type of a command.
    def visit(words: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
        if not command.hidden:
            yield words, command
            for word, inner in getattr(command, "commands", {}).items():
                yield from visit((*words, word), inner)

    yield from visit((name,), typer.main.get_command(app))


def _section(words: tuple[str, ...], command: Any) -> Iterator[str]:
    anchor = "-".join(("command", *words[1:])) if len(words) > 1 else "command-itself"
    yield f"({anchor})="
    yield f"{'##' if len(words) < 3 else '###'} {' '.join(words)}\n"
    # Help text is shown up to the form feed \f.
    yield f"{(command.help or '').partition(chr(12))[0].strip()}\n"
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    options = [one for one in command.params if one.param_type_name == "option" and not one.hidden]
    usage = [" ".join(words), *("[OPTIONS]" for _ in options[:1])]
    usage += [_argument(one) for one in arguments]
    usage += ["COMMAND [ARGS]..." for _ in [0] if getattr(command, "commands", None)]
    yield f"```text\n{' '.join(usage)}\n```\n"
    for one in arguments:
        yield f"`{_argument(one)}`\n: {_help_text(one)}\n"
    for one in options:
        names = ", ".join(f"`{text}`" for text in [*one.opts, *one.secondary_opts])
        short = max(one.opts, key=len)
        yield f"[[{names}](#{anchor}{short})]{{#{anchor}{short}}}{_value(one)}\n: {_help_text(one)}\n"


def _argument(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    name += "..." if argument.nargs != 1 and not name.endswith("...") else ""
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _value(option: Any) -> str:
    """Return the placeholder of the value of an option, or its choices."""
    if getattr(option, "is_flag", False):
        return ""
    choices = _choices(option)
    return f" `{'|'.join(choices)}`" if choices else f" `{option.metavar or _type_name(option)}`"


def _choices(option: Any) -> list[str]:
    # Older releases of typer have types of click.
    if hasattr(option, "type"):
        return [str(getattr(one, "value", one)) for one in getattr(option.type, "choices", ())]
    kind = option.type_descriptor.annotation
    return [str(one.value) for one in kind] if isinstance(kind, type) and issubclass(kind, Enum) else []


def _type_name(option: Any) -> str:
    if hasattr(option, "type"):
        name = option.type.name.removesuffix(" range")
        return {"integer": "NUMBER", "float": "NUMBER", "path": "PATH", "text": "TEXT"}.get(name, "VALUE")
    kind = option.type_descriptor.annotation
    names = {"int": "NUMBER", "float": "NUMBER", "Path": "PATH", "str": "TEXT"}
    return names.get(getattr(kind, "__name__", ""), "VALUE")


def _help_text(parameter: Any) -> str:
    help_ = " ".join((parameter.help or "").split())
    default = parameter.default
    if parameter.required and parameter.param_type_name == "option":
        return f"{help_} *Required.*".strip()
    if callable(default) or default in (None, "", (), []):
        return help_
    if getattr(parameter, "is_flag", False):
        # For a pair of flags, the default flag; a single flag is off by default.
        if not parameter.secondary_opts:
            return help_
        default = (parameter.opts if default else parameter.secondary_opts)[0]
    return f"{help_} Default: `{default.value if isinstance(default, Enum) else default}`.".strip()
