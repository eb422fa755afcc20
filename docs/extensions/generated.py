"""Reference pages that are read from the code: the directive ``generated``.

``{generated} metrics`` stands for the Markdown that the function of that name below returns, so a
page says what the code does, and no table is written twice.
"""

import asyncio
import importlib
import inspect
import json
import logging
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args

import click
import docutils.nodes
from docutils.parsers.rst import Directive
from pydantic import BaseModel, HttpUrl
from pydantic_core import PydanticUndefined
from sphinx.application import Sphinx

DOCS = Path(__file__).parents[1]
GENERATED: dict[str, Callable[[str], str]] = {}
"""What pages can ask for, by name. Each takes the rest of the directive's line."""


def generated(write: Callable[[str], str]) -> Callable[[str], str]:
    """Let pages ask for what a function writes."""
    GENERATED[write.__name__] = write
    return write


class Generated(Directive):
    """``{generated} NAME ARGUMENT``."""

    required_arguments = 1
    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[docutils.nodes.Node]:
        """Write the Markdown and read it as a part of the page."""
        name, argument = [*self.arguments, ""][:2]
        container = docutils.nodes.Element()
        lines = docutils.statemachine.StringList(GENERATED[name](argument).splitlines(), "")
        self.state.nested_parse(lines, self.content_offset, container, match_titles=True)
        return container.children


def setup(app: Sphinx) -> Mapping[str, Any]:
    """Add the directive, and read the docstrings of modules as part of a page."""
    app.add_directive("generated", Generated)
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _unhead, priority=0)
    app.connect("doctree-resolved", _renumber)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _unhead(_app: Sphinx, what: str, _name: str, _of: Any, _how: Any, lines: list[str]) -> None:
    """Make the sections of a module's docstring rubrics: headings would be those of the page."""
    if what == "module":
        for row in range(len(lines) - 1, 0, -1):
            if lines[row] and not lines[row].strip("-"):
                lines[row - 1 : row + 1] = [f".. rubric:: {lines[row - 1]}", ""]


def _renumber(_app: Sphinx, tree: docutils.nodes.document, _page: str) -> None:
    """Write the numbers of footnotes, which numpydoc made unique and did not find again."""
    for node in list(tree.findall(docutils.nodes.Text)):
        if re.search(r"\[R[0-9a-f]{12}-\d+\]", node):
            text = re.sub(r"\[R[0-9a-f]{12}-(\d+)\]", r"[\1]", node)
            node.parent.replace(node, docutils.nodes.Text(text))


# Tables.


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Write a table."""
    heads = list(heads)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines) + "\n"


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("|", r"\|")


def _literals(text: str) -> str:
    """Write reStructuredText's literals as Markdown's."""
    return text.replace("``", "`")


def _first_paragraph(text: str | None) -> str:
    return (text or "").strip().partition("\n\n")[0]


# What scores.


@generated
def metrics(_: str) -> str:
    """Write the catalogue of metrics, of all tasks."""
    from reverie_eval.metrics import CATALOGUE

    return table(
        ("key", "label", "unit", "better", "definition"),
        (
            (f"`{each.key}`", each.label, each.unit, each.better, each.definition)
            for each in CATALOGUE.values()
        ),
    )


@generated
def tasks(_: str) -> str:
    """Write what agents do in each task, and the protocols and the metric that it has."""
    from reverie_eval.metrics import CATALOGUE
    from reverie_eval.tasks import BUILT_IN, find_task

    rows = []
    for name, module in BUILT_IN.items():
        task, says = find_task(name), importlib.import_module(module).__doc__ or ""
        named = ", ".join(protocol.name for protocol in task.protocols)
        rows.append(
            (
                f"`{name}`",
                says.partition(": ")[2].rstrip(".\n"),
                f"`{task.id_example}`",
                f"[{named}](protocols.md)",
                CATALOGUE[task.ranking[0]].label,
            )
        )
    return table(("task", "what agents do", "ids of episodes", "protocols", "ranked by"), rows)


@generated
def protocols(task_name: str) -> str:
    """Write the rules of a task's protocols, as they differ."""
    from reverie_eval.tasks import find_task

    task = find_task(task_name)
    others = {
        protocol.name: [name for name, meant in task.aliases.items() if meant == protocol.name]
        for protocol in task.protocols
    }
    columns: dict[str, Callable[[Any], str]] = {
        "protocol": lambda it: " = ".join(f"`{name}`" for name in (it.name, *others[it.name])),
        "goal viewpoints": lambda it: it.goal,
        "path": lambda it: it.reference or "the usual one",
        "instructions": lambda it: f"first {it.scored_instructions}" * bool(it.scored_instructions),
        "SPL's numerator": lambda it: it.spl_numerator,
        "floor": lambda it: _floors(it.spl_floor, it.rgspl_floor),
        "a correct answer": lambda it: it.grounding,
        "outline": lambda it: it.repeated_outlines,
        "source": lambda it: it.source,
    }
    optional = {"path", "instructions", "outline"}
    shown = {
        head: write
        for head, write in columns.items()
        if head not in optional or len(set(map(write, task.protocols))) > 1
    }
    return table([*shown], [[write(each) for write in shown.values()] for each in task.protocols])


