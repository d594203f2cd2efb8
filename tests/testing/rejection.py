"""How a contract test refuses what breaks a rule."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from dockctl import testing
from dockctl.testing.contract import Rule


def assert_rejected(check: Callable[[], None], rule: Rule) -> None:
    with pytest.raises(testing.ContractError) as caught:
        check()
    assert caught.value.rule == rule
