"""The 3-D replay: its data, and the page in a browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from dockctl.evaluation.replay import MAX_POINTS, Replay, _cloud, page_data, preview, replay
from dockctl.evaluation.rollout import Rollout
from dockctl.geometry import sector_index
from dockctl.reports.replay import page
from dockctl.runs.directory import SHIPPED
from dockctl.scenarios.base import Pose
from dockctl.scenarios.extensions import RangeSensor
from dockctl.scenarios.loader import load
from tests.commands.conftest import only_run, quick_train
from tests.reports.browser import opened, wait

POSES = [Pose(x_m=24.0, y_m=0.5, heading_deg=178.0), Pose(x_m=26.0, y_m=1.0, heading_deg=170.0)]
CONTROLLER = "examples/controller/reverse.py:Reverse"


@pytest.fixture(scope="module")
def played() -> Replay:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dockctl.evaluation.replay.MAX_SCANS", 24)
        shown = replay(["s1", CONTROLLER], "s1", POSES)
    first, *others = shown.tracks
    wind = np.tile([3.0, -4.0], (first.episode.steps + 1, 1))
    blown = replace(first.episode, trajectory={**first.episode.trajectory, "wind": wind})
    return replace(shown, tracks=[replace(first, episode=blown), *others])


@pytest.fixture(scope="module")
def html(played: Replay) -> str:
    return page(page_data(played))


def contents(html: str) -> tuple[dict[str, Any], bytes]:
    header = re.search(r'id="replay">(.*?)</script>', html, re.DOTALL)
    arrays = re.search(r'id="arrays">(.*?)</script>', html, re.DOTALL)
    assert header and arrays
    return json.loads(header[1]), gzip.decompress(base64.b64decode(arrays[1]))


def stored(block: bytes, reference: dict[str, Any]) -> NDArray[Any]:
    count = int(np.prod(reference["shape"]))
    array = np.frombuffer(block, f"<{reference['type']}", count, reference["offset"])
    return array.reshape(reference["shape"])


def test_the_page_holds_each_step_of_each_policy(played: Replay, html: str) -> None:
    header, block = contents(html)
    assert len(header["episodes"]) == len(played.tracks) == 4
    for given, track in zip(header["episodes"], played.tracks, strict=True):
        arrays = {name: stored(block, reference) for name, reference in given["arrays"].items()}
        recorded = track.episode.trajectory
        for name in ("pose", "velocity", "command", "distance_m", "heading_error_rad", "phase", "reward"):
            np.testing.assert_allclose(arrays[name], recorded[name], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(arrays["terms"].sum(axis=1), recorded["reward"], rtol=1e-4, atol=1e-3)
        assert given["outcome"] == track.episode.outcome
    colors = {
        (track.policy, given["color"]) for given, track in zip(header["episodes"], played.tracks, strict=True)
    }
    assert len(colors) == len({policy for policy, _ in colors}) == len({color for _, color in colors}) == 2


@pytest.mark.thorough
def test_policies_of_the_same_scenario_and_seed_are_told_apart(tmp_path: Path) -> None:
    """For example a training that was stopped early, and its longer repetition."""
    for name in ("early", "late"):
        shutil.copytree(SHIPPED / "s1", tmp_path / name)
    header, _ = contents(page(page_data(replay([tmp_path / "early", tmp_path / "late"], "s1", POSES[:1]))))
    for key in ("label", "policy"):
        assert [given[key] for given in header["episodes"]] == ["early", "late"]
    assert len({given["color"] for given in header["episodes"]}) == 2


def test_the_largest_q_value_is_that_of_the_command(played: Replay, html: str) -> None:
    header, block = contents(html)
    shown = [given for given in header["episodes"] if "q" in given["arrays"]]
    assert [given["policy"] for given in shown] == ["s1", "s1"]
    for given in shown:
        forces, angles = given["grid"]["propeller_n"], given["grid"]["rudder_deg"]
        chosen = stored(block, given["arrays"]["q"]).argmax(axis=1)[:-1]
        command = stored(block, given["arrays"]["command"])[1:]
        assert command[:, 0].tolist() == [forces[i // len(angles)] for i in chosen]


@pytest.mark.thorough
def test_each_policy_has_its_own_actions_and_sensor(tmp_path: Path) -> None:
    """A policy with a coarser grid and a sensor of shorter range, beside one with the scenario's own."""
    settings = ("actions.propeller_n=[-50,0,50]", "actions.rudder_deg=[-30,0,30]", "sensors.lidar.range_m=40")
    assert quick_train(tmp_path, "s1", "--steps", 60, *(w for s in settings for w in ("--set", s))).code == 0
    header, _ = contents(page(page_data(replay(["s1", only_run(tmp_path)], "s1", POSES[:1]))))
    for given in header["episodes"]:
        forces, angles = given["grid"]["propeller_n"], given["grid"]["rudder_deg"]
        assert given["arrays"]["q"]["shape"][1] == len(forces) * len(angles)
    assert [len(given["grid"]["propeller_n"]) for given in header["episodes"]] == [11, 3]
    assert [given["range_m"] for given in header["episodes"]] == [100, 40]


