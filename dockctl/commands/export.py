"""``dockctl export``: write a policy to share, or for a boat."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Plugins, Trust, latest_run
from dockctl.errors import DockctlError
from dockctl.run_files import CHECKPOINTS


def export(
    ckpts: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="CKPT",
            help="Run folders of one scenario; with --onnx or --pilot one run folder, checkpoint or shipped"
            " name. The latest run in ./runs by default.",
        ),
    ] = None,
    onnx: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write an ONNX model instead (.onnx).")
    ] = None,
    pilot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a file for dockctl.pilot instead (.npz).")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the checkpoint; the scenario by default.")] = None,
    plugin: Plugins = None,
    trust: Trust = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the checkpoint: <out>/<name>/; checkpoints by default.")
    ] = None,
) -> None:
    """Export a policy: a folder with its model card, an ONNX model, or a file for a boat's computer.

    The folder contains the best policy of the given runs, which must be evaluated. Policies are ranked by
    success from the evaluation poses, or at the trained berths; then from the random starts, or at the
    held-out berths; then on the other scenarios they were evaluated on; then by the lowest seed. The policy
    must dock from all its training poses, unless its scenario has many berths. The card includes the results
    of `evaluate`, `map` and `latency`.

    An ONNX model takes observations in SI units and includes their scaling and the choice of the command. A
    file for `dockctl.pilot` needs only NumPy on the boat. Both contain a description: docs/deployment.md.

    Example: dockctl export s3 --pilot s3.npz
    """
    from dockctl.experiments import export, portable

    ckpts = ckpts or [latest_run()]
    if onnx is None and pilot is None:
        export.export_checkpoint(
            ckpts, name, out or Path(CHECKPOINTS), plugin_files=plugin or (), trust=trust
        )
        return
    if name is not None or out is not None:
        raise DockctlError("--name and --out are for the checkpoint folder: omit them with --onnx or --pilot")
    portable.export_files(ckpts, onnx, pilot, plugin_files=plugin or (), trust=trust)
