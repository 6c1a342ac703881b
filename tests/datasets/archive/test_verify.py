"""Every kind of damage is found where it is, what is said to do about it works, and a clean archive is clean."""

import hashlib
import json
import shutil
import sqlite3
from dataclasses import replace
from datetime import timedelta

import pytest
from shelf import write_estimate, write_family, write_recording

from stillpoint.datasets import read, write
from stillpoint.datasets.archive import create_archive, open_archive
from stillpoint.datasets.archive.record import Record, record_to_bytes
from stillpoint.datasets.archive.repair import Copies, repair_archive
from stillpoint.datasets.archive.verify import verify_archive


@pytest.fixture
def home(tmp_path):
    """An archive with two families of files and a removed recording, and a copy of it beside."""
    for seed, name in enumerate(("walk", "ride")):
        (tmp_path / name).mkdir()
        write_family(tmp_path / name, name, seed)
    with create_archive(tmp_path / "archive") as archive:
        for name in ("walk", "ride"):
            list(archive.add(sorted((tmp_path / name).glob("*.mcap")), [name], {"subject": "anna"}))
        list(archive.add([write_recording(tmp_path / "gone.mcap", 9)]))
        archive.remove([archive.resolve("gone.mcap").sha256], "a test")
    shutil.copytree(tmp_path / "archive", tmp_path / "copy", symlinks=True)
    return tmp_path / "archive"


def object_of(home, name):
    return (home / "names" / name).resolve()


def record_of(home, name):
    file = object_of(home, name)
    return home / "records" / file.parent.name / f"{file.stem}.json"