def test_points_are_those_of_the_sensor(played: Replay) -> None:
    rollout = Rollout(load("s1"))
    assert sum(len(track.scans) for track in played.tracks) <= 24 + len(played.tracks)
    assert sum(len(points) for track in played.tracks for points in track.scans.values()) <= 1.1 * MAX_POINTS
    track = played.tracks[-1]
    step, points = list(track.scans.items())[-1]
    measured = rollout.worlds[0].lidar.points(track.episode.trajectory["pose"][step])
    assert set(map(tuple, points)) <= set(map(tuple, measured))


def test_points_that_a_page_cannot_hold_are_left_out() -> None:
    points = np.array([[1.0, 2.0, 3.0], [400.0, 0.0, 0.0], [-326.0, 5.0, 0.0]])
    sensor = cast(RangeSensor, SimpleNamespace(points=lambda pose, every: points[::every]))
    np.testing.assert_array_equal(_cloud(sensor, "spinning", 16, np.zeros(3)), points[[0, 2]])


def test_harbor_corners_are_exact_to_millimeters(played: Replay, html: str) -> None:
    header, block = contents(html)
    harbor = header["harbor"]
    corners = stored(block, harbor["corners"]).reshape(-1, 3) * harbor["scale"] + harbor["origin"]
    expected = np.concatenate([solid.mesh.triangles for part in played.harbor.parts for solid in part.solids])
    np.testing.assert_allclose(corners, expected.reshape(-1, 3), atol=2e-3)


def test_the_page_needs_no_network_and_is_small(html: str) -> None:
    assert len(html.encode()) < 8e6
    assert not re.search(r"""(src|href)\s*=\s*["']|@import|\bfetch\(|url\(\s*["']?http""", html)


def test_a_scenario_without_a_policy_shows_the_boat_at_its_start() -> None:
    shown = preview(load("s1"), POSES[:1])
    header, block = contents(page(page_data(shown)))
    (given,) = header["episodes"]
    np.testing.assert_allclose(
        stored(block, given["arrays"]["pose"]), [[24.0, 0.5, np.radians(178.0)]], rtol=1e-6
    )


def test_currents_are_in_the_page() -> None:
    loaded = load("s1", overrides=["conditions.current={speed_mps: 0.1, direction_deg: 90}"])
    header, block = contents(page(page_data(preview(loaded, POSES[:1]))))
    (given,) = header["episodes"]
    assert given["flow"] == ["current"]
    np.testing.assert_allclose(stored(block, given["arrays"]["current"]), [[0.0, 0.1]], atol=1e-6)


def test_the_weather_of_a_scenario_without_a_policy_is_always_the_same() -> None:
    loaded = load("s1", overrides=["conditions.current={speed_mps: [0, 0.1], direction_deg: [0, 360]}"])
    flows = [preview(loaded, POSES[:2]).tracks[i].episode.trajectory["current"] for i in (0, 1, 0)]
    np.testing.assert_array_equal(flows[0], flows[2])
    assert (flows[0] != flows[1]).all()


@pytest.mark.thorough
def test_the_sectors_of_the_page_contain_the_points_of_their_index() -> None:
    loaded = load("s1", overrides=["sensors.lidar.sectors=6"])
    header, _ = contents(page(page_data(preview(loaded, POSES[:1]))))
    edges = header["episodes"][0]["sector_edges"]
    middles = [(right + left) / 2 for right, left in pairwise(edges)]
    assert [sector_index(angle, 6) for angle in middles] == [*range(6)]


def test_wind_is_in_the_page_of_the_episode_that_has_it(html: str) -> None:
    header, block = contents(html)
    assert [given["flow"] for given in header["episodes"]] == [["wind"], [], [], []]
    wind = stored(block, header["episodes"][0]["arrays"]["wind"])
    np.testing.assert_allclose(wind[[0, -1]], [[3.0, -4.0]] * 2)