@generated
def codebases(_: str) -> str:
    """Write what is known of public codebases, a row for each task that one scores."""
    from reverie_eval.tasks import codebases

    return table(
        ("codebase", "repository", "task", "protocol", "its evaluator", "what it does otherwise"),
        (
            (
                each.name,
                f"{each.repository} {each.commit}",
                it.task,
                f"`{it.protocol}`",
                f"{it.source}: {it.standing}",
                it.differs,
            )
            for each in codebases()
            for it in each.evaluator
        ),
    )


@generated
def codebase_files(_: str) -> str:
    """Write which files public codebases write."""
    from reverie_eval.tasks import codebases

    return table(
        ("codebase", "commit", "file", "form", "its writer"),
        (
            (
                each.name,
                each.commit,
                f"`{it.name}`" if it.name else "any name",
                it.form,
                it.standing,
            )
            for each in codebases()
            for it in each.file
        ),
    )


def _floors(spl: float, rgspl: float) -> str:
    floors = {"SPL": spl, "RGSPL": rgspl}
    shown = [name for name, floor in floors.items() if floor]
    return f"{spl:g} m in {' and '.join(shown)}" if shown else "none"


# What is checked in a dataset.


@cache
def _lint_sections() -> Any:
    """Check the demo world, with everything that there is to check."""
    from fixtures.demo_world import write_demo_world
    from reverie_eval.dataset import DatasetFiles, lint_dataset

    with tempfile.TemporaryDirectory() as folder:
        write_demo_world(Path(folder))
        files = DatasetFiles.find(Path(folder), object_positions=Path(folder) / "objpos.json")
        return lint_dataset(files).sections


@generated
def dataset_rules(severity: str) -> str:
    """Write the rules of one severity."""
    rules = {
        each.code: each
        for section in _lint_sections()
        for each in section.counts
        if each.severity == severity
    }
    if severity == "info":
        return table(
            ("code", "what is counted"),
            ((f"`{each.code}`", each.says) for each in rules.values()),
        )
    return table(
        ("code", "what is counted", "what it means, and what to do"),
        ((f"`{each.code}`", each.says, each.advice) for each in rules.values()),
    )


@generated
def dataset_measurements(_: str) -> str:
    """Write what is measured in a dataset."""
    measured = {each.code: each for section in _lint_sections() for each in section.spreads}
    return table(
        ("code", "what is measured", "unit"),
        ((f"`{each.code}`", each.says, each.unit) for each in measured.values()),
    )


# A server.


@generated
def settings(_: str) -> str:
    """Write all settings with their defaults.

    Their reference has this as text, for readers of the repository or of a package; a test says
    when it has to be renewed.
    """
    from reverie_eval.server.settings import Settings

    return table(("setting", "default", "meaning"), _settings_of(Settings))


def _settings_of(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, str, str]]:
    for name, field in model.model_fields.items():
        place = f"{above}{name}"
        section = _section_of(field.annotation)
        if section is None:
            yield f"`{place}`", _default(field.default), _literals(field.description or "")
        else:
            below = ".NAME." if name in {"splits", "boards"} else "."
            yield from _settings_of(section, f"{place}{below}")


