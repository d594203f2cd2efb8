"""Harbours as data: a marina described by its rows of piers, or mesh files."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dockctl.scenarios.base import Model, Number, Positive


class Basin(Model):
    """The water, between the faces of the quays; metres."""

    x_min_m: Number
    x_max_m: Number
    y_min_m: Number
    y_max_m: Number


class PierRow(Model):
    """Finger piers along one quay, and the berths two by two between them."""

    side: Literal["east", "west"]
    finger_y_m: tuple[Number, ...] = Field(min_length=1, description="centre lines of the fingers")
    finger_length_m: Positive = 8.0
    finger_width_m: Positive = 1.0
    berth_y_m: tuple[Number, ...] = Field(min_length=1, description="centre lines of the berths")
    free_y_m: tuple[Number, ...] = Field(default=(), description="berths without a moored vessel")


class Fleet(Model):
    """The moored vessels: drawn from the 12 models with a fixed seed."""

    seed: int = Field(default=0, ge=0, strict=True)
    stern_gap_m: Positive = 0.7


class Marina(Model):
    kind: Literal["marina"]
    name: str = "marina"
    basin: Basin
    rows: tuple[PierRow, ...] = Field(min_length=1)
    fleet: Fleet = Fleet()


class MeshFile(Model):
    """A GLB, OBJ, STL or PLY file in metres, z up, water at z = 0, after scale and shift."""

    path: str
    scale: Positive = 1.0
    shift_m: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class MeshHarbor(Model):
    kind: Literal["meshes"]
    name: str = "meshes"
    meshes: tuple[MeshFile, ...] = Field(min_length=1)


HarborSpec = Annotated[Marina | MeshHarbor, Field(discriminator="kind")]