def flip(path, at=None):
    data = bytearray(path.read_bytes())
    data[len(data) // 2 if at is None else at] ^= 1
    path.write_bytes(data)


def sql(home, statement):
    with sqlite3.connect(home / "catalogue.sqlite") as connection:
        connection.execute(statement)
    connection.close()


def keep_by_hand(home, data, name):
    """An object with a record and the right hash, which `add` would not have taken in."""
    sha256 = hashlib.sha256(data).hexdigest()
    record = Record(sha256, ".mcap", name, len(data), "2026-01-01T00:00:00Z")
    for key, content in ((record.object_key, data), (record.record_key, record_to_bytes(record))):
        (home / key).parent.mkdir(parents=True, exist_ok=True)
        (home / key).write_bytes(content)
    with open_archive(home) as archive:
        archive.rebuild()


def flip_object(home):
    flip(object_of(home, "walk.mcap"))


def flip_last_byte(home):
    flip(object_of(home, "ride.ekf.estimate.mcap"), -1)


def cut_object(home):
    path = object_of(home, "walk.reference.mcap")
    path.write_bytes(path.read_bytes()[:-100])


def empty_object(home):
    object_of(home, "ride.mcap").write_bytes(b"")


def exchange_objects(home):
    object_of(home, "walk.mcap").write_bytes(object_of(home, "ride.mcap").read_bytes())


def delete_object(home):
    object_of(home, "ride.ekf.estimate.mcap").unlink()


def rename_object(home):
    path = object_of(home, "ride.mcap")
    path.rename(path.with_suffix(".txt"))


def flip_record(home):
    flip(record_of(home, "walk.mcap"))


def edit_record(home):
    path = record_of(home, "walk.mcap")
    path.write_text(path.read_text().replace("walk", "talk"))


def delete_record(home):
    record_of(home, "ride.mcap").unlink()


def exchange_records(home):
    shutil.copy(record_of(home, "walk.mcap"), record_of(home, "ride.mcap"))


def drop_file_among_objects(home):
    (home / "objects" / "notes.txt").write_text("mine")


def drop_file_among_records(home):
    (home / "records" / "ab").mkdir(exist_ok=True)
    (home / "records" / "ab" / "notes.json").write_text("{}")


def drop_object_without_record(home):
    (home / "objects" / "ab").mkdir(exist_ok=True)
    (home / "objects" / "ab" / ("0" * 62 + ".mcap")).write_bytes(b"x")


def edit_catalogue_fact(home):
    sql(home, "UPDATE objects SET duration_s = 3.5 WHERE name = 'walk' AND kind = 'recording'")


def edit_catalogue_tag(home):
    sql(home, "UPDATE tags SET tag = 'other' WHERE tag = 'walk'")


def delete_catalogue_row(home):
    sql(home, "DELETE FROM objects WHERE kind = 'reference'")


def delete_catalogue_parents(home):
    sql(home, "DELETE FROM parents")


def delete_link(home):
    (home / "names" / "walk.mcap").unlink()


def turn_link(home):
    link = home / "names" / "walk.mcap"
    link.unlink()
    link.symlink_to("../objects/00/nothing.mcap")


def drop_link(home):
    (home / "names" / "other.mcap").symlink_to("../objects/00/nothing.mcap")


def keep_damaged_content(home):
    data = bytearray(object_of(home, "walk.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    keep_by_hand(home, bytes(data), "twisted.mcap")


def orphan_estimate(home):
    folder = home.parent / "orphan"
    folder.mkdir()
    stranger = write_recording(folder / "stranger.mcap", 77)
    estimate = write_estimate(folder / "stranger.ekf.estimate.mcap", stranger)
    with open_archive(home) as archive:
        list(archive.add([estimate]))


def remove_parent_by_hand(home):
    path = record_of(home, "walk.mcap")
    with open_archive(home) as archive:
        record = archive.read_record(archive.resolve("walk.mcap").sha256)
        path.write_bytes(record_to_bytes(replace(record, removed="2026-01-01T00:00:00Z", reason="none")))
        archive.rebuild()


def bring_back_freed_bytes(home):
    gone = home.parent / "gone.mcap"
    with open_archive(home) as archive:
        archive.collect(archive.list_removable(timedelta(0)))
        (record,) = [archive.read_record(entry.sha256) for entry in archive.find("is:removed")]
        shutil.copy(gone, home / record.object_key)


def delete_mark(home):
    (home / "stillpoint-archive.txt").unlink()


# fault -> level at which it is found, a word of what is said, whether repair from the copy mends it
FAULTS = {
    flip_object: ("object", "its hash is", True),
    flip_last_byte: ("object", "its hash is", True),
    cut_object: ("object", "bytes where", True),
    empty_object: ("object", "0 bytes where", True),
    exchange_objects: ("object", "its hash is", True),
    delete_object: ("object", "is missing", True),
    rename_object: ("object", "should be", True),
    flip_record: ("record", "damaged", True),
    edit_record: ("record", "its checksum differs", True),
    delete_record: ("record", "no record", True),
    exchange_records: ("record", "is the record of", True),
    drop_file_among_objects: ("record", "no hash", False),
    drop_file_among_records: ("record", "is no record", False),
    drop_object_without_record: ("record", "no record", False),
    edit_catalogue_fact: ("catalogue", "rows of objects", True),
    edit_catalogue_tag: ("catalogue", "rows of tags", True),
    delete_catalogue_row: ("catalogue", "lacks walk.reference.mcap", True),
    delete_catalogue_parents: ("catalogue", "rows of parents", True),
    delete_link: ("link", "is missing", True),
    turn_link: ("link", "leads to", True),
    drop_link: ("link", "leads to nothing", True),
    keep_damaged_content: ("content", "is damaged", False),
    orphan_estimate: ("provenance", "not in the archive", False),
    remove_parent_by_hand: ("provenance", "was removed", False),
    bring_back_freed_bytes: ("object", "were freed", False),
}


def test_a_clean_archive_is_clean(home):
    with open_archive(home) as archive:
        found = verify_archive(archive)
        assert found.faults == ()
        assert found.objects == 7
        assert verify_archive(archive, thorough=True) == found
        assert found.bytes == sum(path.stat().st_size for path in (home / "objects").rglob("*.mcap"))


def test_the_raw_file_of_a_device_s_attitude_may_stay_outside(home, tmp_path):
    """An importer read it, as it read the raw file of a recording. Its recording has to be here."""
    recording = tmp_path / "walk.mcap"
    with open_archive(home) as archive:
        shutil.copy(archive.find_path(archive.resolve("walk.mcap")), recording)
        made = write_estimate(tmp_path / "walk.device.estimate.mcap", recording, "device")
        kept = read(made)
        write(made, replace(kept, made_from={**kept.made_from, "phone/rotation-vector.txt": "ab" * 32}))
        list(archive.add([made]))
        assert verify_archive(archive).faults == ()
        write(made, replace(kept, made_from={**kept.made_from, "walk.calibration.toml": "ab" * 32}))
        list(archive.add([made]))
        (fault,) = verify_archive(archive).faults
        assert "walk.calibration.toml" in fault.what


@pytest.mark.parametrize("plant", FAULTS, ids=lambda plant: plant.__name__)
def test_each_fault_is_found_and_mended_where_a_copy_can_mend_it(home, plant):
    level, says, mended = FAULTS[plant]
    plant(home)
    with open_archive(home) as archive:
        found = verify_archive(archive).faults
        assert any(fault.level == level and says in fault.what for fault in found), found
        assert all(fault.repair and "\n" not in fault.what for fault in found)
        _, left = repair_archive(archive, found, Copies(home.parent / "copy"))
        again = verify_archive(archive).faults
        if mended:
            assert left == []
            assert again == ()
        else:
            assert {fault.level for fault in again} == {level}


def test_all_faults_at_once_are_all_found(home):
    for plant in (flip_object, cut_object, delete_object, edit_catalogue_tag, drop_file_among_objects, drop_link):
        plant(home)
    flip(record_of(home, "ride.mcap"))
    with open_archive(home) as archive:
        found = verify_archive(archive).faults
    assert {fault.level for fault in found} == {"object", "record", "catalogue", "link"}
    assert sum(fault.level == "object" for fault in found) == 3


def test_records_come_back_from_the_catalogue_without_a_copy(home):
    flip_record(home)
    delete_record(home)
    with open_archive(home) as archive:
        _, left = repair_archive(archive, verify_archive(archive).faults, None)
        assert left == []
        assert verify_archive(archive).faults == ()
        assert archive.labels(archive.resolve("walk.mcap").sha256) == (["walk"], {"subject": "anna"})


def test_a_copy_with_the_same_damage_mends_nothing(home):
    flip_object(home)
    copy = home.parent / "copy" / object_of(home, "walk.mcap").relative_to(home)
    shutil.copy(object_of(home, "walk.mcap"), copy)
    shutil.rmtree(home.parent / "walk")
    with open_archive(home) as archive:
        done, left = repair_archive(archive, verify_archive(archive).faults, Copies(home.parent / "copy"))
        assert done == []
        assert [fault.level for fault in left] == ["object"]


def test_plain_files_serve_as_a_copy(home):
    flip_object(home)
    with open_archive(home) as archive:
        _, left = repair_archive(archive, verify_archive(archive).faults, Copies(home.parent / "walk"))
        assert left == []


def test_a_deleted_mark_gives_one_line_error(home):
    delete_mark(home)
    with pytest.raises(Exception, match="is not an archive") as caught:
        open_archive(home)
    assert "\n" not in str(caught.value)


def test_a_record_says_what_it_is(home):
    content = json.loads(record_of(home, "walk.mcap").read_bytes())
    assert content["file_name"] == "walk.mcap"
    assert content["tags"] == ["walk"]
