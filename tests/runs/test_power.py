"""After a power cut at any step of a write, the old or the new content is there; what was saved stays."""

from __future__ import annotations

from pathlib import Path

from dockctl.runs.files import intact, new_folder, write_atomically
from dockctl.runs.tables import Table
from tests.runs.power import Disk


def test_the_model_sees_what_was_not_synced(tmp_path: Path) -> None:
    """The usual write to a temporary file, without fsync: the name is new and the content is not there."""
    disk = Disk(tmp_path)
    with disk.watched():
        (tmp_path / "new").write_bytes(b"content")
        (tmp_path / "new").replace(tmp_path / "file")
    left = {dict(image).get("file", b"no file") for image in disk.images}
    assert left == {b"no file", b"content", b"", bytes(7)}


def test_a_file_is_old_or_new_and_stays_once_it_is_written(tmp_path: Path) -> None:
    file = write_atomically(tmp_path / "file", b"0")
    disk = Disk(tmp_path)
    disk.mark = 0
    with disk.watched():
        for number in range(1, 4):
            write_atomically(file, b"%d" % number)
            disk.mark = number
    assert disk.cuts > 9
    for image, returned in disk.images.items():
        content = dict(image)["file"]
        assert content is not None
        assert returned <= int(content) <= returned + 1


def test_a_folder_is_old_or_new_and_complete(tmp_path: Path) -> None:
    root = tmp_path / "disk"
    root.mkdir()
    disk = Disk(root)
    disk.mark = 0
    with disk.watched():
        for number in range(1, 4):
            with new_folder(root / "deep" / "best") as folder:
                (folder / "inner").mkdir()
                for name in ("a", "inner/b"):
                    (folder / name).write_text(f"{number}")
            disk.mark = number
    for number, (image, returned) in enumerate(disk.images.items()):
        best = intact(disk.restore(image, tmp_path / f"{number}") / "deep" / "best")
        if returned or best.is_dir():
            found = {int((best / name).read_text()) for name in ("a", "inner/b")}
            assert found in ({returned}, {returned + 1})


def test_saved_rows_stay_and_later_ones_are_removed(tmp_path: Path) -> None:
    root = tmp_path / "disk"
    root.mkdir()
    disk = Disk(root)
    with disk.watched():
        table = Table(root / "t.csv", ["env_steps", "x"])
        for step in range(1, 4):
            table.append([{"env_steps": step, "x": 0.5}])
            disk.mark = step, table.save()
            table.append([{"env_steps": step, "x": 0.25}])  # after the save, at the same step
    assert any(b"\0" in (dict(image).get("t.csv") or b"") for image in disk.images)
    for number, (image, mark) in enumerate(disk.images.items()):
        if mark:
            path = disk.restore(image, tmp_path / f"{number}") / "t.csv"
            assert Table(path, []).restore(mark[1], mark[0]) is None
            assert len(path.read_text().splitlines()) == 2 * mark[0]
            assert path.read_text().endswith(f"{mark[0]},0.5\n")
