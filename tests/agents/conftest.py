"""Fixtures of the tests of stopped trainings."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from dockctl.agents import background_learning, trainer
from tests.agents.stops import TRAINING, finish, new_run


@pytest.fixture(scope="module")
def rows_of_several_updates() -> Iterator[None]:
    """Most stops are between the updates of one row of updates.csv, and many updates are made ahead."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "UPDATE_ROWS", TRAINING.updates_due(TRAINING.total_steps) // 7)
        patch.setattr(background_learning, "MOST_AHEAD", 5)
        yield


@pytest.fixture(scope="module")
def uninterrupted(
    rows_of_several_updates: None, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    return finish(new_run(tmp_path_factory.mktemp("whole")))
