"""A bundle passes the validators of its standards, comes back with the same hashes, and harms nobody who opens it."""

import io
import json
import shutil
import tarfile
import zipfile
from dataclasses import replace
from hashlib import sha256

import pytest
from shelf import write_family, write_recording

from stillpoint.datasets.archive import create_archive
from stillpoint.datasets.archive.bundle import bundle_files
from stillpoint.datasets.archive.pack import is_inside, open_bundle, write_bundle
from stillpoint.datasets.archive.selection import About, select_items
from stillpoint.datasets.archive.verify import verify_archive
from stillpoint.datasets.errors import BadFile, BadParameter, StillpointError

ABOUT = About("Walks with a phone", "Two walks.", ("Anna Example",), "https://example.org/walks", "2026-01-02")
KINDS = ("folder", "bundle.zip", "bundle.tar")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("publish")
    with create_archive(folder / "archive") as opened:
        walk = write_family(folder, "walk", 1, sensor="iPhone 5", citation="A. Author: Walks. J, 2020.")
        list(opened.add(walk, ["fast"], {"subject": "anna"}))
        list(opened.add(write_family(folder, "ride", 2, licence="CeCILL 2.1"), ["slow"]))
        yield opened


@pytest.fixture(scope="module", params=KINDS)
def bundle(request, archive, tmp_path_factory):
    target = tmp_path_factory.mktemp("bundle") / request.param
    write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), target)
    return target


def test_a_bundle_holds_what_belongs_together(archive):
    kinds = {item.entry.kind for item in select_items(archive, "kind:reference and name ~ walk")}
    assert kinds == {"recording", "reference", "estimate"}
    alone = select_items(archive, "kind:reference and name ~ walk", alone=True)
    assert {item.entry.kind for item in alone} == {"recording", "reference"}
    assert {item.licences for item in select_items(archive, "tag:fast")} == {("CC BY 4.0",)}


@pytest.mark.slow
def test_every_file_has_the_hash_that_is_said_of_it(archive, tmp_path):
    target = tmp_path / "folder"
    write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), target)
    lines = (target / "manifest-sha256.txt").read_text().splitlines()
    stated = dict(reversed(line.split("  ")) for line in lines)
    files = {str(file.relative_to(target)) for file in target.rglob("*") if file.is_file()}
    assert files - {"manifest-sha256.txt"} == set(stated)
    assert all(sha256((target / path).read_bytes()).hexdigest() == digest for path, digest in stated.items())


@pytest.mark.slow
def test_croissant_passes_its_validator_and_gives_the_records(archive, tmp_path):
    mlc = pytest.importorskip("mlcroissant")
    write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), tmp_path / "b")
    dataset = mlc.Dataset(jsonld=str(tmp_path / "b" / "croissant.json"))  # raises ValidationError where it must
    assert not dataset.metadata.ctx.issues.errors
    assert not dataset.metadata.ctx.issues.warnings
    records = list(dataset.records("objects"))
    assert len(records) == 6
    assert {record["objects/kind"] for record in records} == {b"recording", b"reference", b"estimate"}
    hashes = {record["objects/sha256"].decode() for record in records}
    assert hashes == {entry.sha256 for entry in archive.find("all")}


@pytest.mark.slow
def test_ro_crate_is_read_back_by_its_package(archive, tmp_path):
    rocrate = pytest.importorskip("rocrate.rocrate")
    write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), tmp_path / "b")
    crate = rocrate.ROCrate(tmp_path / "b")
    assert crate.name == ABOUT.title
    assert crate.datePublished.date().isoformat() == ABOUT.date
    files = {str(entity.id): entity for entity in crate.data_entities}
    on_disk = {str(file.relative_to(tmp_path / "b")) for file in (tmp_path / "b").rglob("*") if file.is_file()}
    assert on_disk - set(files) == {"ro-crate-metadata.json", "manifest-sha256.txt"}
    reference = files["data/references/walk.reference.mcap"]
    assert [entity.id for entity in reference["isBasedOn"]] == ["data/recordings/walk.mcap"]
    assert [entity.id for entity in reference["license"]] == ["https://spdx.org/licenses/CC-BY-4.0"]
    for path, entity in files.items():
        assert entity["sha256"] == sha256((tmp_path / "b" / path).read_bytes()).hexdigest()


def test_a_bundle_comes_back_with_the_same_hashes_tags_and_provenance(archive, bundle, tmp_path):
    with create_archive(tmp_path / "other") as other:
        with open_bundle(bundle) as contents:
            assert [one.status for one in other.add_given(contents.read_objects())] == ["added"] * 6
        assert other.catalogue.dump() == archive.catalogue.dump()
        assert verify_archive(other).faults == ()
        with open_bundle(bundle) as contents:
            assert [one.status for one in other.add_given(contents.read_objects())] == ["present"] * 6


