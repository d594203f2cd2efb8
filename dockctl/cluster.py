"""Ray, for work on all cores of this machine or on a cluster: ``--on ray`` and ``--on ray:ADDRESS``."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dockctl import __version__
from dockctl.compute import usable_cores
from dockctl.errors import DockctlError

CONNECT_SECONDS = 5.0


@contextmanager
def connected(on: str) -> Iterator[int]:
    """Start Ray on the cores of this machine, or connect to a cluster; yield the number of its cores.

    Args:
        on: ``ray``, or ``ray:ADDRESS`` with an address that `ray.init` accepts.

    Raises:
        DockctlError: Ray is not installed or does not start, or the cluster cannot be reached.
    """
    place, _, address = on.partition(":")
    if place != "ray" or on.endswith(":"):
        message = f"--on '{on}': expected ray for this machine, or ray:ADDRESS for a cluster, like ray:auto"
        raise DockctlError(message)
    for name in ("RAY_USAGE_STATS_ENABLED", "RAY_worker_niceness"):
        os.environ.setdefault(name, "0")
    try:
        import ray
    except ImportError:
        message = "--on ray: the package ray is not installed; run: pip install 'dockctl[ray]'"
        raise DockctlError(message, code="unavailable") from None
    settings: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if not address:
        settings |= {"num_cpus": usable_cores(), "include_dashboard": False}
    elif address != "auto":
        _require_listener(address)
    try:
        ray.init(address or "local", **settings)
    except Exception as error:  # also plain exceptions, as on a machine too busy to start Ray in time
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        if not address:
            raise DockctlError(f"--on ray: Ray does not start: {reason}", code="unavailable") from None
        raise _unreachable(address, reason) from None
    try:
        yield max(1, int(ray.cluster_resources().get("CPU", 1)))
    finally:
        ray.shutdown()


def _require_listener(address: str) -> None:
    """Check that something listens at ``[ray://]host:port``: Ray itself would try for minutes.

    Raises:
        DockctlError: nothing does.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise _unreachable(address, "expected auto, HOST:PORT or ray://HOST:PORT")
    try:
        socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise _unreachable(address, getattr(error, "strerror", None) or str(error)) from None


def _unreachable(address: str, reason: str) -> DockctlError:
    return DockctlError(f"--on ray:{address}: cannot be reached: {reason}", code="unavailable")


def require_version(version: str) -> None:
    """Check, on a worker, that it has the same version of dockctl as the command.

    Raises:
        DockctlError: the versions differ.
    """
    if version != __version__:
        message = f"{socket.gethostname()}: has dockctl {__version__}, but this command is {version}"
        raise DockctlError(f"{message}; install the same version on all machines", code="mismatch")


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files, given by their paths below `folder`."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
