"""The 3-D replay of `dockctl view`: one HTML page that needs no network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from importlib import resources
from typing import Any

import numpy as np
from jinja2 import Environment
from markupsafe import Markup

FILES = ("viewer.html", "viewer.css", "viewer.js", "three.js")
"""Package data in ``viewer/``; ``tools/viewer`` bundles ``three.js``."""


def page(data: Mapping[str, Any]) -> str:
    """Return the page as HTML.

    Args:
        data: of `dockctl.evaluation.replay.page_data`.
    """
    block = bytearray()
    # Plain "<" could end the script element that holds the data.
    header = json.dumps(_placed(data, block)).replace("<", "\\u003c")
    text = {name: (resources.files("dockctl.reports") / "viewer" / name).read_text("utf-8") for name in FILES}
    template = Environment(autoescape=True).from_string(text["viewer.html"])
    return template.render(
        title=data["title"],
        subtitle=data["subtitle"],
        style=Markup(text["viewer.css"]),
        three=Markup(text["three.js"]),
        script=Markup(text["viewer.js"]),
        header=Markup(header),
        arrays=base64.b64encode(gzip.compress(block, mtime=0)).decode(),
    )


def _placed(value: Any, block: bytearray) -> Any:
    """Append all arrays to `block`, at multiples of four bytes; return the data with their places."""
    if isinstance(value, Mapping):
        return {key: _placed(item, block) for key, item in value.items()}
    if isinstance(value, list):
        return [_placed(item, block) for item in value]
    if not isinstance(value, np.ndarray):
        return value
    place = {"offset": len(block), "shape": value.shape, "type": value.dtype.str.lstrip("<|")}
    block += value.tobytes() + bytes(-value.nbytes % 4)
    return place
