"""JSON Schema (draft 7) of scenario, vessel and harbor files, for completion and checks in editors.

A schema describes the structure of a file, not constraints between values. A file that extends another may
omit required keys, except in list items, because lists replace the inherited ones as a whole.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any, get_type_hints

from pydantic import BaseModel, TypeAdapter
from pydantic.errors import PydanticSchemaGenerationError

from dockctl.errors import DockctlError
from dockctl.plugins import CONDITIONS, HARBORS, OBSERVATION_PARTS, REWARD_TERMS, SCENARIOS, VESSELS, Function
from dockctl.registry import Entry, Registry
from dockctl.scenarios import catalog
from dockctl.scenarios.harbor import HarborSpec
from dockctl.scenarios.kinds import Kinds
from dockctl.scenarios.relocation import BERTH, PATTERN
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Vessel

Schema = dict[str, Any]

DRAFT = "http://json-schema.org/draft-07/schema#"
DEFINITIONS = "#/definitions/"
INHERITED = " of a file that extends another"
"""Appended to the name of a definition without required keys."""
BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""Pydantic's own keywords for a bound that follows a validator."""
_CHOICES, _INNER = ("anyOf", "oneOf", "allOf"), ("items", "additionalProperties")


def scenario_schema() -> Schema:
    """Return the schema of scenario files, with everything that is registered."""
    catalog.fill()
    schema = Scenario.model_json_schema()
    definitions, properties = schema["$defs"], schema["properties"]
    schema["required"].remove("name")  # the file name by default
    properties["vessel"] = {"anyOf": [_name_of(VESSELS), properties["vessel"]]}
    properties["harbor"] = {"anyOf": [_name_of(HARBORS), properties["harbor"]]}
    properties["conditions"] = definitions["Training"]["properties"]["conditions"] = _conditions()
    text = {"type": "string", "pattern": rf"^\s*{PATTERN}\s*$", "description": "move the poses to this berth"}
    properties[BERTH] = {"anyOf": [text, {"type": "null"}]}
    definitions["ObservationPart"] = _observation_part()
    terms = definitions["Reward"]["properties"]["terms"]
    definitions["Reward"]["properties"]["terms"] = {"anyOf": [_terms_by_name(), terms]}
    definitions["WeightedTerm"] = _weighted_term()
    return _file(schema, SCENARIOS)


def vessel_schema() -> Schema:
    """Return the schema of vessel files."""
    catalog.fill()
    return _file(Vessel.model_json_schema(), VESSELS)


def harbor_schema() -> Schema:
    """Return the schema of harbor files."""
    catalog.fill()
    return _file(TypeAdapter(HarborSpec).json_schema(), HARBORS)


def model_schema(model: type[BaseModel]) -> Schema:
    """Return the schema of files that cannot extend others."""
    schema = _draft_7(model.model_json_schema())
    return {"$schema": DRAFT, **schema}


def _file(schema: Schema, registry: Registry[Any]) -> Schema:
    """Return the schema of files that may extend one of `registry`."""
    definitions = schema.pop("$defs", {})
    top, partial = f"{registry.noun} file", f"{registry.noun} file{INHERITED}"
    definitions[top] = schema
    definitions |= {f"{name}{INHERITED}": _inherited(part) for name, part in definitions.items()}
    for name in (top, partial):
        definitions[name] = _with_key(definitions[name], "extends", _name_of(registry), definitions)
    return {
        "$schema": DRAFT,
        "title": top,
        "type": "object",
        "if": {"required": ["extends"]},
        "then": {"$ref": DEFINITIONS + partial},
        "else": {"$ref": DEFINITIONS + top},
        "definitions": {name: _draft_7(part) for name, part in definitions.items()},
    }


def _with_key(schema: Schema, key: str, value: Schema, definitions: dict[str, Schema]) -> Schema:
    """Return the schema of a mapping, or of a choice of mappings, with a further key."""
    if "$ref" in schema:
        return _with_key(definitions[schema["$ref"].removeprefix("#/$defs/")], key, value, definitions)
    if "properties" in schema:
        return {**schema, "properties": {key: value, **schema["properties"]}}
    choices = schema.get("oneOf") or schema["anyOf"]
    return {"anyOf": [_with_key(choice, key, value, definitions) for choice in choices]}


def _name_of(registry: Registry[Any]) -> Schema:
    """Return the schema of a registered name or a path."""
    path = {"type": "string", "pattern": r"[./]", "description": f"path of a {registry.noun} file"}
    return {"anyOf": [{"enum": sorted(registry.names())}, path]}


def _conditions() -> Schema:
    """Return the schema of conditions by name: the key is the kind unless the section has one."""
    kinds = Kinds(CONDITIONS)
    models = {name: model.model_json_schema() for name in CONDITIONS.names() if (model := kinds.model(name))}
    named = [{"allOf": [model], "required": ["kind"]} for model in models.values()]
    forms = {name: {"anyOf": [{"type": "null"}, model, *named]} for name, model in models.items()}
    others = {"anyOf": [{"type": "null"}, *named]}
    return {"type": "object", "properties": forms, "additionalProperties": others}


