"""Every example of docs/python.md and docs/deployment.md runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [(ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("python.md", "deployment.md")]
EXAMPLES = [example for page in PAGES for example in re.findall(r"```python\n(.*?)```", page, re.S)]


@pytest.mark.parametrize("example", EXAMPLES, ids=[str(number) for number in range(len(EXAMPLES))])
def test_an_example_runs(
    example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    exec(compile(example, "<example>", "exec"), {})
    assert capsys.readouterr().out.strip()
