"""Which third-party code may run: the plugin files of a received checkpoint or run folder.

A file runs without a prompt if this user has trained with the same content on this machine, by SHA-256.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import platformdirs

from dockctl.errors import DockctlError
from dockctl.reading import read_bytes, read_json
from dockctl.run_files import BEST, CHECKPOINTS, LAST, POLICY_JSON, POLICY_TENSORS, PROVENANCE, generations

MARKS = (
    PROVENANCE,
    POLICY_JSON,
    POLICY_TENSORS,
    *(
        f"{CHECKPOINTS}/{folder}/{file}"
        for name in (BEST, LAST)
        for folder in generations(name)
        for file in (POLICY_JSON, POLICY_TENSORS)
    ),
)
"""A folder with one of these files, and everything below it, is a run folder or a checkpoint."""
log = logging.getLogger(__name__)


class UntrustedError(DockctlError):
    """A checkpoint or run folder names code that may not run yet."""

    code = "untrusted"


def state_folder() -> Path:
    """Return the folder of the known hashes, one empty file each; ``XDG_STATE_HOME`` moves it."""
    return platformdirs.user_state_path("dockctl") / "trusted"


def remember(digests: Iterable[str]) -> None:
    """Trust code on this machine from now on, by its SHA-256."""
    folder = state_folder()
    if not folder.is_absolute():  # the user has no home directory
        return
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for digest in digests:
            with suppress(FileExistsError):
                os.close(os.open(folder / digest, os.O_CREAT | os.O_EXCL, 0o600))
    except OSError as error:
        log.warning("%s: cannot be written; evaluating this run will need --trust: %s", folder, error)


def require(code: Iterable[tuple[str, str, str]], *, trust: bool) -> None:
    """Check that code may run.

    Args:
        code: description, SHA-256, and recorded SHA-256 or an empty string.
        trust: whether the user allows all of it.

    Raises:
        UntrustedError: some of it may not.
    """
    refused = []
    for name, digest, recorded in code:
        shown = f"{name}: SHA-256 {digest}" + (
            f", which differs from the recorded {recorded}" if recorded not in ("", digest) else ""
        )
        if trust:
            _announce(shown)
        elif recorded not in ("", digest) or not os.path.isfile(state_folder() / digest):
            refused.append(shown)
    if refused:
        hint = "third-party code, which runs with your permissions: read it, then allow it with --trust"
        hint += ", or give your own copy with --plugin FILE; in Python: load_policy(..., trust=True)"
        raise UntrustedError("\n".join([*refused, hint]))


@cache
def _announce(shown: str) -> None:
    log.warning("running code of %s", shown)


def is_received(scenario: Path) -> bool:
    """Return whether a scenario file, or the file that it links to, is in a run folder or a checkpoint."""
    folders = {*scenario.absolute().parents, *scenario.resolve().parents}
    return any(os.path.exists(folder / mark) for folder in folders for mark in MARKS)


def allowed(files: Iterable[Path], own: Sequence[Path], *, trust: bool) -> list[Path]:
    """Return those of the received plugin files that may run and that no file in `own` replaces.

    A file in `own` replaces a file with the same content, or with the same name without the number that a run
    folder prepends.

    Raises:
        UntrustedError: a file may not run.
        DockctlError: a file cannot be read.
    """
    digests = {file_digest(file): file for file in own}
    names = {file.name: file for file in own}
    code = {}
    for file in files:
        digest = file_digest(file)
        mine = digests.get(digest) or names.get(re.sub(r"^\d\d-", "", file.name))
        if mine is None:
            code[file] = str(file), digest, _recorded(file)
        elif digest not in digests:
            log.warning("%s replaces %s, which has a different SHA-256", mine, file)
    require(code.values(), trust=trust)
    return list(code)


def file_digest(file: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        DockctlError: it cannot be read.
    """
    return hashlib.sha256(read_bytes(file)).hexdigest()


def text_digest(text: str) -> str:
    """Return the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def _recorded(file: Path) -> str:
    """Return the hash of ``<run>/plugins/<name>`` in the provenance of the run, or an empty string."""
    run = file.parent.parent
    try:
        return str(read_json(run / PROVENANCE)["plugins"][file.relative_to(run).as_posix()])
    except (DockctlError, KeyError, TypeError):
        return ""
