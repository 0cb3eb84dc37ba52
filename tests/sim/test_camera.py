"""The simulated camera's pictures, and what it says about files that it cannot use."""

import io

import numpy as np
import pytest
from PIL import Image

from host.protocol.errors import LocalError
from sim import camera


def test_the_scene_is_seeded_and_shows_its_number():
    first = camera.scene(324, 244, seed=1, quality=80)
    assert (first.width, first.height, len(first.raw)) == (324, 244, 16)
    assert first == camera.scene(324, 244, seed=1, quality=80)
    assert first.raw != camera.scene(324, 244, seed=2, quality=80).raw
    assert len(set(first.raw)) == 16
    for index, (raw, jpeg) in enumerate(zip(first.raw, first.jpeg, strict=True)):
        assert camera.scene_number(np.frombuffer(raw, np.uint8).reshape(244, 324)) == index
        decoded = np.asarray(Image.open(io.BytesIO(jpeg)))
        assert decoded.shape == (244, 324)
        assert camera.scene_number(decoded) == index


@pytest.mark.parametrize("size", [(1, 1), (1, 1024), (1024, 1), (4, 4)])
def test_the_scene_at_any_size(size):
    made = camera.scene(*size, seed=1, quality=80)
    assert {len(raw) for raw in made.raw} == {size[0] * size[1]}


def test_a_folder_in_the_order_of_names(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    Image.fromarray(grey).save(tmp_path / "b.png")
    Image.fromarray(grey + 100).save(tmp_path / "a.pgm")
    Image.fromarray(np.stack([grey] * 3, axis=2)).save(tmp_path / "c.ppm")
    (tmp_path / "notes.txt").write_text("not a picture")
    made = camera.load(str(tmp_path), quality=80)
    assert (made.width, made.height) == (4, 3)
    assert made.raw == ((grey + 100).tobytes(), grey.tobytes(), grey.tobytes())


def test_one_file(tmp_path):
    Image.fromarray(np.zeros((3, 4), np.uint8)).save(tmp_path / "a.pgm")
    assert camera.load(str(tmp_path / "a.pgm"), quality=80).raw == (bytes(12),)


def save(folder, name, picture):
    Image.fromarray(picture).save(folder / name)


@pytest.mark.parametrize(
    ("fill", "message"),
    [
        (lambda folder: None, "in this folder"),
        (lambda folder: (folder / "a.png").write_bytes(b"nonsense"), "a.png: not a PGM, PPM or PNG"),
        (lambda folder: (folder / "a.pgm").write_bytes(b"P5\n4 3\n255\nshort"), "a.pgm: "),
        (lambda folder: save(folder, "a.png", np.zeros((3, 4), np.uint16)), "a.png: pixels of mode I;16"),
        (lambda folder: save(folder, "a.png", np.zeros((1, 1025), np.uint8)), "a.png: 1025x1, at most 1024"),
        (lambda folder: (folder / "a.pgm").write_bytes(b"P5\n60000 60000\n255\n"), "a.pgm: Image size"),
        (
            lambda folder: [save(folder, f"{side}.png", np.zeros((side, 4), np.uint8)) for side in (3, 5)],
            "5.png: 4x5, but the pictures before it are 4x3",
        ),
    ],
)
def test_unusable_files_are_named(tmp_path, fill, message):
    fill(tmp_path)
    with pytest.raises(LocalError) as error:
        camera.load(str(tmp_path), quality=80)
    assert message in str(error.value)


def test_nothing_there():
    with pytest.raises(LocalError, match="no such file or folder"):
        camera.load("/nowhere/at/all", quality=80)


def test_memory_is_bounded(tmp_path, monkeypatch):
    for index in range(3):
        save(tmp_path, f"{index}.png", np.zeros((100, 100), np.uint8))
    monkeypatch.setattr(camera, "MEMORY_BYTES_MAX", 25000)
    with pytest.raises(LocalError, match=r"2\.png: the 3 pictures up to here take more than"):
        camera.load(str(tmp_path), quality=80)
