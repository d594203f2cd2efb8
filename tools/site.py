"""Hooks of the documentation site (mkdocs.yml): pages from the code, pages outside of docs/, and equations.

The Markdown files stay as they are for readers of the repository. Their links to files outside of docs/ lead
to copies of these files in the site, so that it is complete without a network.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import click
import typer
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
AT_THE_TOP = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
SOURCE = "source/"
"""Folder of the site with the files that pages link to."""
LINK = re.compile(r"(?<=\]\()([^)#\s]+)")
FENCE = re.compile(r"^(`{3,}).*?^\1$", re.M | re.S)
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages outside of docs/, and a page for every file or folder that a page links to."""
    for path, uri in AT_THE_TOP.items():
        files.append(File.generated(config, uri, content=(ROOT / path).read_text(encoding="utf-8")))
    waiting = [file.src_uri for file in files.documentation_pages()]
    while waiting:
        uri = waiting.pop()
        for target in links(files.src_uris[uri].content_string, repository_path(uri)):
            linked = site_path(target)
            if linked.startswith(SOURCE) and linked not in files.src_uris:
                files.append(File.generated(config, linked, content=source_page(target)))
                waiting.append(linked)
    return files


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:
    """Leave out the page that a server shows for an unknown address; its links only work on a server."""
    return "" if template_name == "404.html" else output


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links to the pages of the site, and fill in what is generated from the code."""
    uri = page.file.src_uri
    if "<!-- commands -->" in markdown:
        markdown = markdown.replace("<!-- commands -->", "\n".join(command_sections()))
    if "<!-- schema -->" in markdown:
        markdown = markdown.replace("<!-- schema -->", "\n".join(schema_sections()))
    here = repository_path(uri)

    def lead(match: re.Match[str]) -> str:
        target = resolved(match[1], here)
        return match[1] if target is None else relative(site_path(target), uri)

    return outside_code(markdown, lambda text: LINK.sub(lead, text))


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write the equations as MathML, which browsers draw without a library."""

    def formula(match: re.Match[str]) -> str:
        block = match[1] == "div"
        return drawable(convert(html.unescape(match[2]), display="block" if block else "inline"))

    return re.sub(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', formula, content, flags=re.S)


def drawable(mathml: str) -> str:
    """Return MathML that needs no mathematical font: others have no dots above and no tall brackets."""
    dotted = r"<mover><mi>([^<]+)</mi><mo>&#x002D9;</mo></mover>"
    mathml = re.sub(dotted, r"<mi>\1&#x0307;</mi>", mathml)
    opened = r"<mo[^>]*>&#x000(?:5B|7B);</mo><mtable>(.*?)</mtable>"
    fence = rf"{opened}(<mo[^>]*>&#x0005D;</mo>)?"
    return re.sub(fence, _with_borders, mathml, flags=re.S)


def _with_borders(match: re.Match[str]) -> str:
    return f'<mtable class="{"matrix" if match[2] else "cases"}">{match[1]}</mtable>'


def outside_code(markdown: str, change: Any) -> str:
    """Apply `change` to the text between fenced blocks."""
    parts, end = [], 0
    for fence in FENCE.finditer(markdown):
        parts += [change(markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, change(markdown[end:])])


def links(markdown: str, here: PurePosixPath) -> Iterator[PurePosixPath]:
    """Yield the files and folders of the repository that a page links to."""
    for target in LINK.findall(FENCE.sub("", markdown)):
        if (path := resolved(target, here)) is not None:
            yield path


def resolved(target: str, here: PurePosixPath) -> PurePosixPath | None:
    """Return the repository's path of a relative link, or None for others."""
    if "://" in target or target.startswith(("/", "mailto:")):
        return None
    path = (ROOT / here.parent / target).resolve()
    return PurePosixPath(path.relative_to(ROOT)) if path.is_relative_to(ROOT) and path.exists() else None


def site_path(path: PurePosixPath) -> str:
    """Return where the site has a file or folder of the repository."""
    if path.parts[:1] == ("docs",):
        return str(path.relative_to("docs"))
    if str(path) in AT_THE_TOP:
        return AT_THE_TOP[str(path)]
    if (ROOT / path).is_dir():
        return f"{SOURCE}{path}/{'README' if (ROOT / path / 'README.md').exists() else 'index'}.md"
    return f"{SOURCE}{path}" if path.suffix == ".md" else f"{SOURCE}{path}.md"


def repository_path(uri: str) -> PurePosixPath:
    """Return the file of the repository that a page of the site shows."""
    for path, page in AT_THE_TOP.items():
        if uri == page:
            return PurePosixPath(path)
    if not uri.startswith(SOURCE):
        return PurePosixPath("docs", uri)
    path = PurePosixPath(uri.removeprefix(SOURCE))
    return path if (ROOT / path).exists() or path.name == "index.md" else path.with_suffix("")


def relative(uri: str, page: str) -> str:
    """Return the link from `page` to `uri`."""
    return str(PurePosixPath(*[".."] * page.count("/"), uri))


def source_page(path: PurePosixPath) -> str:
    """Return the page of a file or folder outside of docs/."""
    place = ROOT / path
    hidden = "---\nsearch:\n  exclude: true\n---\n"
    if place.is_dir() and (place / "README.md").exists():
        place /= "README.md"
    if place.is_dir():
        names = sorted(file.name for file in place.iterdir() if not file.name.startswith(("_", ".")))
        shown = (f"[{n}]({n})" if (place / n).is_dir() or Path(n).suffix in LANGUAGES else n for n in names)
        return f"{hidden}# {path}/\n\n" + "".join(f"- {name}\n" for name in shown)
    text = place.read_text(encoding="utf-8")
    if place.suffix == ".md":
        return text
    return f"{hidden}# {path}\n\n`````{LANGUAGES.get(place.suffix, 'text')}\n{text}`````\n"


def command_sections() -> Iterator[str]:
    """Yield the help of every command as Markdown."""
    from dockctl.cli import GROUPS, app

    program: Any = typer.main.get_command(app)
    for heading, group in GROUPS.items():
        yield f"\n## {heading}\n"
        for name in group:
            yield from command_section(name, program.commands[name])


def command_section(name: str, command: Any) -> Iterator[str]:
    """Yield the help of one command, and of its subcommands."""
    context = click.Context(command, info_name=f"dockctl {name}")
    yield f"\n### dockctl {name}\n"
    text, _, example = (command.help or "").partition("Example:")
    yield f"{escaped(text)}\n"
    yield f"```\n{command.get_usage(context).removeprefix('Usage: ')}\n```\n"
    if example:
        yield f"```\n{example.strip()}\n```\n"
    rows = [row for parameter in command.params if (row := parameter_row(parameter, context))]
    if rows:
        yield "| argument or option | |\n| --- | --- |"
        yield from rows
    for child, inner in getattr(command, "commands", {}).items():
        yield from command_section(f"{name} {child}", inner)


def parameter_row(parameter: Any, context: click.Context) -> str | None:
    record = parameter.get_help_record(context)
    if record is None or parameter.name == "help":
        return None
    return f"| {literal(record[0])} | {escaped(record[1])} |"


def literal(text: str) -> str:
    """Return code as HTML, which may contain the character that separates the columns of a table."""
    return f"<code>{escaped(text)}</code>"


def escaped(text: str) -> str:
    """Return plain text as Markdown with all special characters escaped."""
    return re.sub(r"[\\`*_{}\[\]<>|&]", lambda match: f"&#{ord(match[0])};", text)


def schema_sections() -> Iterator[str]:
    """Yield a table for every object of the schema of scenario files."""
    from dockctl.scenarios.json_schema import DEFINITIONS, INHERITED, scenario_schema

    schema = scenario_schema()
    for name, model in schema["definitions"].items():
        if name.endswith(INHERITED):
            continue
        yield f"\n## {name}\n\n{escaped(' '.join(model.get('description', '').split()))}\n"
        if "properties" not in model:
            yield f"{type_name(model, DEFINITIONS)}\n"
            continue
        yield "| key | type | default | |\n| --- | --- | --- | --- |"
        for key, value in model["properties"].items():
            if key in model.get("required", ()):
                default = "required"
            else:
                default = code(value["default"]) if "default" in value else ""
            note = escaped(value.get("description", ""))
            yield f"| `{key}` | {type_name(value, DEFINITIONS)} | {default} | {note} |"


def code(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return literal(text) if len(text) <= 60 else "see there"


def type_name(value: Any, prefix: str) -> str:
    """Return a type of the schema in words, with links to the objects of this page."""
    if value is True:
        return "any"
    if "$ref" in value:
        name = value["$ref"].removeprefix(prefix)
        return f"[{name}](#{name.lower().replace(' ', '-')})"
    for choice in ("anyOf", "oneOf", "allOf"):
        if choice in value:
            return " or ".join(dict.fromkeys(type_name(each, prefix) for each in value[choice]))
    if "const" in value:
        return code(value["const"])
    if "enum" in value:
        return ", ".join(map(code, value["enum"]))
    kind = value.get("type", "any")
    if kind == "array":
        inner = value.get("items", value.get("prefixItems", True))
        inner = inner if not isinstance(inner, list) else {"anyOf": inner}
        return f"list of {type_name(inner, prefix)}"
    if kind == "object" and isinstance(value.get("additionalProperties"), dict):
        return f"mapping to {type_name(value['additionalProperties'], prefix)}"
    if "properties" in value and "additionalProperties" in value:
        inner = (f"`{key}`: {type_name(each, prefix)}" for key, each in value["properties"].items())
        return f"{{{', '.join(inner)}}}"
    return " ".join([kind if isinstance(kind, str) else " or ".join(kind), *bounds(value)])


def bounds(value: dict[str, Any]) -> Iterator[str]:
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    for keyword, sign in signs.items():
        if keyword in value:
            yield f"{sign} {value[keyword]:g}"


def on_env(env: Any, config: MkDocsConfig, files: Files) -> None:
    """Reject a theme that would load something from the network."""
    if config.theme.get("font"):
        raise PluginError("mkdocs.yml: theme.font must be false: the site opens without a network")
