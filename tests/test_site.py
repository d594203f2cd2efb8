"""The documentation as a site, the links of all documents, and the examples of the gallery."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
import trimesh
import yaml

from dockctl.scenarios.loader import load
from dockctl.sim.vessel import VesselModel
from tests.test_packaging import DOCUMENTS

ROOT = Path(__file__).parents[1]
LOADED = re.compile(
    r"""<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=["']?(?:https?:)?//"""
    r"""|(?:@import\s|url\()\s*["']?(?:https?:)?//"""
)


class Links(HTMLParser):
    """The anchors of an HTML page, and the targets of its links and files."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.anchors.add(value or "")
            if name in ("href", "src"):
                self.targets.append(value or "")


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings of a document, as GitHub writes them."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.M | re.S)
    found: list[str] = []
    for heading in re.findall(r"^#+ (.+)$", text, re.M):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found.append(f"{slug}-{found.count(slug)}" if slug in found else slug)
    return {*found}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_relative_links_and_their_anchors_resolve(document: Path) -> None:
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target or target.startswith("mailto:"):
            continue
        path, _, anchor = target.partition("#")
        place = (document.parent / path).resolve() if path else document
        assert place.exists(), target
        assert not anchor or anchor in anchors(place), target


def test_the_code_that_the_model_page_names_exists() -> None:
    text = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    lines = re.findall(r"^Code: (.+?)\n\n", text, re.M | re.S)
    assert len(lines) >= 9
    for line in lines:
        names: list[str] = []
        for name, path in re.findall(r"`(\w+)`|\]\(\.\./([\w/]+\.py)\)", line):
            names += [name] if name else []
            if path:
                tree = ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8")))
                defined = {getattr(node, "name", "") for node in tree}
                assert {*names} <= defined, (path, names)
                names = []


def test_the_launch_is_the_boat_of_the_thesis_at_another_scale() -> None:
    """Froude's law: the path of the scaled boat is the scaled path, with times and speeds as the root."""
    scale = 1.5
    small = load("s1").scenario.vessel
    launch = load(ROOT / "examples/custom-boat/s1-launch.yaml").scenario.vessel
    period = small.control_period_s * scale**0.5
    models = VesselModel(small), VesselModel(launch.model_copy(update={"control_period_s": period}))
    states = [(np.zeros((1, 3)), np.zeros((1, 3))) for _ in models]
    for force, angle in ((50.0, 0.5), (50.0, -0.2), (-40.0, 0.3)) * 10:
        commands = np.array([[force, angle]]), np.array([[force * scale**3, angle]])
        moves = zip(models, states, commands, strict=True)
        states = [model.step(*state, command) for model, state, command in moves]
    (eta, nu), (scaled_eta, scaled_nu) = states
    np.testing.assert_allclose(scaled_eta / [scale, scale, 1], eta, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(scaled_nu / [scale**0.5, scale**0.5, scale**-0.5], nu, rtol=1e-4, atol=1e-5)


def test_the_gallery_shows_the_file_of_the_example() -> None:
    shown = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs/gallery.md").read_text(), re.M | re.S)
    file = yaml.safe_load((ROOT / "examples/glb-harbor/fishing-harbor.yaml").read_text())
    del file["title"]
    assert [yaml.safe_load(block) for block in shown] == [file]


def test_the_glb_file_is_what_its_script_builds() -> None:
    file = ROOT / "examples/glb-harbor/build.py"
    spec = importlib.util.spec_from_file_location("build", file)
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    built = dict(script.solids())
    scene = trimesh.load_scene(script.FILE)
    assert {*scene.geometry} == {*built}
    for name, solid in built.items():
        x, y, z = solid.bounds.T
        expected = np.array([x, z, -y[::-1]]).T  # y up
        np.testing.assert_allclose(scene.geometry[name].bounds, expected, atol=1e-5)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it."""
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    command = (sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.thorough  # builds the site; the links of its sources are tested above
class TestSite:
    def test_it_loads_nothing_from_the_network(self, site: Path) -> None:
        pages = [*site.rglob("*.html"), *site.rglob("*.css")]
        assert len(pages) > 30
        assert [page for page in pages if LOADED.search(page.read_text(encoding="utf-8"))] == []

    def test_its_links_and_anchors_resolve(self, site: Path) -> None:
        pages = {path: Links(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
        broken = []
        for path, page in pages.items():
            for link in page.targets:
                parts = urlsplit(link)
                if parts.scheme:
                    continue
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                found = target.is_file() and not link.startswith("/")
                if found and target in pages and parts.fragment:
                    found = unquote(parts.fragment) in pages[target].anchors
                broken += [] if found else [(path.relative_to(site), link)]
        assert sum(len(page.targets) for page in pages.values()) > 1000
        assert broken == []

    def test_equations_are_mathml(self, site: Path) -> None:
        page = (site / "model.html").read_text(encoding="utf-8")
        assert page.count("<math") >= 12
        assert "arithmatex" not in page and "\\begin" not in page

    def test_the_reference_has_every_command_key_and_public_name(self, site: Path) -> None:
        from dockctl.cli import COMMANDS
        from dockctl.evaluation import __all__ as names

        commands = (site / "reference/commands.html").read_text(encoding="utf-8")
        assert all(f"dockctl-{name}" in commands for name in COMMANDS)
        schema = (site / "reference/schema.html").read_text(encoding="utf-8")
        assert all(f"<code>{key}</code>" in schema for key in ("max_propeller_n", "huber_delta", "sectors"))
        reference = (site / "reference/python.html").read_text(encoding="utf-8")
        assert all(f"{name}" in reference for name in names)
        pilot = ("Pilot", "Pilot.load", "Pilot.decide", "Pilot.reset", "Reading", "Checks", "Decision")
        assert all(f'id="dockctl.pilot.{name}"' in reference for name in pilot)
        assert re.findall(r"[\w.]+,(?=</span></code></td>)", reference) == []  # an attribute per line

    def test_the_search_works_without_a_server(self, site: Path) -> None:
        index = (site / "search/search_index.js").read_text(encoding="utf-8")
        assert index.startswith("var __index = ") and "Coriolis" in index
        assert "site/iframe-worker.js" in (site / "index.html").read_text(encoding="utf-8")
