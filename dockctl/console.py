"""Print plain text: paths and messages may contain characters that Rich would interpret."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


def say(console: Console, text: str, style: str = "") -> None:
    """Print `text` without markup, highlighting or wrapping."""
    console.print(Text(text, style=style), soft_wrap=True)
