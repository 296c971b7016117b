"""A recording that rerun cannot write is one line, not rerun's traceback."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from polemap.drivelog.errors import OutputError
from polemap.tools.recording import rerun


class _Full:
    def __init__(self, _name: str) -> None:
        pass

    def save(self, path: str, **_options: object) -> None:
        Path(path).write_bytes(b"RRF2")
        raise RuntimeError("Failed to encode LogMsg: No space left on device (os error 28)")


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun, "need", lambda _name: SimpleNamespace(RecordingStream=_Full))
    monkeypatch.setattr(rerun, "_views", lambda _scene: None)
    with pytest.raises(OutputError, match=r"run.rrd: cannot be written .*No space left"):
        rerun.write_rerun(None, tmp_path / "run.rrd")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