def test_the_same_objects_give_the_same_bytes(archive, tmp_path):
    files = bundle_files(select_items(archive, "all"), ABOUT, {})
    for name in ("a.zip", "b.zip", "a.tar", "b.tar"):
        write_bundle(files, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert (tmp_path / "a.tar").read_bytes() == (tmp_path / "b.tar").read_bytes()
    with pytest.raises(BadParameter, match="is there already"):
        write_bundle(files, tmp_path / "a.zip")


def test_a_file_without_licence_stops_the_export(tmp_path):
    with create_archive(tmp_path / "archive") as archive:
        list(archive.add(write_family(tmp_path, "bare", licence="")))
        with pytest.raises(BadParameter, match="no licence"):
            select_items(archive, "all")
        assert len(select_items(archive, "all", allow_unlicensed=True)) == 3
        archive.label([archive.resolve("bare").sha256], metadata={"licence": "CC0 1.0"})
        assert {item.licences for item in select_items(archive, "all")} == {("CC0 1.0",)}


def test_a_damaged_member_is_refused_and_the_others_are_kept(archive, tmp_path):
    write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), tmp_path / "b")
    broken = tmp_path / "b" / "data" / "recordings" / "walk.mcap"
    data = bytearray(broken.read_bytes())
    data[100] ^= 1
    broken.write_bytes(data)
    with create_archive(tmp_path / "other") as other, open_bundle(tmp_path / "b") as contents:
        outcomes = {one.source.name: one for one in other.add_given(contents.read_objects())}
    assert outcomes["walk.mcap"].status == "refused"
    assert "damaged" in outcomes["walk.mcap"].reason
    assert sum(one.status == "added" for one in outcomes.values()) == 5


@pytest.mark.parametrize(
    "path", ["../x", "/etc/x", "a/../../x", "C:\\x", "c:x", "..\\x", "", ".", "a\\b", "a\0b", "a/.."]
)
def test_paths_that_lead_out_are_recognised(path):
    assert not is_inside(path)


def manifest_of(path, data, **changes):
    entry = {
        "path": path, "sha256": sha256(data).hexdigest(), "size": len(data), "kind": "source", "name": "x",
        "file_name": "x.bin", "added": "2026-01-01T00:00:00Z", "licences": [], "tags": [], "metadata": {},
        "made_from": [],
    }  # fmt: skip
    return json.dumps({"format": 1, "objects": [{**entry, **changes}], "files": []}).encode()


def hostile_bundles(folder):
    """Bundles that would write, read or fill what they should not, with the files that must not be touched."""
    secret = folder / "secret.txt"
    secret.write_text("secret")
    data = b"x" * 10
    for name, manifest in {
        "dots": manifest_of("../secret.txt", b"secret"),
        "absolute": manifest_of(str(secret), b"secret"),
        "size": manifest_of("x.bin", data, size=-1),
        "hash": manifest_of("x.bin", data, sha256="../../etc"),
        "huge": manifest_of("x.bin", data, size=1 << 50),
        "json": b"[" * 100_000,
    }.items():
        with zipfile.ZipFile(folder / f"{name}.zip", "w") as out:
            out.writestr("manifest.json", manifest)
            out.writestr("x.bin", data)
            out.writestr("../secret.txt", b"overwritten")
    zeros = bytes(64 << 20)
    with zipfile.ZipFile(folder / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr("manifest.json", manifest_of("x.bin", zeros))
        out.writestr("x.bin", zeros)
    with tarfile.open(folder / "link.tar", "w") as out:
        content = manifest_of("x.bin", b"secret")
        info = tarfile.TarInfo("manifest.json")
        info.size = len(content)
        out.addfile(info, io.BytesIO(content))
        link = tarfile.TarInfo("x.bin")
        link.type, link.linkname = tarfile.SYMTYPE, str(secret)
        out.addfile(link)
    linked = folder / "linked"
    linked.mkdir()
    (linked / "manifest.json").write_bytes(manifest_of("x.bin", b"secret"))
    (linked / "x.bin").symlink_to(secret)
    (folder / "cut.zip").write_bytes((folder / "dots.zip").read_bytes()[:-30])
    (folder / "noise.tar").write_bytes(b"\x00\xff" * 4000)
    return secret, [*folder.glob("*.zip"), *folder.glob("*.tar"), linked]


@pytest.mark.slow
def test_hostile_bundles_take_and_touch_nothing(tmp_path):
    secret, bundles = hostile_bundles(tmp_path)
    assert len(bundles) == 11
    for place in bundles:
        with create_archive(tmp_path / f"archive-{place.name}") as archive:
            try:
                with open_bundle(place) as contents:
                    outcomes = list(archive.add_given(contents.read_objects()))
            except StillpointError as error:
                assert "\n" not in str(error)  # noqa: PT017
            else:
                assert [one.status for one in outcomes] == ["refused"]
            assert archive.find("all") == []
    assert secret.read_text() == "secret"


def test_a_member_that_is_larger_than_its_manifest_says_is_not_read_to_its_end(tmp_path):
    folder = tmp_path / "b"
    folder.mkdir()
    (folder / "manifest.json").write_bytes(manifest_of("x.bin", b"x" * 10))
    (folder / "x.bin").write_bytes(b"x" * (8 << 20))
    with create_archive(tmp_path / "archive") as archive, open_bundle(folder) as contents:
        given = [replace(one) for one in contents.read_objects()]
        assert [one.status for one in archive.add_given(given)] == ["refused"]


def test_two_objects_of_one_name_have_two_paths(tmp_path):
    with create_archive(tmp_path / "archive") as archive:
        for seed in (1, 2):
            (tmp_path / str(seed)).mkdir()
            list(archive.add([write_recording(tmp_path / str(seed) / "run.mcap", seed)]))
        paths = [item.path for item in select_items(archive, "all")]
        assert len(set(paths)) == 2
        write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), tmp_path / "b")
        shutil.rmtree(tmp_path / "archive" / "objects")
        with pytest.raises(BadFile):
            write_bundle(bundle_files(select_items(archive, "all"), ABOUT, {}), tmp_path / "c")
        assert not (tmp_path / "c").exists()