@pytest.fixture(scope="module")
def browser(html: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    file = tmp_path_factory.mktemp("page") / "replay.html"
    file.write_text(html, encoding="utf-8")
    with opened(file) as page:
        yield page


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
def test_in_a_browser(browser: Any, played: Replay, tmp_path: Path) -> None:
    """No messages; slider, keys and buttons move the boat to the pose in the table; the view is not blank."""
    from PIL import Image
    from selenium.webdriver.common.keys import Keys

    assert browser.get_log("browser") == []
    poses = played.tracks[0].episode.trajectory["pose"]

    def drawn() -> list[float]:
        return list(browser.execute_script("return replay.pose()"))

    # From the direction (-3, 4): 126.9° counterclockwise from +x.
    state = browser.find_element("id", "state").get_attribute("textContent")
    assert "Wind5.00 m/s from 127°" in state
    browser.execute_script(
        "const t = document.getElementById('time'); t.value = 12; t.dispatchEvent(new Event('input'))"
    )
    np.testing.assert_allclose(drawn(), poses[12], atol=1e-5)
    body = browser.find_element("tag name", "body")
    body.send_keys(Keys.ARROW_RIGHT)
    np.testing.assert_allclose(drawn(), poses[13], atol=1e-5)
    body.send_keys(Keys.END)
    np.testing.assert_allclose(drawn(), poses[-1], atol=1e-5)
    body.send_keys("n")
    assert browser.execute_script("return replay.now.selected") == 1
    for key, camera in (("2", "above"), ("3", "astern"), ("4", "bridge"), ("1", "free")):
        body.send_keys(key)
        assert browser.execute_script("return replay.now.camera") == camera
        browser.save_screenshot(str(tmp_path / f"{camera}.png"))
        with Image.open(tmp_path / f"{camera}.png") as image:
            pixels = np.asarray(image.convert("RGB"))[150:450, :500].reshape(-1, 3)
        assert len(np.unique(pixels // 8, axis=0)) > 30
    # After a click, the space bar plays: it does not press the button again.
    body.send_keys(Keys.HOME)
    browser.find_element("css selector", "#cameras button").click()
    browser.switch_to.active_element.send_keys(" ")
    assert browser.execute_script("return replay.now.playing")
    body.send_keys(Keys.HOME)
    browser.execute_script("replay.choose('layouts', 'layout', 'side by side')")
    assert len(browser.find_elements("css selector", "#tiles span")) == len(played.tracks)
    assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
def test_a_long_name_stays_in_its_tile(browser: Any) -> None:
    browser.execute_script("replay.choose('layouts', 'layout', 'side by side')")
    label, edge = browser.execute_script(
        "const [label, edge] = document.getElementById('tiles').children;"
        "label.textContent = 'marinas-weather-'.repeat(30);"
        "return [label, edge].map((each) => each.getBoundingClientRect().toJSON())"
    )
    assert edge["left"] <= label["left"] and label["right"] <= edge["right"]


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
def test_a_long_list_of_episodes_leaves_the_view_free(browser: Any) -> None:
    browser.set_window_size(900, 700)
    covered = browser.execute_script(
        "const list = document.getElementById('episodes'), first = list.firstChild;"
        "for (let i = 0; i < 60; i++) list.append(first.cloneNode(true));"
        "return document.querySelector('header').getBoundingClientRect().bottom / innerHeight"
    )
    assert covered < 0.5


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
@pytest.mark.parametrize("width", [500, 820])
def test_a_narrow_window_shows_start_and_goal(browser: Any, played: Replay, width: int) -> None:
    browser.set_window_size(width, 1300)
    browser.refresh()
    wait(browser, "return document.documentElement.dataset.ready")
    goal = played.scenario.task.final
    points = [played.tracks[0].episode.trajectory["pose"][0][:2].tolist(), [goal.x_m, goal.y_m]]

    def seen() -> NDArray[np.float64]:
        """Points as shares of the width and height of the window, from its upper left corner."""
        shown = browser.execute_script("return arguments[0].map(([x, y]) => replay.screen(x, y))", points)
        return np.array(shown)[:, :2] * [0.5, -0.5] + 0.5

    assert browser.execute_script("return innerWidth") == width
    assert ((seen() > 0) & (seen() < 1)).all()
    assert browser.execute_script("return document.body.classList.contains('wide')")  # without the panel
    browser.find_element("id", "panel-toggle").click()
    edges = "const edge = (tag) => document.querySelector(tag).getBoundingClientRect();"
    top, panel, bottom, controls, height = browser.execute_script(
        f"{edges} const panel = edge('aside');"
        "return [edge('header').bottom, panel.top, panel.bottom, edge('footer').top, innerHeight]"
    )
    assert 0 < bottom <= controls
    assert ((seen()[:, 1] > top / height) & (seen()[:, 1] < panel / height)).all()
