"""Images of the virtual card as files."""

import errno

import pytest

from host.protocol.errors import LocalError

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from sim.card import Card


def test_images_are_never_overwritten(tmp_path):
    card = Card(16)
    card.put("config.txt", b"1\n")
    path = tmp_path / "card.img"
    card.save(str(path))
    assert path.read_bytes() == card.image()
    with pytest.raises(LocalError, match="not overwritten"):
        card.save(str(path))
    assert path.read_bytes() == card.image()
    with pytest.raises(LocalError, match="No such file"):
        card.save(str(tmp_path / "nowhere" / "card.img"))


def test_an_image_that_has_no_room_is_not_left_in_part(tmp_path, monkeypatch):
    def write_half(out):
        out.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    card = Card(16)
    monkeypatch.setattr(card, "_write_image", write_half)
    with pytest.raises(LocalError, match="No space left"):
        card.save(str(tmp_path / "card.img"))
    assert not list(tmp_path.iterdir())
