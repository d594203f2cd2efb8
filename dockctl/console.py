"""Plain lines: shown as they are, whatever a path in them looks like."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


def say(console: Console, text: str, style: str = "") -> None:
    """Print `text` without markup, highlights or line breaks of the console's own."""
    console.print(Text(text, style=style), soft_wrap=True)