def _section_of(annotation: Any) -> type[BaseModel] | None:
    """Return the settings within a setting, if it has any."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_section_of, get_args(annotation))), None)


def _default(default: object) -> str:
    """Write a default as the settings file has it."""
    match default:
        case _ if default is PydanticUndefined:
            return "required"
        case None:
            return "none"
        case bool() | int():
            return f"`{json.dumps(default)}`"
        case str() | Path() | HttpUrl():
            return f'`"{default}"`'
        case ():
            return "`[]`"
    return f"`{default}`"


@generated
def http_problems(_: str) -> str:
    """Write every error of the HTTP API."""
    from reverie_eval.server.errors import ERRORS

    return table(
        ("code", "status", "what happened"),
        (
            (f"`{code}`", str(error.status.value), _literals(_first_paragraph(error.__doc__)))
            for code, error in sorted(ERRORS.items(), key=lambda each: each[1].status.value)
        ),
    )


_API = "/api/v1"
_TAGS = {
    "access": "Signing in",
    "splits": "Splits, submitting and leaderboards",
    "submissions": "Your submissions",
    "organiser": "The organiser's actions",
    "operations": "The server itself",
}


@cache
def _openapi() -> Mapping[str, Any]:
    """Ask a new server for the description of its API."""
    logging.disable(logging.INFO)  # a server logs every step
    import httpx

    from reverie_eval.server.app import create_app
    from reverie_eval.server.opening import opened_server
    from reverie_eval.server.operations.folder import building, fill
    from reverie_eval.server.settings import load_settings

    async def ask(app: Any) -> Any:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return (await client.get(f"{_API}/openapi.json")).json()

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "server")
        with building(folder) as aside:
            fill(aside)
        with opened_server(load_settings(folder)) as server:
            document: Mapping[str, Any] = asyncio.run(ask(create_app(server)))
    logging.disable(logging.NOTSET)
    return document


@generated
def http_operations(_: str) -> str:
    """Write every operation of the HTTP API, by subject."""
    parts: dict[str, list[str]] = {tag: [] for tag in _TAGS}
    for path, operations in _openapi()["paths"].items():
        for method, operation in operations.items():
            address = f"{method.upper()} {path.removeprefix(_API) or path}"
            parts[operation["tags"][0]].append("\n".join(_operation(address, operation)))
    return "\n".join(f"## {title}\n\n{''.join(parts[tag])}" for tag, title in _TAGS.items())


def _operation(address: str, operation: Mapping[str, Any]) -> Iterator[str]:
    yield f"### `{address}`\n"
    yield f"{_literals(operation['description'])}\n"
    parameters = operation.get("parameters", ())
    if parameters:
        yield table(
            ("parameter", "in", "meaning"),
            (
                (f"`{each['name']}`", each["in"], _literals(each.get("description", "")))
                for each in parameters
            ),
        )
    body = operation.get("requestBody", {}).get("content", {})
    if body:
        yield from _example("Request", body)
    refusals: list[str] = []
    for status, reply in operation["responses"].items():
        if int(status) < 400:
            yield from _example(f"Reply, {status}", reply.get("content", {}))
        elif problem := reply.get("content", {}).get("application/problem+json"):
            refusals += problem["schema"]["properties"]["code"]["enum"]
    yield f"Errors: {', '.join(f'`{code}`' for code in refusals)}.\n\n"


def _example(heading: str, content: Mapping[str, Any]) -> Iterator[str]:
    """Write an example of a body as JSON."""
    body = content.get("application/json")
    if body is None:
        forms = ", ".join(f"`{each}`" for each in content)
        yield f"{heading}: {forms}.\n" if forms else f"{heading}: no content.\n"
        return
    value = body.get("example")
    if value is None:
        value = _example_of(body["schema"], _openapi()["components"]["schemas"])
    yield f"{heading}:\n\n```json\n{json.dumps(value, indent=2, ensure_ascii=False)}\n```\n"


def _example_of(schema: Mapping[str, Any], models: Mapping[str, Any]) -> Any:
    """Make an example of a value, as viewers of OpenAPI do: of the examples of its fields."""
    if "$ref" in schema:
        return _example_of(models[schema["$ref"].rpartition("/")[2]], models)
    known = [*schema.get("examples", ()), *schema.get("enum", ())]
    known += [schema[name] for name in ("const", "default") if name in schema]
    known += [_example_of(each, models) for each in schema.get("anyOf", ())]
    if known:
        return known[0]
    match schema["type"]:
        case "object":
            fields = schema.get("properties", {})
            return {name: _example_of(field, models) for name, field in fields.items()}
        case "array":
            entries = schema.get("prefixItems") or [schema["items"]]
            return [_example_of(each, models) for each in entries]
        case kind:
            return _EXAMPLES.get(schema.get("format", kind), "...")


_EXAMPLES = {
    "boolean": False,
    "date-time": "2027-06-01T12:00:00Z",
    "integer": 1,
    "null": None,
    "number": 0.5,
}
"""Examples for fields that have none of their own, by format or type."""


# Files.


@generated
def schemas(_: str) -> str:
    """Write the fields of every JSON file, as its schema has them; what several share, once."""
    from reverie_eval_cli.commands.shell import SCHEMAS

    written: set[str] = set()
    return "\n".join(
        line for name in SCHEMAS for line in (f"## `{name}`\n", *_schema(name, written))
    )


def _schema(name: str, written: set[str]) -> Iterator[str]:
    file = f"schemas/{name}.schema.json"
    document = json.loads((DOCS / "reference" / file).read_text())
    yield f"JSON Schema: [{name}.schema.json]({file}).\n"
    yield _fields(document, "")
    for title, definition in document.get("$defs", {}).items():
        if title not in written and "properties" in definition:
            written.add(title)
            yield _fields(definition, f"### {title}\n\n")


def _fields(definition: Mapping[str, Any], heading: str) -> str:
    """Write the fields of an object; nothing for another kind of value."""
    fields = definition.get("properties")
    if not fields:
        return ""
    about = _literals(definition.get("description", "")).strip()
    required = definition.get("required", ())
    return f"{heading}{about}\n\n" + table(
        ("field", "type", "meaning"),
        (
            (
                f"`{name}`" if name in required else f"`{name}` (optional)",
                _type(field),
                _literals(field.get("description", "")),
            )
            for name, field in fields.items()
        ),
    )


def _type(field: Mapping[str, Any]) -> str:
    """Write the type of a field in words."""
    match field:
        case {"$ref": reference}:
            text = f"`{reference.rpartition('/')[2]}`"
        case {"const": value}:
            text = f"`{json.dumps(value)}`"
        case {"enum": values}:
            text = " or ".join(f"`{json.dumps(value)}`" for value in values)
        case {"anyOf": choices} | {"oneOf": choices}:
            text = " or ".join(dict.fromkeys(map(_type, choices)))
        case {"type": "array", "prefixItems": items}:
            text = f"list of {', '.join(map(_type, items))}"
        case {"type": "array", "items": {**item}} if item:
            text = f"list of {_type(item)}"
        case {"type": "object", "additionalProperties": {**value}}:
            text = f"object of {_type(value)}"
        case _:
            text = str(field.get("type", "any value"))
    return text


# Python.


@generated
def python(name: str) -> str:
    """Write the public names of a module, each once: not what the package or another room has."""
    import reverie_eval

    module = importlib.import_module(name)
    elsewhere = {"__init__", "__new__"}
    if module is not reverie_eval:
        elsewhere |= set(reverie_eval.__all__)
        for each in getattr(module, "__all__", ()):
            if not getattr(getattr(module, each), "__module__", name).startswith(name):
                elsewhere.add(each)
    return f"""```{{eval-rst}}
.. automodule:: {name}
   :members:
   :exclude-members: {", ".join(sorted(elsewhere))}
```
"""


# The command line.


@generated
def commands(_: str) -> str:
    """Write the help of every command."""
    from reverie_eval_cli.main import PROGRAM, program

    context = click.Context(program, info_name=PROGRAM)
    names = program.list_commands(context)
    return "\n\n".join(_command(program, name, context, "##") for name in names)


def _command(group: click.Group, name: str, above: click.Context, heading: str) -> str:
    """Write the help of a command, and of all commands below it."""
    command = group.get_command(above, name)
    if command is None:
        raise LookupError(name)
    context = click.Context(command, info_name=name, parent=above)
    usage = " ".join((context.command_path, *command.collect_usage_pieces(context)))
    parts = [
        f"{heading} {context.command_path}",
        f"```text\n{usage}\n```",
        _help_text(command.help or ""),
    ]
    if isinstance(command, click.Group):
        below = command.list_commands(context)
        parts += [_command(command, each, context, f"{heading}#") for each in below]
    else:
        records = (
            each.get_help_record(context)
            for each in command.get_params(context)
            if isinstance(each, click.Option) and "--help" not in each.opts
        )
        rows = [(f"`{names}`", _plain(about)) for names, about in filter(None, records)]
        if rows:
            parts.append(table(("option", "meaning"), rows))
    return "\n\n".join(parts)


def _help_text(text: str) -> str:
    r"""Write a command's help; a paragraph whose lines click keeps (``\b``) is a block."""
    return "\n\n".join(
        f"```text\n{inspect.cleandoc(part[1:])}\n```" if part.startswith("\b") else _plain(part)
        for part in inspect.cleandoc(text).split("\n\n")
    )


def _plain(text: str) -> str:
    """Write text of the command line, which is Markdown between backquotes only."""
    pieces = text.split("`")
    pieces[::2] = [re.sub(r"([*_<>\[\]])", r"\\\1", piece) for piece in pieces[::2]]
    return "`".join(pieces)
