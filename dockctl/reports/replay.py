"""The 3-D replay of `dockctl view`: one HTML page that works offline."""

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

FILES = ("page/theme.css", "viewer/viewer.css", "viewer/viewer.html", "viewer/viewer.js", "viewer/three.js")
"""Package data; ``tools/viewer`` bundles ``three.js``."""


def page(data: Mapping[str, Any]) -> str:
    """Return the page as HTML.

    Args:
        data: result of `dockctl.evaluation.replay.page_data`.
    """
    block = bytearray()
    # Plain "<" could end the script element that holds the data.
    header = json.dumps(_placed(data, block)).replace("<", "\\u003c")
    theme, style, html, script, three = (
        (resources.files("dockctl.reports") / name).read_text("utf-8") for name in FILES
    )
    return (
        Environment(autoescape=True)
        .from_string(html)
        .render(
            title=data["title"],
            subtitle=data["subtitle"],
            style=Markup(theme + style),
            three=Markup(three),
            script=Markup(script),
            header=Markup(header),
            arrays=base64.b64encode(gzip.compress(block, mtime=0)).decode(),
        )
    )


def _placed(value: Any, block: bytearray) -> Any:
    """Append all arrays to `block`, at multiples of four bytes; return the data with their offsets."""
    if isinstance(value, Mapping):
        return {key: _placed(item, block) for key, item in value.items()}
    if isinstance(value, list):
        return [_placed(item, block) for item in value]
    if not isinstance(value, np.ndarray):
        return value
    place = {"offset": len(block), "shape": value.shape, "type": value.dtype.str.lstrip("<|")}
    block += value.tobytes() + bytes(-value.nbytes % 4)
    return place
