"""Meshes as trimesh has them, to measure, transform and write them."""

from __future__ import annotations

import trimesh

from dockctl.sim.harbor.solids import Mesh


def peer(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