def _observation_part() -> Schema:
    forms: list[Schema] = [{"enum": OBSERVATION_PARTS.names()}]
    for entry in _loaded(OBSERVATION_PARTS):
        params, optional = _parameters(entry), {"anyOf": [_parameters(entry), {"type": "null"}]}
        forms.append(_mapping({entry.name: optional}, required=[entry.name]))
        long = {"part": {"const": entry.name}, "params": params}
        forms.append(_mapping(long, required=["part", *_needed(entry)]))
    return {"anyOf": forms}


def _terms_by_name() -> Schema:
    """Return the schema of ``{distance: -150, mine: {term: speed, weight: -10}, orientation: null}``."""
    short: list[Schema] = [{"type": "null"}, {"type": "number"}]
    by_name: dict[str, Schema] = {}
    for entry in _loaded(REWARD_TERMS):
        own = {"term": {"const": entry.name}, "weight": {"type": "number"}, "params": _parameters(entry)}
        forms = [*(short if not _needed(entry) else short[:1]), _mapping(own, ["weight", *_needed(entry)])]
        by_name[entry.name] = {"description": _summary(entry), "anyOf": forms}
    others = {"anyOf": [{"type": "null"}, {"$ref": "#/$defs/WeightedTerm"}]}
    return {"type": "object", "minProperties": 1, "properties": by_name, "additionalProperties": others}


def _weighted_term() -> Schema:
    """Return the schema of a term that is named by its key `term`."""
    forms = [
        _mapping(
            {"term": {"const": entry.name}, "weight": {"type": "number"}, "params": _parameters(entry)},
            ["term", "weight", *_needed(entry)],
        )
        for entry in _loaded(REWARD_TERMS)
    ]
    return {"anyOf": forms}


def _loaded(registry: Registry[Function]) -> Iterable[Entry[Function]]:
    """Yield the entries of a registry, without those of a package that fails to import."""
    for name in registry.names():
        try:
            yield registry.get(name)
        except DockctlError:
            continue


def _parameters(entry: Entry[Function]) -> Schema:
    """Return the schema of the parameters of a term or a part, from their type hints."""
    try:
        hints = get_type_hints(entry.value, include_extras=True)
    except NameError:  # imported for type checkers only
        hints = {}
    properties = {name: _of_hint(hints.get(name, Any)) for name in entry.parameters}
    return _mapping(properties, _required_parameters(entry)) | {"description": _summary(entry)}


def _of_hint(hint: Any) -> Schema:
    try:
        schema = TypeAdapter(hint).json_schema()
    except PydanticSchemaGenerationError:  # not a plain type
        return {}
    return {} if "$defs" in schema else schema


def _required_parameters(entry: Entry[Function]) -> list[str]:
    return [name for name, default in entry.parameters.items() if default is inspect.Parameter.empty]


def _needed(entry: Entry[Function]) -> list[str]:
    """Return the key `params` if it is required."""
    return ["params"] if _required_parameters(entry) else []


def _summary(entry: Entry[Function]) -> str:
    first = (inspect.getdoc(entry.value) or "").partition("\n\n")[0]
    return f"{' '.join(first.split())} ({entry.source or entry.origin})".strip()


def _mapping(properties: dict[str, Schema], required: list[str]) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
        **({"required": required} if required else {}),
    }


def _inherited(schema: Any) -> Any:
    """Return a schema for values that are merged into others: no key is required, except in items."""
    if not isinstance(schema, dict):
        return schema
    changed = {key: value for key, value in schema.items() if key not in ("required", "discriminator")}
    if "$ref" in changed:
        changed["$ref"] += INHERITED
    if "properties" in changed:
        changed["properties"] = {key: _inherited(value) for key, value in changed["properties"].items()}
    for key in ("anyOf", "allOf"):
        if key in changed:
            changed[key] = [_inherited(part) for part in changed[key]]
    if "oneOf" in changed:  # without its tag, a value may match several
        changed["anyOf"] = [_inherited(part) for part in changed.pop("oneOf")]
    if "additionalProperties" in changed:
        changed["additionalProperties"] = _inherited(changed["additionalProperties"])
    return changed


def _draft_7(schema: Any) -> Any:
    """Convert a pydantic schema to draft 7, which more editors support, without generated titles."""
    if not isinstance(schema, dict):
        return schema
    changed: Schema = {}
    for key, value in schema.items():
        if key == "$defs":
            changed["definitions"] = {name: _draft_7(part) for name, part in value.items()}
        elif key == "properties":
            changed[key] = {name: _draft_7(part) for name, part in value.items()}
        elif key == "prefixItems":
            changed["items"] = [_draft_7(part) for part in value]
        elif key in _CHOICES:
            changed[key] = [_draft_7(part) for part in value]
        elif key in _INNER:
            changed[key] = _draft_7(value)
        elif key == "description":
            changed[key] = " ".join(value.partition("\n\n")[0].split())
        elif key in BOUNDS:
            changed[BOUNDS[key]] = value
        elif key not in ("title", "discriminator"):
            changed[key] = value
    if "$ref" in changed:
        target = DEFINITIONS + changed.pop("$ref").removeprefix("#/$defs/")
        return {**changed, "allOf": [{"$ref": target}]} if changed else {"$ref": target}
    return changed
