"""Whether two scenarios mean the same, whatever they are called and wherever their files lie."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from typing import Any

from dockctl.scenarios.files import mesh_files, naming
from dockctl.scenarios.schema import Scenario

WORDS = {"title", "description", "plugins"}
"""Fields that neither a training nor an episode depends on."""


def difference(asked: Scenario, found: Scenario, *, but: Collection[str] = ()) -> str | None:
    """The first field in which two scenarios differ, None where they mean the same.

    Args:
        but: fields that do not count.

    Raises:
        OSError: a mesh cannot be read.
    """
    return _difference(_substance(asked, but), _substance(found, but))


def _substance(scenario: Scenario, but: Collection[str]) -> dict[str, Any]:
    """What a scenario means: of a mesh not where its file lies, but what it holds."""
    contents = [hashlib.sha256(path.read_bytes()).hexdigest() for path in mesh_files(scenario)]
    return naming(scenario, (), contents).model_dump(exclude={*WORDS, *but})


def _difference(asked: Any, found: Any, path: str = "") -> str | None:
    """The first field in which two trees differ."""
    if isinstance(asked, dict) and isinstance(found, dict):
        fields = (
            _difference(asked.get(key), found.get(key), f"{path}.{key}".lstrip("."))
            for key in {**asked, **found}
        )
        return next((difference for difference in fields if difference), None)
    return None if asked == found else f"{path} is {_short(found)}, asked is {_short(asked)}"


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."
