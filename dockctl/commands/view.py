"""``dockctl view``: a 3-D replay in one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import (
    Ckpt,
    Overrides,
    Plugins,
    Poses,
    ScenarioOption,
    Trust,
    choose_policy,
    parse_pose,
    print_paths,
    select_policy,
)
from dockctl.console import print_notes


def view(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="POLICY",
            help="Policy, as for `dockctl evaluate`, or a scenario to see its poses; the latest run in ./runs"
            " by default, or a shipped policy if there is no run.",
        ),
    ] = None,
    ckpt: Ckpt = None,
    also: Annotated[
        list[str] | None,
        typer.Option(metavar="POLICY", help="Another policy from the same starts; can be repeated."),
    ] = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    pose: Poses = None,
    out: Annotated[
        Path | None, typer.Option(help="The page; named after the policies and changed values by default.")
    ] = None,
    gif: Annotated[
        Path | None, typer.Option(help="Write a video from above to this file (GIF), instead of the page.")
    ] = None,
    mp4: Annotated[
        Path | None, typer.Option(help="The same as MP4; needs ffmpeg or the extra dockctl[video].")
    ] = None,
    plugin: Plugins = None,
    trust: Trust = False,
) -> None:
    """Write a 3-D replay as one HTML page that works offline, or a video.

    Example: dockctl view s3 --pose 25,0.5,175
    """
    from dockctl.errors import DockctlError
    from dockctl.evaluation.loading import is_scenario
    from dockctl.evaluation.replay import page_data, preview, replay
    from dockctl.reports import animation
    from dockctl.reports.replay import page
    from dockctl.runs.files import require_writable_file, write_atomically
    from dockctl.runs.results import file_stem
    from dockctl.sim.checks import load_checked

    for path, suffix in ((out, ".html"), (gif, ".gif"), (mp4, ".mp4")):
        if path:
            require_writable_file(path, suffix)
    if mp4:
        animation.ffmpeg()  # fails before the episodes run
    poses = [parse_pose(text) for text in pose or ()]
    given = choose_policy(source, ckpt, scenario)
    if is_scenario(given):
        if also or scenario is not None:
            raise DockctlError(f"{given}: a scenario has no policy to show; omit --also and --scenario")
        loaded = load_checked(given, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
        shown, names = preview(loaded, poses), [loaded.scenario.name]
    else:
        policies = [select_policy(each, None, plugin, trust, scenario) for each in (given, *(also or ()))]
        with Console(stderr=True).status("running episodes"):
            shown = replay(policies, scenario, poses, set_ or ())
        print_notes(note for each in policies for note in each.notes_on(shown.scenario, set_ or ()))
        names = [p.file_name for p in policies] + ([shown.scenario.name] if scenario else [])
    data = page_data(shown)
    if out or not (gif or mp4):
        path = out or Path(f"{file_stem(['view', *names], set_ or ())}.html")
        print_paths([write_atomically(path, page(data).encode())])
    for path, write in ((gif, animation.write_gif), (mp4, animation.write_mp4)):
        if path:
            with Console(stderr=True).status("drawing the video"):
                video = write(path, shown.scene, data)
            print_paths([video])
