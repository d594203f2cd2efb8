"""Validation of a section that a plugin may define, by its key `kind`."""

from __future__ import annotations

from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from dockctl import plugins
from dockctl.errors import DockctlError
from dockctl.registry import Registry
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.extensions import Kind
from dockctl.scenarios.yaml_tree import describe


class Kinds:
    """Annotation of a field that holds a model from a registry.

    It works like pydantic's discriminated unions, but looks up the model at validation time: plugins register
    their models after the schema of the scenario is built, and errors name the origin.

    Args:
        registry: the models by name.
        default: the kind of a section that does not name one.
    """

    def __init__(self, registry: Registry[type[Any]], default: str | None = None) -> None:
        self.registry, self.default = registry, default
        self.base: type[Kind] = Kind

    def model(self, kind: object) -> type[Kind] | None:
        """Return the model registered as `kind`, or the default for None; None if there is no such model."""
        name = self.default if kind is None else kind
        try:
            return self.registry.get(str(name)).value
        except DockctlError:
            return None

    def make_default(self) -> Any:
        """Return the default kind with its default values."""
        return self._validate({})

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        self.base = source
        return core_schema.no_info_plain_validator_function(
            self._validate,
            serialization=core_schema.plain_serializer_function_ser_schema(_dump, info_arg=True),
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        plugins.load_builtins()
        sections: list[dict[str, Any]] = [{"enum": sorted(self.registry.names())}]
        for name in self.registry.names():
            if model := self.model(name):
                section = handler(model.__pydantic_core_schema__)
                needed = {} if name == self.default else {"required": ["kind"]}
                sections.append({"allOf": [section], **needed})
        return {"anyOf": sections}

    def _validate(self, given: Any) -> Kind:
        if isinstance(given, Kind):
            return given
        if isinstance(given, str):
            given = {"kind": given}
        if not isinstance(given, dict):
            raise PydanticKnownError("model_type", {"class_name": "mapping"})
        name = given.get("kind", self.default)
        if not isinstance(name, str):
            known = ", ".join(sorted(self.registry.names()))
            if name is None:
                raise FieldError("kind", f"missing (one of: {known})", "missing_key")
            raise FieldError("kind", f"found {describe(name)}, expected one of: {known}", "wrong_type")
        plugins.load_builtins()
        try:
            model: type[Kind] = self.registry.get(name).value
        except DockctlError as error:
            raise FieldError("kind", error.message, error.code, error.suggestion) from None
        flaw = ""
        if not issubclass(model, self.base):
            flaw = f"is not a subclass of {self.base.__name__}"
        elif missing := sorted(model.__abstractmethods__):
            flaw = f"does not define {', '.join(missing)}"
        if flaw:
            raise FieldError("kind", f"'{name}' by {self.registry.origin(name)} {flaw}", "plugin")
        return model.model_validate({**given, "kind": name})


def _dump(value: Kind, info: SerializationInfo) -> dict[str, Any]:
    return value.model_dump(mode=info.mode)
